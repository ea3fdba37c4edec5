//! Map feasibility: no box touches a road boundary, no box touches another road user.
//!
//! The rule of the paper and its code: frame by frame. On maps with levels, what is more than 3 m above or below does not
//! count. A plan that turns by more than 90° in a frame is not feasible either; both go beyond the paper. Every kind of road user counts. All edges but
//! medians bound the road; in Waymo's maps these are the `ROAD_EDGE_BOUNDARY`s, as in the paper. A sidewalk that is
//! an area also counts from inside. The rule misses contacts between frames and a box wholly beyond an edge;
//! [`super::DrivableFeasibility`] covers both.
//!
//! Eight steps share one query of the tree, because most groups of steps are far from every edge and agent.

use serde::{Deserialize, Serialize};

use super::{
    Candidate, Context, Convention, Feasibility, Violation,
    others::{CHUNK, OtherAgent},
    violation::{AGENT, AGENT_COST, EDGE_COST, HALF_TURN, MEDIAN, ROAD_EDGE},
};
use crate::{
    geometry::{Aabb, OrientedBox, Segment, SegmentIndex},
    motion::{HORIZON, NOW},
    registry::Entry,
};

/// First contact with a map feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EdgeContact {
    /// Step, 1 to 80.
    pub step: usize,
    /// Index of the map feature.
    pub feature: usize,
}

/// First contact with another road user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AgentContact {
    /// Step, 1 to 80.
    pub step: usize,
    /// Index of its track.
    pub track: usize,
}

/// First contacts of a candidate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Violations {
    /// First contact with a road boundary.
    pub boundary: Option<EdgeContact>,
    /// First contact with another road user of any kind.
    pub agent: Option<AgentContact>,
    /// First contact with another vehicle.
    pub vehicle: Option<AgentContact>,
    /// First contact with a standing vehicle.
    pub static_vehicle: Option<AgentContact>,
}

impl Violations {
    /// All first contacts of a candidate.
    pub fn of(candidate: &Candidate, ctx: &Context) -> Self {
        let first = |accept: fn(&OtherAgent) -> bool| first_agent_contact(candidate, ctx, accept);
        let agent = first(|_| true);
        // The narrower searches run only if the wider one found a contact.
        let vehicle = agent.and_then(|_| first(|other| other.is_vehicle));
        let static_vehicle = vehicle.and_then(|_| first(|other| other.is_static));
        let boundary = first_boundary_contact(candidate, ctx);
        Self { boundary, agent, vehicle, static_vehicle }
    }
}

/// Whether a candidate touches an edge: a boundary ([`crate::scene::SceneIndex::boundaries`]), or also a
/// median ([`crate::scene::SceneIndex::edges`]). It is cheaper than [`Violations::of`].
pub fn touches_edge(candidate: &Candidate, edges: &SegmentIndex) -> bool {
    first_edge_contact(candidate, edges).is_some()
}

/// Whether something at a height of the ground is on a candidate's level at a step. The published code has one level.
fn is_on_level(candidate: &Candidate, step: usize, height: impl FnOnce() -> f64) -> bool {
    candidate.convention() == Convention::Release || candidate.is_on_level(step, height())
}

/// First step at which a map box touches a segment of its level.
fn first_edge_contact(candidate: &Candidate, edges: &SegmentIndex) -> Option<EdgeContact> {
    let is_level = |step: usize, height: &dyn Fn() -> f64| is_on_level(candidate, step, height);
    first_contact(candidate.map_boxes(), candidate.chunks(), edges, is_level)
}

/// First step at which a map box touches a boundary or is on a sidewalk.
fn first_boundary_contact(candidate: &Candidate, ctx: &Context) -> Option<EdgeContact> {
    let outline = first_edge_contact(candidate, ctx.index().boundaries());
    let sidewalks = ctx.index().sidewalks();
    if sidewalks.is_empty() {
        return outline;
    }
    // A box that does not touch the outline is inside if its centre is.
    let near = sidewalks.near(candidate.bounds());
    let inside = candidate.steps_before(outline.map(|contact| contact.step)).find_map(|step| {
        let center = candidate.map_boxes()[step - 1].center;
        let is_on = |area: &&usize| {
            sidewalks.holds(**area, center) && is_on_level(candidate, step, || sidewalks.height(**area))
        };
        near.iter().find(is_on).map(|area| EdgeContact { step, feature: sidewalks.feature(*area) as usize })
    });
    inside.or(outline)
}

/// First step at which a true box touches a segment, in every convention.
pub(super) fn touches_truly(candidate: &Candidate, edges: &SegmentIndex) -> Option<EdgeContact> {
    let is_level = |step: usize, height: &dyn Fn() -> f64| candidate.is_on_level(step, height());
    first_contact(candidate.boxes(), &candidate.true_chunks(), edges, is_level)
}

/// First step at which a box touches a segment, with the bounds of each group of boxes.
fn first_contact(
    boxes: &[OrientedBox],
    chunks: &[Aabb; HORIZON / CHUNK],
    edges: &SegmentIndex,
    is_level: impl Fn(usize, &dyn Fn() -> f64) -> bool,
) -> Option<EdgeContact> {
    for (chunk, bounds) in chunks.iter().take(boxes.len().div_ceil(CHUNK)).enumerate() {
        let near: Vec<_> = edges
            .near(bounds)
            .flat_map(|run| &edges.segments()[run])
            .filter(|segment| segment.aabb().meets(bounds))
            .collect();
        if near.is_empty() {
            continue;
        }
        let first = chunk * CHUNK;
        for (k, b) in boxes.iter().enumerate().skip(first).take(CHUNK) {
            let touches = |s: &&&Segment| {
                b.intersects_segment(s.a, s.b) && is_level(k + 1, &|| s.height(s.nearest_share(b.center)))
            };
            if let Some(touched) = near.iter().find(touches) {
                return Some(EdgeContact { step: k + 1, feature: touched.feature as usize });
            }
        }
    }
    None
}

/// First step at which a map box touches an accepted road user; of several at that step, the first in the
/// file.
fn first_agent_contact(
    candidate: &Candidate,
    ctx: &Context,
    accept: fn(&OtherAgent) -> bool,
) -> Option<AgentContact> {
    let mut first: Option<AgentContact> = None;
    for other in ctx.known_others() {
        if !accept(other) || !other.bounds().meets(candidate.bounds()) {
            continue;
        }
        // Only an earlier contact can replace the current one.
        let end = *candidate.steps_before(first.map(|contact| contact.step)).end();
        let near = (0..end.div_ceil(CHUNK)).filter(|&k| other.chunks()[k].meets(&candidate.chunks()[k]));
        let step = near.flat_map(|chunk| chunk * CHUNK + 1..=((chunk + 1) * CHUNK).min(end)).find(|&step| {
            other.map_box(step).is_some_and(|b| b.intersects(&candidate.map_boxes()[step - 1]))
                && is_on_level(candidate, step, || ctx.scene().tracks[other.track].ground(NOW + step))
        });
        if let Some(step) = step {
            first = Some(AgentContact { step, track: other.track });
        }
    }
    first
}

/// The paper's feasibility rule.
#[derive(Clone, Copy, Debug, Default)]
pub struct MapFeasibility(MapFeasibilityOptions);

/// Options of [`MapFeasibility`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapFeasibilityOptions {
    /// Whether medians also bound the road.
    pub medians: bool,
}

impl Entry<dyn Feasibility> for MapFeasibility {
    const NAME: &'static str = "paper";
    const SUMMARY: &'static str = "no contact with a road boundary or another road user at any frame";
    const SOURCE: &'static str = "SAGE (ICLR 2026), map feasibility";
    type Options = MapFeasibilityOptions;

    fn build(options: MapFeasibilityOptions) -> Result<Box<dyn Feasibility>, String> {
        Ok(Box::new(Self(options)))
    }
}

impl Feasibility for MapFeasibility {
    fn violations(&self, candidate: &Candidate, ctx: &Context) -> Vec<Violation> {
        let edge = |contact: EdgeContact, rule| {
            touching_feature(candidate, ctx, rule, contact.step, contact.feature)
        };
        let boundary = first_boundary_contact(candidate, ctx).map(|c| edge(c, ROAD_EDGE));
        let median = (self.0.medians)
            .then(|| first_edge_contact(candidate, ctx.index().medians()))
            .flatten()
            .map(|c| edge(c, MEDIAN));
        let agent = first_agent_contact(candidate, ctx, |_| true)
            .map(|c| touching_agent(candidate, ctx, c.step, c.track));
        [boundary, median, agent, half_turn(candidate)].into_iter().flatten().collect()
    }
}

/// The violation of touching, or being beyond, a map feature.
pub(super) fn touching_feature(
    candidate: &Candidate,
    ctx: &Context,
    rule: &'static str,
    step: usize,
    feature: usize,
) -> Violation {
    Violation::at(candidate, step, rule, EDGE_COST, &*ctx.index().map().features[feature].id)
}

/// The violation of turning by more than 90° in a frame.
pub(super) fn half_turn(candidate: &Candidate) -> Option<Violation> {
    let step = candidate.half_turn()?;
    Some(Violation::at(candidate, step, HALF_TURN, EDGE_COST, ""))
}

/// The violation of touching another road user.
pub(super) fn touching_agent(candidate: &Candidate, ctx: &Context, step: usize, track: usize) -> Violation {
    Violation::at(candidate, step, AGENT, AGENT_COST, &*ctx.scene().tracks[track].id)
}
