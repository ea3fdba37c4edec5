//! Pedestrians and cyclists as adversaries: what they can do, and when a person would believe a contact with one.
//!
//! Rules of cars (lanes, medians, directions, the depth of the contact) do not apply to them. [`PersonLimits`] are limits by kind,
//! [`PersonFeasibility`] is the rule for plans, and [`PersonMet`] measures a contact and lists the doubts about it.

mod contact;
mod limits;
mod met;
mod rule;
mod sight;

pub use contact::{LEAST_SEEN, PersonContact, Promise, promise};
pub use limits::PersonLimits;
pub use met::{PersonMet, doubts};
pub use rule::PersonFeasibility;
pub use sight::seen_for;
