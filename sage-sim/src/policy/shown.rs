//! What a driver shows of a step.

use sage_core::geometry::Point;

/// What a driver shows of a step to people who watch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shown {
    /// The step.
    pub step: usize,
    /// Where it plans to drive, from where it is; empty if it says nothing about it.
    pub plan: Vec<Point>,
    /// What it wrote to its log.
    pub log: String,
}
