//! PPO learns two control tasks in closed form, from its parts: networks, advantages and normalisation.

mod control_tasks;

use std::f64::consts::TAU;

use control_tasks::{BOUND, INTEGRATOR, PENDULUM, Task, mean_and_worst};
use sage_core::seed::Rng;
use sage_learn::{ActorCritic, After, Minibatch, PpoOptions, Running, advantages};
use sage_sim::actor::SingleRow;

fn options() -> PpoOptions {
    PpoOptions {
        hidden: [32, 32],
        environments: 16,
        horizon: 64,
        minibatch: 256,
        epochs: 6,
        rate: 3e-3,
        gamma: 0.98,
        ..PpoOptions::default()
    }
}

/// An episode in progress.
struct Episode {
    state: [f64; 2],
    length: usize,
    /// Discounted return so far.
    discounted: f64,
}

/// A row of stretches, one of each episode.
#[derive(Default)]
struct Batch {
    observations: Vec<f32>,
    actions: Vec<f32>,
    log_densities: Vec<f64>,
    rewards: Vec<f64>,
    after: Vec<After>,
    cuts: Vec<f32>,
    returns: Vec<f64>,
}

/// Actor and critic with the normalisation of their observations.
struct Policy {
    networks: ActorCritic<f32>,
    observations: Running,
    memory: SingleRow<f32>,
    row: Vec<f32>,
}

impl Policy {
    /// Mean action before the hyperbolic tangent.
    fn mean(&mut self, observation: &[f32]) -> f64 {
        let mut mean = [0.0];
        self.observations.normalise(observation, &mut self.row);
        self.networks.actor().forward_one(&self.row, &mut self.memory, &mut mean);
        f64::from(mean[0])
    }

    /// Values of normalised observations.
    fn values(&mut self, rows: &[f32], width: usize) -> Vec<f64> {
        let critic = self.networks.critic();
        let of = |row: &[f32]| {
            let mut value = [0.0];
            critic.forward_one(row, &mut self.memory, &mut value);
            f64::from(value[0])
        };
        rows.chunks_exact(width).map(of).collect()
    }
}

/// Drives a horizon of steps with every episode.
fn drive(
    task: &Task,
    policy: &mut Policy,
    episodes: &mut [Episode],
    [starts, noise]: &mut [Rng; 2],
) -> Batch {
    let mut batch = Batch::default();
    let deviation = policy.networks.deviations()[0];
    let PpoOptions { horizon, gamma, .. } = *policy.networks.options();
    for episode in episodes {
        for k in 1..=horizon {
            let observation = (task.observe)(episode.state);
            let z = noise.normal();
            let action = (policy.mean(&observation) + deviation * z) as f32;
            let (next, reward) = (task.step)(episode.state, BOUND * f64::from(action).tanh());
            (episode.state, episode.length) = (next, episode.length + 1);
            episode.discounted = gamma * episode.discounted + reward;
            batch.observations.extend_from_slice(&observation);
            batch.actions.push(action);
            batch.log_densities.push(-0.5 * (z * z + TAU.ln()) - deviation.ln());
            batch.rewards.push(reward);
            batch.returns.push(episode.discounted);
            let is_over = episode.length == task.limit;
            batch.after.push(if is_over || k == horizon {
                batch.cuts.extend((task.observe)(next));
                After::Cut(batch.cuts.len() / task.observation - 1)
            } else {
                After::Next
            });
            if is_over {
                *episode = Episode { state: (task.start)(starts), length: 0, discounted: 0.0 };
            }
        }
    }
    batch
}

/// Trains one seed. Returns the mean return over the task's grid of starts.
fn train(task: &Task, batches: usize, seed: u64) -> f64 {
    let (options, width) = (options(), task.observation);
    let rng = |purpose| Rng::new(seed, "ppo control", purpose);
    let (mut driving, mut order_rng) = ([rng("starts"), rng("exploration")], rng("minibatches"));
    let mut policy = Policy {
        networks: ActorCritic::new(options.clone(), [width, 1], seed).expect("valid options"),
        observations: Running::new(width),
        memory: SingleRow::default(),
        row: Vec::new(),
    };
    let mut returns = Running::new(1);
    // Episodes at different times of their limit.
    let mut episodes: Vec<Episode> = (0..options.environments)
        .map(|k| Episode {
            state: (task.start)(&mut driving[0]),
            length: k * task.limit / options.environments,
            discounted: 0.0,
        })
        .collect();
    let mut order: Vec<usize> = (0..options.batch()).collect();
    for done in 0..batches {
        let batch = drive(task, &mut policy, &mut episodes, &mut driving);
        policy.observations.add(&batch.observations);
        returns.add(&batch.returns);
        let size = returns.deviations()[0];
        let rewards: Vec<f64> = batch.rewards.iter().map(|reward| reward / size).collect();
        let (mut normalised, mut cuts) = (Vec::new(), Vec::new());
        policy.observations.normalise(&batch.observations, &mut normalised);
        policy.observations.normalise(&batch.cuts, &mut cuts);
        let (values, cut_values) = (policy.values(&normalised, width), policy.values(&cuts, width));
        let discounts = [options.gamma, options.gae_lambda];
        let advantages = advantages(&rewards, &values, &batch.after, &cut_values, discounts);
        let rate = options.rate * (1.0 - done as f64 / batches as f64);
        for _ in 0..options.epochs {
            order_rng.shuffle(&mut order);
            for rows in order.chunks_exact(options.minibatch) {
                let of = |all: &[f64]| rows.iter().map(|row| all[*row]).collect();
                let minibatch = Minibatch {
                    observations: rows
                        .iter()
                        .flat_map(|row| &normalised[row * width..][..width])
                        .copied()
                        .collect(),
                    actions: rows.iter().map(|row| batch.actions[*row]).collect(),
                    log_densities: of(&batch.log_densities),
                    advantages: of(&advantages),
                    returns: rows.iter().map(|row| advantages[*row] + values[*row]).collect(),
                    taught: Default::default(),
                };
                policy.networks.step(&minibatch, rate);
            }
        }
    }
    task.mean_return(|observation| BOUND * policy.mean(observation).tanh())
}

#[test]
fn the_double_integrator_is_learnt() {
    // Of 48 seeds: mean −9.4, worst −10.8. The optimum is −8.97; an untrained actor has −203.
    let (mean, worst) = mean_and_worst(5, |seed| train(&INTEGRATOR, 100, seed));
    println!("mean {mean:.2}, worst {worst:.2}");
    assert!(mean >= -10.5 && worst >= -12.0, "mean {mean}, worst {worst}");
}

#[test]
fn the_pendulum_is_swung_up() {
    // Of 48 seeds: mean −168, worst −185; an untrained actor has −1267.
    let (mean, worst) = mean_and_worst(5, |seed| train(&PENDULUM, 200, seed));
    println!("mean {mean:.1}, worst {worst:.1}");
    assert!(mean >= -200.0 && worst >= -260.0, "mean {mean}, worst {worst}");
}
