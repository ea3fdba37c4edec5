//! A constant action: the simplest driver, for tests and as an example.

use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};

use super::{Driver, EgoPolicy, Start, View};
use crate::{Error, vehicle::Action, world::Control};

/// The policy `constant`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Constant(Action);

/// Options of [`Constant`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConstantOptions {
    /// Steering in [−1, 1], positive to the left.
    pub steer: f64,
    /// Throttle, or brake if negative, in [−1, 1].
    pub throttle: f64,
}

impl Entry<dyn EgoPolicy> for Constant {
    const NAME: &'static str = "constant";
    const SUMMARY: &'static str = "the same steering and throttle at every step";
    const SOURCE: &'static str = "this project";
    type Options = ConstantOptions;

    fn build(options: ConstantOptions) -> Result<Box<dyn EgoPolicy>, String> {
        let ConstantOptions { steer, throttle } = options;
        for (name, value) in [("steer", steer), ("throttle", throttle)] {
            if !(-1.0..=1.0).contains(&value) {
                return Err(format!("`{name}` is {value}; expected a number from -1 to 1"));
            }
        }
        Ok(Box::new(Self(Action { steer, throttle })))
    }
}

impl EgoPolicy for Constant {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(*self))
    }
}

impl Driver for Constant {
    fn control(&mut self, _: &View) -> Result<Control, Error> {
        Ok(Control::Drive(self.0))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(*self))
    }
}
