//! PPO's gradients and steps against candle's automatic differentiation of the losses.

mod ppo;

use ppo::reference::{Mistake, Reference, groups};
use sage_core::seed::Rng;
use sage_learn::{ActorCritic, After, Minibatch, PpoOptions, Real, Taught, advantages};
use sage_sim::actor::SingleRow;

/// Sizes of observation and action.
const SIZES: [usize; 2] = [7, 2];
/// Sizes of the observations of the steps' batches: gradients of some steps are below the largest norm.
const OBSERVATIONS: [f64; 5] = [1.0, 0.1, 2.0, 0.2, 1.0];
/// Weights of the imitation of a teacher in the steps' batches.
const TAUGHT: [f64; 5] = [0.0, 0.4, 0.0, 0.8, 1.0];

/// Every option differs from what leaves its term out.
fn options() -> PpoOptions {
    PpoOptions {
        hidden: [16, 16],
        environments: 8,
        horizon: 8,
        minibatch: 64,
        entropy: 0.03,
        gradient_norm: 0.8,
        ..PpoOptions::default()
    }
}

/// A learner whose weights give actions and values of all sizes, and a deviation for each action.
fn learner<T: Real>() -> ActorCritic<T> {
    let mut learner = ActorCritic::<T>::new(options(), SIZES, 5).expect("valid options");
    let mut rng = Rng::new(3, "weights", "test");
    let moved = learner.tensors().into_iter().map(|tensor| {
        let mut numbers = tensor.numbers.to_vec();
        if !tensor.name.starts_with("m.") && !tensor.name.starts_with("v.") {
            // Rounded, so that both precisions have the same weights.
            numbers
                .iter_mut()
                .for_each(|x| *x = T::of(f64::from((x.wide() + rng.uniform(-0.4, 0.4)) as f32)));
        }
        (tensor.name, numbers)
    });
    let owned = moved.collect();
    learner.set_tensors(&owned, 0).expect("its own tensors");
    learner
}

/// A batch of the learner's own actions, whose ratios are up to e^0.6 from 1, independent of the advantages.
fn random_batch<T: Real>(
    learner: &ActorCritic<T>,
    observations: f64,
    taught: f64,
    rng: &mut Rng,
) -> Minibatch<T> {
    let rows = learner.options().minibatch;
    let rounded = |x: f64| T::of(f64::from(x as f32));
    let observations: Vec<T> = (0..rows * SIZES[0]).map(|_| rounded(observations * rng.normal())).collect();
    let (mut actions, mut memory, deviations) = (Vec::new(), SingleRow::default(), learner.deviations());
    for row in observations.chunks_exact(SIZES[0]) {
        let mut mean = [T::of(0.0); SIZES[1]];
        learner.actor().forward_one(row, &mut memory, &mut mean);
        let all = mean.iter().zip(&deviations);
        actions.extend(all.map(|(mean, deviation)| rounded(mean.wide() + deviation * rng.normal())));
    }
    let mut batch = Minibatch {
        observations,
        actions,
        log_densities: vec![0.0; rows],
        advantages: (0..rows).map(|_| 0.7 + 2.0 * rng.normal()).collect(),
        returns: (0..rows).map(|_| rng.normal()).collect(),
        taught: Taught {
            actions: (0..rows * SIZES[1]).map(|_| rounded(rng.uniform(-1.0, 1.0))).collect(),
            weight: taught,
        },
    };
    let now = Reference::of(learner, None).log_densities(&batch).expect("candle");
    batch.log_densities = now.into_iter().map(|log| log + rng.uniform(-0.6, 0.6)).collect();
    batch
}

/// Largest difference of the gradients of actor, log deviations and critic, relative to the largest number of each,
/// and of the losses.
fn of_gradients<T: Real>(taught: f64, mistake: Option<Mistake>) -> f64 {
    let mut learner = learner::<T>();
    let batch = random_batch(&learner, 1.0, taught, &mut Rng::new(9, "gradients", "test"));
    let reference = Reference::of(&learner, mistake);
    if mistake.is_none() {
        let counts = reference.cut_rows(&batch).expect("candle");
        assert!(counts.as_flattened().iter().all(|count| *count >= 5), "{counts:?}");
    }
    let expected = reference.gradients(&batch).expect("candle");
    let report = learner.gradients(&batch);
    let mut worst = 0.0_f64;
    let mut note = |gap: f64| worst = if gap.is_nan() { f64::INFINITY } else { worst.max(gap) };
    for (found, names) in learner.last_gradients().into_iter().zip(groups()) {
        let wanted: Vec<f64> = names.iter().flat_map(|name| expected.of[name].iter().copied()).collect();
        assert_eq!(found.len(), wanted.len(), "{names:?}");
        let size = wanted.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        found.iter().zip(&wanted).for_each(|(x, y)| note((x.wide() - y).abs() / size));
    }
    for (found, wanted) in [report.actor_loss, report.critic_loss].into_iter().zip(expected.losses) {
        note((found - wanted).abs());
    }
    worst
}

/// Largest difference of any weight, deviation or moment after five steps.
fn after_steps<T: Real>(mistake: Option<Mistake>) -> f64 {
    let mut learner = learner::<T>();
    let mut rng = Rng::new(10, "steps", "test");
    let both = OBSERVATIONS.iter().zip(TAUGHT);
    let batches: Vec<_> =
        both.map(|(size, taught)| random_batch(&learner, *size, taught, &mut rng)).collect();
    let mut reference = Reference::of(&learner, mistake);
    for (k, batch) in batches.iter().enumerate() {
        let rate = 0.005 / (1.0 + k as f64);
        learner.step(batch, rate);
        reference.step(batch, rate).expect("candle");
    }
    if mistake.is_none() {
        for part in 0..2 {
            let is_cut = |norms: &[f64; 2]| norms[part] > learner.options().gradient_norm;
            let count = reference.norms.iter().filter(|norms| is_cut(norms)).count();
            assert!((1..OBSERVATIONS.len()).contains(&count), "{:?}", reference.norms);
        }
    }
    let (found, expected) = (learner.tensors(), reference.tensors());
    assert_eq!(found.len(), expected.len());
    let mut worst = 0.0_f64;
    for tensor in found {
        let expected = expected[&tensor.name];
        assert_eq!(tensor.numbers.len(), expected.len(), "{}", tensor.name);
        for (x, y) in tensor.numbers.iter().zip(expected) {
            let gap = (x.wide() - y).abs();
            worst = if gap.is_nan() { f64::INFINITY } else { worst.max(gap) };
        }
    }
    worst
}

#[test]
fn gradients_are_those_of_automatic_differentiation() {
    for taught in [0.0, 0.3, 0.9] {
        let (wide, narrow) = (of_gradients::<f64>(taught, None), of_gradients::<f32>(taught, None));
        println!(
            "gradients, taught {taught}: {wide:.1e} in double precision, {narrow:.1e} in single precision"
        );
        assert!(wide <= 1e-10, "{wide:e}");
        assert!(narrow <= 1e-5, "{narrow:e}");
    }
}

#[test]
fn steps_are_those_of_the_reference() {
    let (wide, narrow) = (after_steps::<f64>(None), after_steps::<f32>(None));
    println!("after five steps: {wide:.1e} in double precision, {narrow:.1e} in single precision");
    assert!(wide <= 1e-10, "{wide:e}");
    assert!(narrow <= 1e-5, "{narrow:e}");
}

#[test]
fn injected_faults_are_found() {
    for mistake in Mistake::LOSSES {
        let gap = of_gradients::<f64>(0.3, Some(mistake));
        println!("{mistake:?}: gradients {gap:.1e}");
        assert!(gap > 1e-3, "{mistake:?} is not found in the gradients: {gap:e}");
    }
    for mistake in Mistake::LOSSES.into_iter().chain(Mistake::STEPS) {
        let gap = after_steps::<f64>(Some(mistake));
        println!("{mistake:?}: after five steps {gap:.1e}");
        assert!(gap > 1e-5, "{mistake:?} is not found after five steps: {gap:e}");
    }
}

#[test]
fn mistakes_in_the_step_leave_the_gradients() {
    for mistake in Mistake::STEPS {
        let gap = of_gradients::<f64>(0.3, Some(mistake));
        assert!(gap <= 1e-10, "{mistake:?}: {gap:e}");
    }
}

/// A limit of steps cuts an episode off, arrival ends it: the difference is what would have followed.
#[test]
fn a_cut_and_an_end_differ_by_the_discounted_value_behind_them() {
    let (gamma, lambda, behind) = (0.97, 0.95, -3.7);
    let mut rng = Rng::new(4, "cuts", "test");
    let mut draw = || -> Vec<f64> { (0..9).map(|_| rng.uniform(-2.0, 2.0)).collect() };
    let (rewards, values) = (draw(), draw());
    let of = |sixth: After| {
        let mut after = [After::Next; 9];
        (after[2], after[5], after[8]) = (After::End, sixth, After::Cut(0));
        advantages(&rewards, &values, &after, &[0.3, behind], [gamma, lambda])
    };
    for (t, (cut, end)) in of(After::Cut(1)).into_iter().zip(of(After::End)).enumerate() {
        let expected = match t {
            // The stretch that is cut off: the difference decays by γλ a step.
            3..=5 => (gamma * lambda).powi(5 - t as i32) * gamma * behind,
            _ => 0.0,
        };
        assert!((cut - end - expected).abs() < 1e-14, "step {t}: {cut} and {end}");
    }
}
