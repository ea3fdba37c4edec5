//! Pedestrians and cyclists as adversaries: where one is placed in a scene ([`Placement`]), and what it may do there ([`Person`]).

mod motion;
mod place;
mod plans;

pub use place::{Placement, Side};
pub use plans::Person;
