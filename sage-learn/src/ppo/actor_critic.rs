//! Actor and critic of PPO (Schulman et al. 2017, arXiv 1707.06347), and one step of both from a minibatch.
//!
//! An action is `tanh(u)`, u normal with the actor's outputs as mean and a deviation that no observation changes. The
//! hyperbolic tangent cancels in the ratio of two probabilities of the same action, so only u counts. Losses, n rows:
//!
//! - actor: `−1/n Σ min(ρ A, clip(ρ, 1 ± c) A) − w Σ log σ`, ρ the ratio, A the advantage normalised in the minibatch;
//! - critic: `1/(2n) Σ (V − R)²`;
//! - imitation of a teacher's actions a: `5/n Σ (tanh(μ) − a)²`, μ the actor's outputs. With weight β it makes β of the
//!   actor's loss, and the actor's loss above 1 − β.
//!
//! The gradient of each is cut to a norm before Adam's step.

use std::f64::consts::TAU;

use sage_core::seed::Rng;
use sage_sim::{
    Error,
    actor::{Network, Shape},
};

use super::{
    super::{
        adam::{Adam, Moments},
        kernels::Real,
    },
    PpoOptions,
};
use crate::batch_passes::{Activations, BatchPasses as _, HiddenGradients};

/// Weight of a squared difference from a teacher's action.
const IMITATION: f64 = 5.0;

/// Steps for an update; one row each.
#[derive(Clone, Debug, Default)]
pub struct Minibatch<T> {
    /// Normalised observations.
    pub observations: Vec<T>,
    /// Actions before the hyperbolic tangent.
    pub actions: Vec<T>,
    /// Logarithms of the densities of the actions when they were drawn.
    pub log_densities: Vec<f64>,
    /// Advantages.
    pub advantages: Vec<f64>,
    /// Returns that the critic is to predict.
    pub returns: Vec<f64>,
    /// What a teacher would have done.
    pub taught: Taught<T>,
}

/// Actions of a teacher for the rows of a minibatch.
#[derive(Clone, Debug, Default)]
pub struct Taught<T> {
    /// The actions, −1 to 1; none without a teacher.
    pub actions: Vec<T>,
    /// Weight of their imitation, 0 to 1; 0 without a teacher.
    pub weight: f64,
}

/// What a step shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Loss of the actor before the step.
    pub actor_loss: f64,
    /// Loss of the critic before the step.
    pub critic_loss: f64,
    /// Mean size of the critic's values.
    pub mean_abs_value: f64,
}

/// A network with what its training needs.
#[derive(Clone, Debug)]
pub(super) struct Trained<T> {
    pub(super) network: Network<T>,
    pub(super) moments: Moments<T>,
    at: Activations<T>,
    hidden: HiddenGradients<T>,
    output: Vec<T>,
    pub(super) gradient: Vec<T>,
}

impl<T: Real> Trained<T> {
    fn new(network: Network<T>, rows: usize) -> Self {
        let shape = *network.shape();
        let count = shape.count();
        Self {
            moments: Moments::new(count),
            at: Activations::new(rows, &shape),
            hidden: HiddenGradients::new(rows, &shape),
            output: vec![T::default(); rows * shape.outputs],
            gradient: vec![T::default(); count],
            network,
        }
    }
}

/// Actor and critic.
#[derive(Clone, Debug)]
pub struct ActorCritic<T> {
    options: PpoOptions,
    pub(super) actor: Trained<T>,
    pub(super) critic: Trained<T>,
    /// Logarithms of the deviations of the actions.
    pub(super) log_deviations: Vec<T>,
    pub(super) deviation_moments: Moments<T>,
    deviation_gradient: Vec<T>,
    steps: u64,
}

impl<T: Real> ActorCritic<T> {
    /// Networks with orthogonal initial weights for an observation and an action size.
    ///
    /// *Errors*: as [`PpoOptions::check`]; a size of 0.
    pub fn new(options: PpoOptions, [observation, action]: [usize; 2], seed: u64) -> Result<Self, Error> {
        options.check()?;
        if observation == 0 || action == 0 {
            return Err(Error::Value(format!(
                "{observation} observations and {action} actions; expected at least one of each"
            )));
        }
        let network = |purpose, outputs, last| {
            let shape = Shape { inputs: observation, hidden: options.hidden, outputs };
            Network::orthogonal(
                shape,
                [f64::sqrt(2.0), f64::sqrt(2.0), last],
                &mut Rng::new(seed, "", purpose),
            )
        };
        let rows = options.minibatch;
        Ok(Self {
            actor: Trained::new(network("actor", action, 0.01), rows),
            critic: Trained::new(network("critic", 1, 1.0), rows),
            log_deviations: vec![T::of(options.deviation.ln()); action],
            deviation_moments: Moments::new(action),
            deviation_gradient: vec![T::default(); action],
            steps: 0,
            options,
        })
    }

    /// Options.
    pub fn options(&self) -> &PpoOptions {
        &self.options
    }

    /// The actor; its observations are normalised ones.
    pub fn actor(&self) -> &Network<T> {
        &self.actor.network
    }

    /// The critic; its observations are normalised ones.
    pub fn critic(&self) -> &Network<T> {
        &self.critic.network
    }

    /// Standard deviations of the actions before the hyperbolic tangent.
    pub fn deviations(&self) -> Vec<f64> {
        self.log_deviations.iter().map(|x| x.wide().exp()).collect()
    }

    /// Steps so far.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    pub(super) fn set_steps(&mut self, steps: u64) {
        self.steps = steps;
    }

    /// Values of normalised observations, in the batches of `at`.
    pub(super) fn values(&self, observations: &[T], at: &mut Activations<T>, to: &mut Vec<f64>) {
        to.clear();
        let width = self.critic.network.shape().inputs;
        let rows = at.output.len();
        for chunk in observations.chunks(rows * width) {
            let count = chunk.len() / width;
            if count == rows {
                self.critic.network.forward(chunk, at);
                to.extend(at.output.iter().map(|x| x.wide()));
            } else {
                let mut rest = Activations::new(count, self.critic.network.shape());
                self.critic.network.forward(chunk, &mut rest);
                to.extend(rest.output.iter().map(|x| x.wide()));
            }
        }
    }

    /// Computes the losses and the gradients of all parameters.
    pub fn gradients(&mut self, batch: &Minibatch<T>) -> StepReport {
        let actor_loss = self.actor_gradient(batch);
        let critic = &mut self.critic;
        critic.network.forward(&batch.observations, &mut critic.at);
        let rows = batch.returns.len() as f64;
        let (mut critic_loss, mut mean_abs_value) = (0.0, 0.0);
        for ((g, value), wanted) in critic.output.iter_mut().zip(&critic.at.output).zip(&batch.returns) {
            let error = value.wide() - wanted;
            critic_loss += 0.5 * error * error / rows;
            mean_abs_value += value.wide().abs() / rows;
            *g = T::of(error / rows);
        }
        let Trained { network, at, hidden, output, gradient, .. } = critic;
        network.backward(&batch.observations, at, output, hidden, gradient);
        StepReport { actor_loss, critic_loss, mean_abs_value }
    }

    /// Gradients of the actor, of the logarithms of the deviations, and of the critic, before their cut.
    pub fn last_gradients(&self) -> [&[T]; 3] {
        [&self.actor.gradient, &self.deviation_gradient, &self.critic.gradient]
    }

    /// Loss and gradient of the actor and of the deviations.
    fn actor_gradient(&mut self, batch: &Minibatch<T>) -> f64 {
        let (actor, options) = (&mut self.actor, &self.options);
        actor.network.forward(&batch.observations, &mut actor.at);
        let size = self.log_deviations.len();
        let rows = batch.advantages.len() as f64;
        let mean = batch.advantages.iter().sum::<f64>() / rows;
        let variance = batch.advantages.iter().map(|a| (a - mean).powi(2)).sum::<f64>() / rows;
        let scale = 1.0 / (variance.sqrt() + 1e-8);
        let logs: Vec<f64> = self.log_deviations.iter().map(|x| x.wide()).collect();
        let precisions: Vec<f64> = logs.iter().map(|log| (-log).exp()).collect();
        let mut of_deviations = vec![-options.entropy; size];
        let mut loss = -options.entropy * logs.iter().sum::<f64>();
        let all = actor.at.output.chunks_exact(size).zip(batch.actions.chunks_exact(size));
        let known = batch.log_densities.iter().zip(&batch.advantages);
        for (((mean_action, action), (before, advantage)), gradient) in
            all.zip(known).zip(actor.output.chunks_exact_mut(size))
        {
            let advantage = (advantage - mean) * scale;
            let log_density = log_density(action, mean_action, &logs, &precisions);
            let ratio = (log_density - before).exp();
            let cut = ratio.clamp(1.0 - options.clip, 1.0 + options.clip);
            loss -= (ratio * advantage).min(cut * advantage) / rows;
            // Where the cut ratio is the smaller one, it does not move.
            let is_cut = (advantage > 0.0 && ratio > cut) || (advantage < 0.0 && ratio < cut);
            let of_log_density = if is_cut { 0.0 } else { -ratio * advantage / rows };
            for (k, g) in gradient.iter_mut().enumerate() {
                let z = (action[k].wide() - mean_action[k].wide()) * precisions[k];
                *g = T::of(of_log_density * z * precisions[k]);
                of_deviations[k] += of_log_density * (z * z - 1.0);
            }
        }
        self.deviation_gradient.iter_mut().zip(of_deviations).for_each(|(g, x)| *g = T::of(x));
        let Taught { actions: taught, weight } = &batch.taught;
        if *weight > 0.0 {
            debug_assert_eq!(taught.len(), batch.actions.len());
            let scale = T::of(1.0 - weight);
            self.deviation_gradient.iter_mut().for_each(|g| *g *= scale);
            let imitated = imitation(&actor.at.output, taught, rows, *weight, &mut actor.output);
            loss = (1.0 - weight) * loss + imitated;
        }
        let Trained { network, at, hidden, output, gradient, .. } = actor;
        network.backward(&batch.observations, at, output, hidden, gradient);
        loss
    }

    /// One step from a minibatch of [`PpoOptions::minibatch`] rows, at a learning rate.
    pub fn step(&mut self, batch: &Minibatch<T>, rate: f64) -> StepReport {
        debug_assert_eq!(batch.returns.len(), self.options.minibatch);
        let report = self.gradients(batch);
        self.steps += 1;
        let most = self.options.gradient_norm;
        cut_norm(&mut [&mut self.actor.gradient, &mut self.deviation_gradient], most);
        cut_norm(&mut [&mut self.critic.gradient], most);
        let (adam, step) = (Adam { betas: self.options.betas, epsilon: self.options.epsilon }, self.steps);
        for Trained { network, moments, gradient, .. } in [&mut self.actor, &mut self.critic] {
            moments.step(network.parameters_mut(), gradient, None, rate, step, adam);
        }
        self.deviation_moments.step(
            &mut self.log_deviations,
            &self.deviation_gradient,
            None,
            rate,
            step,
            adam,
        );
        report
    }
}

/// Adds the weighted gradient of the imitation to the rest of another gradient. Returns the weighted loss.
fn imitation<T: Real>(outputs: &[T], taught: &[T], rows: f64, weight: f64, gradient: &mut [T]) -> f64 {
    let mut loss = 0.0;
    for ((output, wanted), g) in outputs.iter().zip(taught).zip(gradient) {
        let action = output.wide().tanh();
        let error = action - wanted.wide();
        let share = weight * IMITATION / rows;
        loss += share * error * error;
        *g = T::of((1.0 - weight) * g.wide() + 2.0 * share * error * (1.0 - action * action));
    }
    loss
}

/// Logarithm of the density of an action before the hyperbolic tangent.
pub(super) fn log_density<T: Real>(action: &[T], mean: &[T], logs: &[f64], precisions: &[f64]) -> f64 {
    let of_one = |k: usize| {
        let z = (action[k].wide() - mean[k].wide()) * precisions[k];
        -0.5 * (z * z + TAU.ln()) - logs[k]
    };
    (0..logs.len()).map(of_one).sum()
}

/// Scales parts of a gradient so that their common norm is at most a number.
fn cut_norm<T: Real>(parts: &mut [&mut Vec<T>], most: f64) {
    let norm = parts.iter().flat_map(|part| part.iter()).map(|x| x.wide().powi(2)).sum::<f64>().sqrt();
    if norm > most {
        let factor = T::of(most / norm);
        parts.iter_mut().flat_map(|part| part.iter_mut()).for_each(|x| *x *= factor);
    }
}
