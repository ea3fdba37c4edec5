//! The driver under test, as a generator can ask it: what does it do against this plan?
//!
//! Most generators plan against a path of the ego that does not change. One that learns from the answers of a driver lets it
//! drive several plans in a scene; how the driver is simulated is not its business (`sage-sim`).

use crate::{
    Error,
    motion::{Pose, Trajectory},
};

/// A driver that drives a scene against any plan of the adversary.
pub trait DriverUnderTest {
    /// Drives from frame 0 against a plan.
    ///
    /// *Errors*: [`Error::Scene`] if the driver fails.
    fn drive(&self, plan: &Trajectory) -> Result<DrivenEgo, Error>;
}

/// What the ego did against a plan, up to its first contact.
#[derive(Clone, Debug, PartialEq)]
pub struct DrivenEgo {
    /// Poses from frame 0 on, at most 91; `None` where the ego is absent.
    pub poses: Vec<Option<Pose>>,
    /// Whether the drive ends with a contact with the adversary after *now*.
    pub hits_adversary: bool,
}
