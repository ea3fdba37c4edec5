//! Strict feasibility: covers what the frame-by-frame rule misses.
//!
//! - Boxes are swept between frames, from the pose at *now* on, so that contacts between frames count.
//! - The centre must stay on the drivable side. Waymo's boundaries have the road on their left, so a
//!   centre on the right of the nearest boundary is off the road, unless it is so *now*.
//! - Heights count: edges and road users more than [`StrictOptions::height_gap`] above or below the
//!   adversary are on another level. A candidate has no height; it follows the nearest lane of its own
//!   level.
//!
//! The first sweep ignores what the box already touches *now*: a car recorded over a kerb may leave it.

use serde::{Deserialize, Serialize};

use super::{
    Candidate, Context, Feasibility, OtherAgent, Violation,
    map_feasibility::{touching_agent, touching_feature},
    violation::{MEDIAN, OFF_ROAD, ROAD_EDGE},
};
use crate::{
    geometry::{OrientedBox, Point, Segment, SegmentIndex, Side, SweptBox, boxes_meet_between},
    motion::{HORIZON, NOW},
    registry::Entry,
};

/// Largest distance of a boundary whose side is tested, metres.
const SIDE_REACH: f64 = 15.0;
/// Largest distance of a lane whose height a candidate follows, metres.
const LANE_REACH: f64 = 8.0;

/// Options of [`StrictFeasibility`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StrictOptions {
    /// Height difference above which two objects are on different levels, metres.
    pub height_gap: f64,
    /// Whether medians also bound the road.
    pub medians: bool,
}

impl Default for StrictOptions {
    fn default() -> Self {
        Self { height_gap: 3.0, medians: false }
    }
}

/// The strict rule.
#[derive(Clone, Copy, Debug, Default)]
pub struct StrictFeasibility(StrictOptions);

impl Entry<dyn Feasibility> for StrictFeasibility {
    const NAME: &'static str = "strict";
    const SUMMARY: &'static str =
        "boxes swept between frames, centre on the road, levels distinguished by height";
    const SOURCE: &'static str = "this project";
    type Options = StrictOptions;

    fn build(options: StrictOptions) -> Result<Box<dyn Feasibility>, String> {
        if !(options.height_gap > 0.0) {
            return Err(format!("`height_gap` is {}; expected metres above 0", options.height_gap));
        }
        Ok(Box::new(Self(options)))
    }
}

impl Feasibility for StrictFeasibility {
    fn violations(&self, candidate: &Candidate, ctx: &Context) -> Vec<Violation> {
        let boxes: Vec<OrientedBox> =
            std::iter::once(candidate.box_now()).chain(candidate.boxes().iter().copied()).collect();
        let heights = self.heights(candidate, ctx);
        let edges = ctx.index().boundaries();
        let boundary = self.swept_edge(&boxes, &heights, edges);
        let median =
            self.0.medians.then(|| self.swept_edge(&boxes, &heights, ctx.index().medians())).flatten();
        let agent = self.swept_agent(&boxes, &heights, ctx);
        let off_road = self.off_road(candidate, &heights, edges);
        let feature = |found: Option<(usize, u32)>, rule| {
            found.map(|(step, k)| touching_feature(candidate, ctx, rule, step, k as usize))
        };
        [
            feature(boundary, ROAD_EDGE),
            feature(median, MEDIAN),
            agent.map(|(step, track)| touching_agent(candidate, ctx, step, track)),
            feature(off_road, OFF_ROAD),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

impl StrictFeasibility {
    /// Height of the ground under each step, 0 (*now*) to 80. `None` if the map is so level that heights do
    /// not matter.
    fn heights(&self, candidate: &Candidate, ctx: &Context) -> Option<Vec<f64>> {
        let gap = self.0.height_gap;
        let track = ctx.adversary();
        if ctx.index().height_span() <= gap || !track.is_valid(NOW) {
            return None;
        }
        let lanes = ctx.index().motor_lanes();
        let mut level = ground(track.position[NOW][2], track.size[NOW][2]);
        let points = std::iter::once(candidate.start().position)
            .chain(candidate.trajectory().points().iter().copied());
        let followed = points.map(|p: Point| {
            let near = lanes
                .nearest(p, LANE_REACH, |lane| (lane.height(lane.nearest_share(p)) - level).abs() <= gap);
            if let Some(found) = near {
                level = lanes.segments()[found.segment].height(found.share);
            }
            level
        });
        Some(followed.collect())
    }

    fn same_level(&self, heights: &Option<Vec<f64>>, step: usize, other: f64) -> bool {
        heights.as_ref().is_none_or(|heights| (heights[step] - other).abs() <= self.0.height_gap)
    }

    /// First step, and feature, at which the sweep touches an edge of the same level.
    fn swept_edge(
        &self,
        boxes: &[OrientedBox],
        heights: &Option<Vec<f64>>,
        edges: &SegmentIndex,
    ) -> Option<(usize, u32)> {
        for step in 1..=HORIZON {
            let sweep = SweptBox::between(&boxes[step - 1], &boxes[step]);
            let hit = |segment: &&Segment| {
                self.same_level(heights, step, segment.height(segment.nearest_share(boxes[step].center)))
                    && sweep.intersects_segment(segment.a, segment.b)
                    && !(step == 1 && boxes[0].intersects_segment(segment.a, segment.b))
            };
            let touched = edges.near(sweep.aabb()).flat_map(|run| &edges.segments()[run]).find(hit);
            if let Some(segment) = touched {
                return Some((step, segment.feature));
            }
        }
        None
    }

    /// First step, and track, at which the sweep touches another road user of the same level.
    fn swept_agent(
        &self,
        boxes: &[OrientedBox],
        heights: &Option<Vec<f64>>,
        ctx: &Context,
    ) -> Option<(usize, usize)> {
        let meets = |other: &OtherAgent, step: usize| {
            let Some(now) = other.at(step) else { return false };
            let track = &ctx.scene().tracks[other.track];
            let frame = NOW + step;
            if !self.same_level(heights, step, ground(track.position[frame][2], track.size[frame][2])) {
                return false;
            }
            match other.at(step - 1) {
                Some(before) if step > 1 || !before.intersects(&boxes[0]) => {
                    boxes_meet_between([&boxes[step - 1], &boxes[step]], [before, now])
                }
                _ => now.intersects(&boxes[step]),
            }
        };
        let first = |other: &OtherAgent| {
            (1..=HORIZON).find(|&step| meets(other, step)).map(|step| (step, other.track))
        };
        // The candidate's bounds exclude the pose at *now*, but the sweep of step 1 starts there.
        let bounds = boxes.iter().fold(crate::geometry::Aabb::EMPTY, |all, b| all.union(&b.aabb()));
        ctx.others()
            .iter()
            .filter(|other| other.true_bounds().meets(&bounds))
            .filter_map(first)
            .min_by_key(|(step, _)| *step)
    }

    /// First step, and boundary, at which the centre is beyond the boundary.
    fn off_road(
        &self,
        candidate: &Candidate,
        heights: &Option<Vec<f64>>,
        edges: &SegmentIndex,
    ) -> Option<(usize, u32)> {
        let beyond = |step: usize, p: Point| {
            let level = |s: &Segment| self.same_level(heights, step, s.height(s.nearest_share(p)));
            let nearest = edges.nearest(p, SIDE_REACH, level)?;
            let feature = edges.segments()[nearest.segment].feature;
            (edges.side(p, &nearest) == Some(Side::Right)).then_some(feature)
        };
        if beyond(0, candidate.start().position).is_some() {
            return None;
        }
        let mut steps = candidate.trajectory().points().iter().enumerate();
        steps.find_map(|(k, &p)| beyond(k + 1, p).map(|feature| (k + 1, feature)))
    }
}

/// Height of the ground under a box whose centre is at height `z`.
fn ground(z: f64, height: f64) -> f64 {
    z - 0.5 * height
}
