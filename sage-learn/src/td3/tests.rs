//! Tests of `learner`.

use super::*;

const SIZES: [usize; 2] = [5, 2];

fn learner() -> Td3Learner<f64> {
    let options = Td3Options { hidden: [16, 12], batch: 8, max_action: 1.5, ..Td3Options::default() };
    Td3Learner::new(options, SIZES, 3).unwrap()
}

fn batches() -> Vec<TransitionBatch<f64>> {
    let mut rng = Rng::new(4, "learner", "test");
    let mut batch = || {
        let mut batch = TransitionBatch::new(8, SIZES[0], SIZES[1]);
        for numbers in [&mut batch.observations, &mut batch.next_observations, &mut batch.actions] {
            numbers.fill_with(|| rng.uniform(-1.0, 1.0));
        }
        batch.rewards.fill_with(|| rng.normal());
        batch.noise.fill_with(|| rng.normal());
        batch.not_terminal.fill(1.0);
        batch
    };
    (0..4).map(|_| batch()).collect()
}

/// `−mean Q(s, π(s'))`: the observations of the critic and those of the actor.
fn loss(actor: &Network<f64>, critic: &Network<f64>, fixed: &[f64], moved: &[f64], bound: f64) -> f64 {
    let [observation, action] = SIZES;
    let rows = fixed.chunks_exact(observation).zip(moved.chunks_exact(observation));
    let value = |(fixed, moved): (&[f64], &[f64])| {
        let (mut memory, mut actions, mut q) = (SingleRow::default(), vec![0.0; action], [0.0]);
        actor.forward_one(moved, &mut memory, &mut actions);
        let input: Vec<f64> = fixed.iter().copied().chain(actions.iter().map(|x| bound * x.tanh())).collect();
        critic.forward_one(&input, &mut memory, &mut q);
        q[0]
    };
    -rows.map(value).sum::<f64>() / (fixed.len() / observation) as f64
}

#[test]
fn input_gradients_are_slopes_through_the_actor_before_its_step() {
    const COLUMNS: usize = 3;
    const STEP: f64 = 1e-5;
    let mut learner = learner().with_input_gradient(COLUMNS).unwrap();
    assert_eq!(learner.input_gradient(), None);
    for (k, batch) in batches().iter().enumerate() {
        let actor = learner.actor().clone();
        learner.update(batch);
        if k % 2 == 0 {
            assert_eq!(learner.input_gradient(), None);
            continue;
        }
        let gradient = learner.input_gradient().unwrap();
        assert_eq!(gradient.len(), 8 * COLUMNS);
        let critic = &learner.critics[0].online;
        for (index, gradient) in gradient.iter().enumerate() {
            let at = |step: f64| {
                let mut moved = batch.observations.clone();
                moved[index / COLUMNS * SIZES[0] + index % COLUMNS] += step;
                loss(&actor, critic, &batch.observations, &moved, 1.5)
            };
            let slope = (at(STEP) - at(-STEP)) / (2.0 * STEP);
            assert!((slope - gradient).abs() < 1e-9, "{k} {index}: {slope} against {gradient}");
        }
        assert!(gradient.iter().any(|x| x.abs() > 1e-4), "{gradient:?}");
    }
}

#[test]
fn the_input_gradient_changes_nothing_of_the_training() {
    let (mut plain, mut with) = (learner(), learner().with_input_gradient(SIZES[0]).unwrap());
    for batch in batches() {
        assert_eq!(plain.update(&batch), with.update(&batch));
        assert_eq!(plain.input_gradient(), None);
    }
    assert_eq!((&plain.actor, &plain.critics), (&with.actor, &with.critics));
}

#[test]
fn gradients_of_columns_that_the_observation_lacks_are_refused() {
    let refused = |columns| learner().with_input_gradient(columns).unwrap_err().to_string();
    assert!(refused(6).contains("6") && refused(6).contains("1 to 5"), "{}", refused(6));
    assert!(refused(0).contains("1 to 5"), "{}", refused(0));
}

#[test]
fn tensors_from_elsewhere_end_the_last_update() {
    let mut learner = learner().with_input_gradient(2).unwrap();
    for batch in &batches()[..2] {
        learner.update(batch);
    }
    assert!(learner.input_gradient().is_some());
    let all = learner.tensors().into_iter().map(|t| (t.name, t.numbers.to_vec())).collect();
    learner.set_tensors(&all, 2).unwrap();
    assert_eq!(learner.input_gradient(), None);
}
