//! Violations: the rules that a candidate breaks.

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
/// The centre is beyond the road edge.
pub const OFF_ROAD: &str = "off_road";
/// The heading changes by more than 90° from one frame to the next.
pub const HALF_TURN: &str = "half_turn";
/// It turns more tightly than a car can.
pub const TURNING_CIRCLE: &str = "turning_circle";
/// It takes a turn faster than a car can.
pub const LATERAL_ACCELERATION: &str = "lateral_acceleration";

/// Ego and adversary overlap *now*: whatever the adversary does, it is no attack.
pub const CONTACT_NOW: &str = "contact_now";

/// Cost of leaving the road (published code).
pub const EDGE_COST: f64 = 50.0;
/// Cost of touching another road user (published code).
pub const AGENT_COST: f64 = 10.0;

/// One violation: rule, cost, step and position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Violation {
    /// The rule, as words joined by underscores.
    pub rule: Cow<'static, str>,
    /// Cost, > 0. It counts if no candidate is feasible, and in objectives that weigh violations.
    pub cost: f64,
    /// First step of the violation, 1 to the horizon.
    pub step: usize,
    /// Position of the adversary at that step, metres.
    pub place: Point,
    /// Id of the touched map feature or track.
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

    /// The rule as words separated by spaces, for tables.
    pub fn words(&self) -> String {
        self.rule.replace('_', " ")
    }
}

/// A feasibility rule for candidates in their scene.
///
/// A plan that leaves the road of `ctx` to the left, at 2 m/s:
///
/// ```
/// # use std::sync::Arc;
/// # use sage_core::{motion::Trajectory, objective::{Context, ContextOptions}, scene::SceneIndex};
/// use sage_core::objective::feasibilities;
///
/// # let scene = Arc::new(include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/road.rs")));
/// # let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// let plan = (1..=80).map(f64::from).map(|step| [20.0 + 0.8 * step, 4.0 + 0.2 * step]).collect();
/// let candidate = ctx.candidate(Trajectory::new("plan", plan)?);
/// let violations = feasibilities()?.build_default("paper")?.violations(&candidate, &ctx);
/// // Each violation says what is broken, when and by what.
/// assert_eq!((violations[0].words().as_str(), &*violations[0].with), ("road edge", "left"));
/// assert!((10..20).contains(&violations[0].step), "the side is 3 m from the edge");
/// # Ok::<(), sage_core::Error>(())
/// ```
pub trait Feasibility: Send + Sync {
    /// All violations of a candidate, each at its first step; empty if it is feasible.
    fn violations(&self, candidate: &Candidate, ctx: &Context) -> Vec<Violation>;

    /// Whether there is no violation.
    fn is_feasible(&self, candidate: &Candidate, ctx: &Context) -> bool {
        self.violations(candidate, ctx).is_empty()
    }
}
