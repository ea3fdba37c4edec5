//! What a driver shows of a step.

use sage_core::geometry::Point;
use serde::{Deserialize, Serialize};

/// What a driver shows of a step to people who watch.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// The step.
    pub step: usize,
    /// Where it plans to drive, from where it is; empty if it says nothing about it.
    pub plan: Vec<Point>,
    /// What it wrote to its log.
    pub log: String,
}

impl Shown {
    /// The same with a plan in whole centimetres, which is what rows of drives keep.
    #[must_use]
    pub fn rounded(&self) -> Self {
        let plan = self.plan.iter().map(|point| point.map(|x| (100.0 * x).round() / 100.0)).collect();
        Self { plan, ..self.clone() }
    }
}
