//! What a candidate breaks: rules that decide whether it could be driven in its scene.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::{Candidate, Context};
use crate::geometry::Point;

/// The box touches a road boundary.
pub const ROAD_EDGE: &str = "road_edge";
/// The box touches a median.
pub const MEDIAN: &str = "median";
/// The box touches another road user than the ego.
pub const AGENT: &str = "agent";
/// The centre is beyond the road's edge.
pub const OFF_ROAD: &str = "off_road";

/// Cost of leaving the road (published code).
pub const EDGE_COST: f64 = 50.0;
/// Cost of touching another road user (published code).
pub const AGENT_COST: f64 = 10.0;

/// One broken rule: what, how bad, when and where.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Violation {
    /// The rule, in words with underscores.
    pub rule: Cow<'static, str>,
    /// What it costs where no candidate is feasible, and in objectives that weigh violations, > 0.
    pub cost: f64,
    /// Step at which it is first broken, 1 to 80.
    pub step: usize,
    /// Where the adversary is then, metres.
    pub place: Point,
    /// Id of the map feature or track that was touched.
    pub with: String,
}

impl Violation {
    /// A violation at a step of a candidate, 1 to 80.
    pub fn at(
        candidate: &Candidate,
        step: usize,
        rule: impl Into<Cow<'static, str>>,
        cost: f64,
        with: impl Into<String>,
    ) -> Self {
        let place = candidate.trajectory().points()[step - 1];
        Self { rule: rule.into(), cost, step, place, with: with.into() }
    }

    /// The rule as tables say it.
    pub fn words(&self) -> String {
        self.rule.replace('_', " ")
    }
}

/// Decides whether a candidate could be driven in its scene.
pub trait Feasibility: Send + Sync {
    /// All rules that a candidate breaks, the first step of each; none if it is feasible.
    fn violations(&self, candidate: &Candidate, ctx: &Context) -> Vec<Violation>;

    /// Whether no rule is broken.
    fn is_feasible(&self, candidate: &Candidate, ctx: &Context) -> bool {
        self.violations(candidate, ctx).is_empty()
    }
}
