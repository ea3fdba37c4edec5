//! The driving policy of an actor network.

use std::sync::Arc;

use super::{Network, SingleRow};
use crate::{
    Error,
    observation::{LAST_ACTION, LENGTH, ObservationKind},
    policy::{Driver, EgoPolicy, Start, View},
    vehicle::Action,
    world::Control,
};

/// Drives by the actor: steering and throttle are the hyperbolic tangents of its two outputs, or lie between them and the
/// last ones.
#[derive(Clone, Debug)]
pub struct ActorPolicy {
    network: Arc<Network<f32>>,
    observes: ObservationKind,
    kept: f32,
}

impl ActorPolicy {
    /// The policy of an actor with 101 inputs and 2 outputs.
    pub fn new(network: Network<f32>) -> Self {
        Self { network: Arc::new(network), observes: ObservationKind::Corrected, kept: 0.0 }
    }

    /// The same for another kind of observation.
    pub fn observing(self, observes: ObservationKind) -> Self {
        Self { observes, ..self }
    }

    /// The same with actions that keep a share of the last one.
    pub fn keeping(self, kept: f64) -> Self {
        Self { kept: kept as f32, ..self }
    }

    /// The actor.
    pub fn network(&self) -> &Network<f32> {
        &self.network
    }
}

impl EgoPolicy for ActorPolicy {
    fn observes(&self) -> ObservationKind {
        self.observes
    }

    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(ActorDriver {
            network: self.network.clone(),
            kept: self.kept,
            memory: SingleRow::default(),
        }))
    }
}

#[derive(Clone)]
struct ActorDriver {
    network: Arc<Network<f32>>,
    kept: f32,
    memory: SingleRow<f32>,
}

/// The action of an actor's outputs before the hyperbolic tangent, with a share of the last action, which the observation shows.
pub fn action_of(outputs: [f32; 2], observation: &[f32; LENGTH], kept: f32) -> [f32; 2] {
    let aims = outputs.map(f32::tanh);
    if kept == 0.0 {
        return aims;
    }
    let last = LAST_ACTION.map(|at| 2.0 * observation[at] - 1.0);
    [0, 1].map(|k| kept * last[k] + (1.0 - kept) * aims[k])
}

/// The aims, −1 to 1, whose [`action_of`] comes closest to an action.
pub fn aims_of(action: [f32; 2], observation: &[f32; LENGTH], kept: f32) -> [f32; 2] {
    let last = LAST_ACTION.map(|at| 2.0 * observation[at] - 1.0);
    [0, 1].map(|k| ((action[k] - kept * last[k]) / (1.0 - kept)).clamp(-1.0, 1.0))
}

impl Driver for ActorDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let Some(observation) = view.observation() else {
            return Err(view.error(
                "a learnt policy drives the ego only; name another for the adversary, or as a teacher"
                    .to_owned(),
            ));
        };
        let mut output = [0.0; 2];
        self.network.forward_one(observation, &mut self.memory, &mut output);
        let [steer, throttle] = action_of(output, observation, self.kept).map(f64::from);
        if !(steer.is_finite() && throttle.is_finite()) {
            let column = observation.iter().position(|x| !x.is_finite());
            let what = match column {
                Some(column) => format!("number {column} of its observation is not finite"),
                None => "its weights hold a number that is not finite".to_owned(),
            };
            return Err(view.error(format!("the action of the learnt policy is not a number: {what}")));
        }
        Ok(Control::Drive(Action { steer, throttle }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}
