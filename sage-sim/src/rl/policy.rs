//! The driving policy of an actor network.

use std::sync::Arc;

use super::{Network, SingleRow};
use crate::{
    Error,
    observation::ObservationKind,
    policy::{Driver, EgoPolicy, Start, View},
    vehicle::Action,
    world::Control,
};

/// Drives by the actor: steering and throttle are the hyperbolic tangents of its two outputs.
#[derive(Clone, Debug)]
pub struct ActorPolicy {
    network: Arc<Network<f32>>,
    observes: ObservationKind,
}

impl ActorPolicy {
    /// The policy of an actor with 101 inputs and 2 outputs.
    pub fn new(network: Network<f32>) -> Self {
        Self { network: Arc::new(network), observes: ObservationKind::Corrected }
    }

    /// The same for another kind of observation.
    pub fn observing(self, observes: ObservationKind) -> Self {
        Self { observes, ..self }
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
        Ok(Box::new(ActorDriver { network: self.network.clone(), memory: SingleRow::default() }))
    }
}

#[derive(Clone)]
struct ActorDriver {
    network: Arc<Network<f32>>,
    memory: SingleRow<f32>,
}

impl Driver for ActorDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let Some(observation) = view.observation() else {
            return Err(
                view.error("a learnt policy drives the ego only; name another for the adversary".to_owned())
            );
        };
        let mut output = [0.0; 2];
        self.network.forward_one(observation, &mut self.memory, &mut output);
        let [steer, throttle] = output.map(|x| f64::from(x.tanh()));
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
