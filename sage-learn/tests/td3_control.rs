//! TD3 learns two control tasks in closed form as PyTorch's does (`td3_control_curve.json`).

mod control_tasks;

use control_tasks::{BOUND, INTEGRATOR, PENDULUM, Task, mean_and_worst};
use sage_core::seed::Rng;
use sage_learn::{ReplayBuffer, Td3Learner, Td3Options, Transition, TransitionBatch};
use sage_sim::actor::SingleRow;

/// Trains one seed. Returns the mean return over the task's grid of starts.
fn train(task: &Task, steps: usize, seed: u64, limit_is_terminal: bool) -> f64 {
    let options = Td3Options {
        hidden: [64, 64],
        batch: 128,
        actor_rate: 1e-3,
        critic_rate: 1e-3,
        max_action: BOUND,
        random_steps: 1000,
        ..Td3Options::default()
    };
    let sizes = [task.observation, 1];
    let mut learner = Td3Learner::<f32>::new(options.clone(), sizes, seed).expect("valid options");
    let mut buffer = ReplayBuffer::new(steps, sizes);
    let rng = |purpose| Rng::new(seed, "control", purpose);
    let (mut starts, mut noise, mut rows) = (rng("starts"), rng("exploration"), rng("batch"));
    let mut smoothing = rng("smoothing");
    let mut batch = TransitionBatch::new(options.batch, task.observation, 1);
    let (mut memory, mut action) = (SingleRow::default(), [0.0_f32]);
    let mut state = (task.start)(&mut starts);
    let mut at = buffer.start(&(task.observe)(state));
    let mut length = 0;
    for step in 0..steps {
        let observation = (task.observe)(state);
        if (step as u64) < options.random_steps {
            action[0] = noise.uniform(-BOUND, BOUND) as f32;
        } else {
            learner.act(&observation, &mut memory, &mut action);
            let noisy = f64::from(action[0]) + noise.normal() * options.exploration_noise * BOUND;
            action[0] = noisy.clamp(-BOUND, BOUND) as f32;
        }
        let (next, reward) = (task.step)(state, f64::from(action[0]));
        state = next;
        length += 1;
        let is_over = length == task.limit;
        at = buffer.step(&Transition {
            from: at,
            action: &action,
            reward: reward as f32,
            is_terminal: is_over && limit_is_terminal,
            next: &(task.observe)(state),
        });
        if is_over {
            (state, length) = ((task.start)(&mut starts), 0);
            at = buffer.start(&(task.observe)(state));
        }
        if step as u64 >= options.random_steps {
            assert!(buffer.draw(&mut rows, &mut batch));
            batch.noise.fill_with(|| smoothing.normal() as f32);
            learner.update(&batch);
        }
    }
    task.mean_return(|observation| {
        learner.act(observation, &mut memory, &mut action);
        f64::from(action[0])
    })
}

#[test]
fn the_double_integrator_is_learnt_and_a_terminal_limit_harms() {
    // PyTorch: mean −10.4, worst −11.5; optimum −8.97.
    let (mean, worst) = mean_and_worst(5, |seed| train(&INTEGRATOR, 8000, seed, false));
    assert!(mean >= -12.5 && worst >= -16.0, "mean {mean}, worst {worst}");
    // PyTorch: −25.0.
    let (terminal, _) = mean_and_worst(5, |seed| train(&INTEGRATOR, 8000, seed, true));
    assert!(terminal <= mean - 5.0, "mean {terminal} with a terminal limit, {mean} without");
}

#[test]
fn the_pendulum_is_swung_up() {
    // PyTorch: mean −167, worst −186; doing nothing −1230.
    let (mean, worst) = mean_and_worst(5, |seed| train(&PENDULUM, 12_000, seed, false));
    assert!(mean >= -200.0 && worst >= -260.0, "mean {mean}, worst {worst}");
}
