//! Two control tasks in closed form.

use sage_core::seed::Rng;

/// A task of control: two numbers of state, one action.
pub struct Task {
    pub observation: usize,
    pub limit: usize,
    pub start: fn(&mut Rng) -> [f64; 2],
    pub grid: fn() -> Vec<[f64; 2]>,
    pub observe: fn([f64; 2]) -> Vec<f32>,
    /// Next state and reward.
    pub step: fn([f64; 2], f64) -> ([f64; 2], f64),
}

/// A mass on a line: reward −(x² + 0.1 v² + a²).
pub const INTEGRATOR: Task = Task {
    observation: 2,
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
pub const PENDULUM: Task = Task {
    observation: 3,
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
pub const BOUND: f64 = 2.0;

impl Task {
    /// Mean return of a policy over the grid of starts.
    pub fn mean_return(&self, mut act: impl FnMut(&[f32]) -> f64) -> f64 {
        let starts = (self.grid)();
        let mut total = 0.0;
        for start in &starts {
            let mut state = *start;
            for _ in 0..self.limit {
                let (next, reward) = (self.step)(state, act(&(self.observe)(state)));
                state = next;
                total += reward;
            }
        }
        total / starts.len() as f64
    }
}

/// Mean and least return of the first seeds, one thread each.
pub fn mean_and_worst(seeds: u64, train: impl Fn(u64) -> f64 + Sync) -> (f64, f64) {
    let train = &train;
    let returns: Vec<f64> = std::thread::scope(|scope| {
        let runs: Vec<_> = (0..seeds).map(|seed| scope.spawn(move || train(seed))).collect();
        runs.into_iter().map(|run| run.join().expect("a run")).collect()
    });
    (returns.iter().sum::<f64>() / seeds as f64, returns.iter().copied().fold(f64::INFINITY, f64::min))
}
