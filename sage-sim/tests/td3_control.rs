//! TD3 learns two control tasks in closed form as PyTorch's does (`td3_control_curve.json`).

use sage_core::seed::Rng;
use sage_sim::rl::{ReplayBuffer, SingleRow, Td3Learner, Td3Options, Transition, TransitionBatch};

/// A task of control: two numbers of state, one action.
struct Task {
    observation: usize,
    steps: usize,
    limit: usize,
    start: fn(&mut Rng) -> [f64; 2],
    grid: fn() -> Vec<[f64; 2]>,
    observe: fn([f64; 2]) -> Vec<f32>,
    /// Next state and reward.
    step: fn([f64; 2], f64) -> ([f64; 2], f64),
}

/// A mass on a line: reward −(x² + 0.1 v² + a²).
const INTEGRATOR: Task = Task {
    observation: 2,
    steps: 8000,
    limit: 100,
    start: |rng| [rng.uniform(-1.0, 1.0), rng.uniform(-0.5, 0.5)],
    grid: || {
        let xs = [-1.0, -0.5, 0.0, 0.5, 1.0];
        xs.iter().flat_map(|x| [-0.5, -0.25, 0.0, 0.25, 0.5].map(|v| [*x, v])).collect()
    },
    observe: |[x, v]| vec![x as f32, v as f32],
    step: |[x, v], a| {
        let reward = -(x * x + 0.1 * v * v + a * a);
        let v = (v + 0.1 * a).clamp(-2.0, 2.0);
        ([(x + 0.1 * v).clamp(-2.0, 2.0), v], reward)
    },
};

/// The swing-up of a pendulum: angle 0 is up.
const PENDULUM: Task = Task {
    observation: 3,
    steps: 12_000,
    limit: 200,
    start: |rng| [rng.uniform(-std::f64::consts::PI, std::f64::consts::PI), rng.uniform(-1.0, 1.0)],
    grid: || {
        let angle = |k: u32| std::f64::consts::TAU * ((f64::from(k) + 0.5) / 10.0) - std::f64::consts::PI;
        (0..10).flat_map(|k| [[angle(k), -0.5], [angle(k), 0.5]]).collect()
    },
    observe: |[angle, speed]| vec![angle.cos() as f32, angle.sin() as f32, speed as f32],
    step: |[angle, speed], torque| {
        let pi = std::f64::consts::PI;
        let wrapped = (angle + pi).rem_euclid(2.0 * pi) - pi;
        let reward = -(wrapped * wrapped + 0.1 * speed * speed + 0.001 * torque * torque);
        let speed = (speed + (15.0 * angle.sin() + 3.0 * torque) * 0.05).clamp(-8.0, 8.0);
        ([angle + 0.05 * speed, speed], reward)
    },
};

/// Largest action of both tasks.
const BOUND: f64 = 2.0;

/// Trains one seed. Returns the mean return over the task's grid of starts.
fn train(task: &Task, seed: u64, limit_is_terminal: bool) -> f64 {
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
    let mut buffer = ReplayBuffer::new(task.steps, sizes);
    let rng = |purpose| Rng::new(seed, "control", purpose);
    let (mut starts, mut noise, mut rows) = (rng("starts"), rng("exploration"), rng("batch"));
    let mut smoothing = rng("smoothing");
    let mut batch = TransitionBatch::new(options.batch, task.observation, 1);
    let (mut memory, mut action) = (SingleRow::default(), [0.0_f32]);
    let mut state = (task.start)(&mut starts);
    let mut at = buffer.start(&(task.observe)(state));
    let mut length = 0;
    for step in 0..task.steps {
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
    let starts = (task.grid)();
    let mut total = 0.0;
    for start in &starts {
        let mut state = *start;
        for _ in 0..task.limit {
            learner.act(&(task.observe)(state), &mut memory, &mut action);
            let (next, reward) = (task.step)(state, f64::from(action[0]));
            state = next;
            total += reward;
        }
    }
    total / starts.len() as f64
}

fn five_seeds(task: &Task, limit_is_terminal: bool) -> (f64, f64) {
    let returns: Vec<f64> = std::thread::scope(|scope| {
        let runs: Vec<_> =
            (0..5).map(|seed| scope.spawn(move || train(task, seed, limit_is_terminal))).collect();
        runs.into_iter().map(|run| run.join().expect("a run")).collect()
    });
    (returns.iter().sum::<f64>() / 5.0, returns.iter().copied().fold(f64::INFINITY, f64::min))
}

#[test]
fn the_double_integrator_is_learnt_and_a_terminal_limit_harms() {
    // PyTorch: mean −10.4, worst −11.5; optimum −8.97.
    let (mean, worst) = five_seeds(&INTEGRATOR, false);
    assert!(mean >= -12.5 && worst >= -16.0, "mean {mean}, worst {worst}");
    // PyTorch: −25.0.
    let (terminal, _) = five_seeds(&INTEGRATOR, true);
    assert!(terminal <= mean - 5.0, "mean {terminal} with a terminal limit, {mean} without");
}

#[test]
fn the_pendulum_is_swung_up() {
    // PyTorch: mean −167, worst −186; doing nothing −1230.
    let (mean, worst) = five_seeds(&PENDULUM, false);
    assert!(mean >= -200.0 && worst >= -260.0, "mean {mean}, worst {worst}");
}
