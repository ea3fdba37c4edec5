//! One TD3 learner: networks, targets, optimisers, and the update from a batch.
//!
//! Update number k = 1, 2, …:
//! 1. `y = r + (1 − d) γ min(Q₁', Q₂')(s', a')`, `a' = clip(π'(s') + clip(σ n, ±c), ±a_max)`, n standard normal.
//! 2. One Adam step of both critics on `mean (Q₁ − y)² + mean (Q₂ − y)²`.
//! 3. If `policy_delay` divides k: one Adam step of the actor on `−mean Q₁(s, π(s))`, with the critic after its step;
//!    then all targets move by τ.

#[cfg(test)]
#[path = "tests.rs"]
mod tests;

use std::collections::BTreeMap;

use sage_core::seed::Rng;
use sage_sim::{
    Error,
    actor::{Network, Shape, SingleRow},
};

use super::{
    super::{
        NamedTensor,
        adam::{Following, Moments},
        kernels::{Real, join},
        named_tensors::{check, set, views, with_broken},
    },
    Td3Options,
};
use crate::batch_passes::{Activations, BatchPasses as _, HiddenGradients};

/// A network with its target and optimiser.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Trained<T> {
    pub(super) online: Network<T>,
    pub(super) target: Network<T>,
    pub(super) moments: Moments<T>,
}

impl<T: Real> Trained<T> {
    fn new(online: Network<T>) -> Self {
        let moments = Moments::new(online.parameters().len());
        Self { target: online.clone(), online, moments }
    }
}

/// Transitions of one update, as columns.
#[derive(Clone, Debug, PartialEq)]
pub struct TransitionBatch<T> {
    /// Observations, rows × observation size.
    pub observations: Vec<T>,
    /// Actions, rows × action size.
    pub actions: Vec<T>,
    /// Rewards.
    pub rewards: Vec<T>,
    /// Observations after the step.
    pub next_observations: Vec<T>,
    /// 1, or 0 where the step ended the episode by arrival or failure.
    pub not_terminal: Vec<T>,
    /// Standard normal draws for the noise of the target actions, rows × action size.
    pub noise: Vec<T>,
}

impl<T: Real> TransitionBatch<T> {
    /// A batch of zeros.
    pub fn new(rows: usize, observation: usize, action: usize) -> Self {
        let zeros = |width: usize| vec![T::default(); rows * width];
        Self {
            observations: zeros(observation),
            actions: zeros(action),
            rewards: zeros(1),
            next_observations: zeros(observation),
            not_terminal: zeros(1),
            noise: zeros(action),
        }
    }
}

/// What an update shows about the learner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UpdateReport {
    /// Loss of the critics before the step.
    pub critic_loss: f64,
    /// Loss of the actor before its step, in the updates that have one.
    pub actor_loss: Option<f64>,
    /// Mean absolute value of the first critic over the batch, before the step.
    pub mean_abs_q: f64,
}

/// Working memory of an update. Both critics use the same, which leaves more of the cache to the weights.
#[derive(Clone, Debug)]
struct Scratch<T> {
    actor: Activations<T>,
    critic: Activations<T>,
    joined: Vec<T>,
    actions: Vec<T>,
    targets: Vec<T>,
    q_gradient: Vec<T>,
    action_gradient: Vec<T>,
    hidden: HiddenGradients<T>,
    gradient: Vec<T>,
}

/// Gradient of the actor's loss with respect to the first numbers of each observation.
#[derive(Clone, Debug)]
struct InputGradient<T> {
    columns: usize,
    /// Rows × columns.
    numbers: Vec<T>,
    /// Whether it belongs to the last update.
    is_current: bool,
}

/// A TD3 learner.
#[derive(Clone, Debug)]
pub struct Td3Learner<T> {
    options: Td3Options,
    sizes: [usize; 2],
    pub(super) actor: Trained<T>,
    pub(super) critics: [Trained<T>; 2],
    updates: u64,
    scratch: Scratch<T>,
    input_gradient: Option<InputGradient<T>>,
}

impl<T: Real> Td3Learner<T> {
    /// A learner with random initial weights for an observation and an action size.
    ///
    /// *Errors*: as [`Td3Options::check`].
    pub fn new(options: Td3Options, [observation, action]: [usize; 2], seed: u64) -> Result<Self, Error> {
        options.check()?;
        if observation == 0 || action == 0 {
            return Err(Error::Value(format!(
                "{observation} observations and {action} actions; expected at least one of each"
            )));
        }
        let network = |purpose, inputs, outputs| {
            let shape = Shape { inputs, hidden: options.hidden, outputs };
            Trained::new(Network::random(shape, &mut Rng::new(seed, "", purpose)))
        };
        let actor = network("actor", observation, action);
        let critics = ["critic 1", "critic 2"].map(|purpose| network(purpose, observation + action, 1));
        let (rows, q) = (options.batch, *critics[0].online.shape());
        let zeros = |width: usize| vec![T::default(); rows * width];
        let scratch = Scratch {
            actor: Activations::new(rows, actor.online.shape()),
            critic: Activations::new(rows, &q),
            joined: zeros(observation + action),
            actions: zeros(action),
            targets: zeros(1),
            q_gradient: zeros(1),
            action_gradient: zeros(action),
            hidden: HiddenGradients::new(rows, &q),
            gradient: vec![T::default(); q.count().max(actor.online.shape().count())],
        };
        let sizes = [observation, action];
        Ok(Self { options, sizes, actor, critics, updates: 0, scratch, input_gradient: None })
    }

    /// Computes, in the updates with a step of the actor, also the gradient of the actor's loss with respect to the
    /// first `columns` numbers of each observation. It is the gradient through the actor alone: the observation that
    /// the critic reads is taken as fixed. It trains an encoder before the actor, and changes no bit of the learner's
    /// own training.
    ///
    /// *Errors*: no column, or more than the observation has.
    pub fn with_input_gradient(mut self, columns: usize) -> Result<Self, Error> {
        let [observation, _] = self.sizes;
        if !(1..=observation).contains(&columns) {
            return Err(Error::Value(format!(
                "a gradient of {columns} numbers of an observation; expected 1 to {observation}"
            )));
        }
        let numbers = vec![T::default(); self.options.batch * columns];
        self.input_gradient = Some(InputGradient { columns, numbers, is_current: false });
        Ok(self)
    }

    /// The gradient of [`Td3Learner::with_input_gradient`] for the batch of the last update, rows × columns, with the
    /// actor before its step and the critic after its own. `None` if that update had no step of the actor, or if it
    /// is not asked for.
    pub fn input_gradient(&self) -> Option<&[T]> {
        self.input_gradient
            .as_ref()
            .filter(|gradient| gradient.is_current)
            .map(|gradient| &gradient.numbers[..])
    }

    /// Options.
    pub fn options(&self) -> &Td3Options {
        &self.options
    }

    /// The actor.
    pub fn actor(&self) -> &Network<T> {
        &self.actor.online
    }

    /// Number of updates so far.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// The action of the actor for one observation, without noise.
    pub fn act(&self, observation: &[T], memory: &mut SingleRow<T>, action: &mut [T]) {
        self.actor.online.forward_one(observation, memory, action);
        let bound = T::of(self.options.max_action);
        for x in action {
            *x = bound * x.hyperbolic_tangent();
        }
    }

    /// All tensors that change: networks, targets (`target.…`) and moments (`m.…`, `v.…`), as views.
    pub fn tensors(&self) -> Vec<NamedTensor<'_, T>> {
        let mut all = Vec::new();
        for (network, trained) in self.parts() {
            let columns = [
                ("", trained.online.parameters()),
                ("target.", trained.target.parameters()),
                ("m.", &trained.moments.first[..]),
                ("v.", &trained.moments.second[..]),
            ];
            all.extend(views(network, trained.online.shape(), columns));
        }
        all
    }

    /// Sets all tensors and the number of updates.
    ///
    /// *Errors*: the name of a tensor that is missing or has another size; nothing has changed then.
    pub fn set_tensors(&mut self, tensors: &BTreeMap<String, Vec<T>>, updates: u64) -> Result<(), Error> {
        check(&self.tensors(), tensors)?;
        let [q1, q2] = &mut self.critics;
        for (network, trained) in [("actor", &mut self.actor), ("critic.q1", q1), ("critic.q2", q2)] {
            let shape = *trained.online.shape();
            let columns = [
                ("", trained.online.parameters_mut()),
                ("target.", trained.target.parameters_mut()),
                ("m.", &mut trained.moments.first[..]),
                ("v.", &mut trained.moments.second[..]),
            ];
            set(network, &shape, columns, tensors);
        }
        self.updates = updates;
        self.forget_input_gradient();
        Ok(())
    }

    /// Name of the first tensor of the online networks with a number that is not finite.
    pub fn not_finite(&self) -> Option<String> {
        self.parts()
            .into_iter()
            .find_map(|(network, trained)| Some(format!("{network}.{}", trained.online.not_finite()?)))
    }

    /// Sets the first number of a tensor to NaN.
    pub(super) fn break_weight(&mut self, tensor: &str) {
        let all = with_broken(&self.tensors(), tensor);
        // The names and sizes are its own.
        let _ = self.set_tensors(&all, self.updates);
    }

    fn parts(&self) -> [(&'static str, &Trained<T>); 3] {
        let [q1, q2] = &self.critics;
        [("actor", &self.actor), ("critic.q1", q1), ("critic.q2", q2)]
    }

    /// The targets `y` of the last update.
    pub fn last_targets(&self) -> &[T] {
        &self.scratch.targets
    }

    /// One update. `batch` holds [`Td3Options::batch`] rows.
    pub fn update(&mut self, batch: &TransitionBatch<T>) -> UpdateReport {
        debug_assert_eq!(batch.rewards.len(), self.options.batch);
        self.updates += 1;
        self.forget_input_gradient();
        let acts = self.updates.is_multiple_of(self.options.policy_delay);
        self.compute_targets(batch);
        let (critic_loss, mean_abs_q) = self.update_critics(batch, acts);
        let actor_loss = acts.then(|| self.update_actor(batch));
        UpdateReport { critic_loss, actor_loss, mean_abs_q }
    }

    fn forget_input_gradient(&mut self) {
        if let Some(gradient) = &mut self.input_gradient {
            gradient.is_current = false;
        }
    }

    /// Step 1: the targets of the critics.
    fn compute_targets(&mut self, batch: &TransitionBatch<T>) {
        let (options, s) = (&self.options, &mut self.scratch);
        let bound = T::of(options.max_action);
        let noise = T::of(options.target_noise * options.max_action);
        let clip = T::of(options.noise_clip * options.max_action);
        self.actor.target.forward(&batch.next_observations, &mut s.actor);
        for ((a, x), n) in s.actions.iter_mut().zip(&s.actor.output).zip(&batch.noise) {
            let smoothing = clamp(*n * noise, clip);
            *a = clamp(bound * x.hyperbolic_tangent() + smoothing, bound);
        }
        join(&mut s.joined, &batch.next_observations, &s.actions, self.sizes);
        let [first, second] = &self.critics;
        first.target.forward(&s.joined, &mut s.critic);
        s.targets.copy_from_slice(&s.critic.output);
        second.target.forward(&s.joined, &mut s.critic);
        let gamma = T::of(options.gamma);
        let rewards = batch.rewards.iter().zip(&batch.not_terminal);
        for ((y, q2), (r, go_on)) in s.targets.iter_mut().zip(&s.critic.output).zip(rewards) {
            // NaN in either one must show: comparisons alone would drop it.
            let least = if *q2 < *y || q2.wide().is_nan() { *q2 } else { *y };
            *y = *r + *go_on * gamma * least;
        }
    }

    /// Step 2: one step of both critics. Returns the loss and the mean |Q₁|.
    fn update_critics(&mut self, batch: &TransitionBatch<T>, moves_targets: bool) -> (f64, f64) {
        let (options, s) = (&self.options, &mut self.scratch);
        join(&mut s.joined, &batch.observations, &batch.actions, self.sizes);
        let rows = options.batch as f64;
        let scale = T::of(2.0 / rows);
        let (mut loss, mut mean_abs_q) = (0.0, 0.0);
        let at = &mut s.critic;
        for (k, critic) in self.critics.iter_mut().enumerate() {
            critic.online.forward(&s.joined, at);
            for ((g, q), y) in s.q_gradient.iter_mut().zip(&at.output).zip(&s.targets) {
                let error = *q - *y;
                *g = scale * error;
                loss += error.wide() * error.wide() / rows;
            }
            if k == 0 {
                mean_abs_q = at.output.iter().map(|q| q.wide().abs()).sum::<f64>() / rows;
            }
            let gradient = &mut s.gradient[..critic.online.shape().count()];
            critic.online.backward(&s.joined, at, &s.q_gradient, &mut s.hidden, gradient);
            let target = critic.target.parameters_mut();
            let follows = moves_targets.then_some(Following { target, tau: options.tau });
            let online = critic.online.parameters_mut();
            critic.moments.step(online, gradient, follows, options.critic_rate, self.updates, options.adam());
        }
        (loss, mean_abs_q)
    }

    /// Step 3: one step of the actor. Returns its loss.
    fn update_actor(&mut self, batch: &TransitionBatch<T>) -> f64 {
        let (options, s) = (&self.options, &mut self.scratch);
        let [observation, action] = self.sizes;
        let bound = T::of(options.max_action);
        self.actor.online.forward(&batch.observations, &mut s.actor);
        // From here on, the output of the actor is tanh of its last layer.
        for (a, x) in s.actions.iter_mut().zip(&mut s.actor.output) {
            *x = x.hyperbolic_tangent();
            *a = bound * *x;
        }
        join(&mut s.joined, &batch.observations, &s.actions, self.sizes);
        let (critic, at) = (&self.critics[0].online, &mut s.critic);
        critic.forward(&s.joined, at);
        let rows = options.batch as f64;
        let loss = -at.output.iter().map(|q| q.wide()).sum::<f64>() / rows;
        s.q_gradient.fill(T::of(-1.0 / rows));
        let columns = observation..observation + action;
        critic.backward_to_inputs(at, &s.q_gradient, &mut s.hidden, columns, &mut s.action_gradient);
        for (g, tanh) in s.action_gradient.iter_mut().zip(&s.actor.output) {
            *g = *g * bound * (T::of(1.0) - *tanh * *tanh);
        }
        let gradient = &mut s.gradient[..self.actor.online.shape().count()];
        let actor = &mut self.actor;
        actor.online.backward(&batch.observations, &s.actor, &s.action_gradient, &mut s.hidden, gradient);
        if let Some(InputGradient { columns, numbers, is_current }) = &mut self.input_gradient {
            actor.online.first_input_gradients(&s.hidden, *columns, numbers);
            *is_current = true;
        }
        let step = self.updates / options.policy_delay;
        let follows = Some(Following { target: actor.target.parameters_mut(), tau: options.tau });
        let online = actor.online.parameters_mut();
        actor.moments.step(online, gradient, follows, options.actor_rate, step, options.adam());
        loss
    }
}

/// Limits to ±bound; NaN stays NaN.
fn clamp<T: Real>(x: T, bound: T) -> T {
    if x > bound {
        bound
    } else if x < -bound {
        -bound
    } else {
        x
    }
}
