//! Feasibility on the drivable area: covers what the frame-by-frame rule misses.
//!
//! - Boxes are swept between frames, from the pose at *now* on, so that contacts between frames count.
//! - Medians bound the road as its edges do.
//! - A sidewalk that is an area must not be entered. One that the box is on *now* does not count until the box has left it.
//! - The centre must stay on the road side. Waymo's boundaries have the road on their left, so a centre on
//!   the right of the nearest boundary is off the road, unless it is so *now*. Only through a gap between
//!   boundaries can a centre change sides without a contact. Its side is therefore tested only near an open end
//!   of a boundary, after a motion as long as the distance of the nearest boundary, every 2 s or 25 m.
//! - A map without such boundaries is also bounded by its lanes: a centre more than [`DrivableOptions::lane_reach`]
//!   from the centre line of every motor lane is off the road, unless it is so *now*.
//! - Heights count: edges and road users more than [`DrivableOptions::height_gap`] above or below the
//!   adversary are on another level. A candidate has no height; it follows the nearest lane of its own
//!   level. Heights are computed only where the rule is violated in the plane, on maps with several levels.
//!
//! - A car can neither turn on the spot, nor more tightly or faster than [`super::turning`] says.
//!
//! The first sweep ignores what the box already touches *now*: a car recorded over a kerb may leave it.

use serde::{Deserialize, Serialize};

use super::{
    Candidate, Context, Feasibility, OtherAgent, Violation,
    map_feasibility::{half_turn, touching_agent, touching_feature},
    others::CHUNK,
    turning::{self, Excess},
    violation::{EDGE_COST, LATERAL_ACCELERATION, MEDIAN, OFF_ROAD, ROAD_EDGE, TURNING_CIRCLE},
};
use crate::{
    geometry::{
        Aabb, OrientedBox, Segment, SegmentIndex, Side, SweptBox, boxes_meet_between, distance, dot,
        turning_margin,
    },
    motion::{HORIZON, NOW},
    registry::Entry,
    scene::{MapKind, Sided},
};

/// Largest distance of a boundary whose side is tested, metres.
const SIDE_REACH: f64 = 15.0;
/// Steps between two tests of the side …
const SIDE_STEPS: usize = 20;
/// … and distance between two tests, metres, whichever is earlier.
const SIDE_STRIDE: f64 = 25.0;
/// Largest distance of the lane that a violation names, metres.
const NAMED_REACH: f64 = 100.0;

/// Options of [`DrivableFeasibility`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DrivableOptions {
    /// Height difference above which two objects are on different levels, metres.
    pub height_gap: f64,
    /// Whether medians also bound the road.
    pub medians: bool,
    /// On maps without `ROAD_EDGE_BOUNDARY`: distance from the nearest motor lane at which the road ends,
    /// metres.
    pub lane_reach: f64,
    /// Largest turn per metre of a car of at most 6 m, rad/m ([`super::turning`]); no limit without it.
    pub turn: Option<f64>,
    /// Largest lateral acceleration, m/s²; no limit without it.
    pub lateral: Option<f64>,
}

impl Default for DrivableOptions {
    fn default() -> Self {
        Self {
            height_gap: 3.0,
            medians: true,
            lane_reach: 5.0,
            turn: Some(turning::TURN),
            lateral: Some(turning::LATERAL),
        }
    }
}

/// The rule `drivable`.
#[derive(Clone, Copy, Debug, Default)]
pub struct DrivableFeasibility(DrivableOptions);

impl Entry<dyn Feasibility> for DrivableFeasibility {
    const NAME: &'static str = "drivable";
    const SUMMARY: &'static str =
        "edges and medians, boxes swept between frames, centre on the road, levels distinguished by height";
    const SOURCE: &'static str = "this project";
    type Options = DrivableOptions;

    fn build(options: DrivableOptions) -> Result<Box<dyn Feasibility>, String> {
        for (name, value) in [("height_gap", options.height_gap), ("lane_reach", options.lane_reach)] {
            if !(value > 0.0) {
                return Err(format!("`{name}` is {value}; expected metres above 0"));
            }
        }
        for (name, value, unit) in [("turn", options.turn, "rad/m"), ("lateral", options.lateral, "m/s²")] {
            if let Some(value) = value.filter(|value| !(*value > 0.0)) {
                return Err(format!("`{name}` is {value}; expected {unit} above 0, or null for no limit"));
            }
        }
        Ok(Box::new(Self(options)))
    }
}

impl Feasibility for DrivableFeasibility {
    fn violations(&self, candidate: &Candidate, ctx: &Context) -> Vec<Violation> {
        let mut drive = Drive::new(self.0, candidate, ctx);
        let in_the_plane = drive.violations();
        // Heights can only remove violations.
        let on_road =
            if !in_the_plane.is_empty() && drive.find_heights() { drive.violations() } else { in_the_plane };
        on_road.into_iter().chain(self.turns(candidate)).collect()
    }

    fn is_feasible(&self, candidate: &Candidate, ctx: &Context) -> bool {
        // The cheaper question first.
        self.turns(candidate).next().is_none() && self.violations(candidate, ctx).is_empty()
    }
}

impl DrivableFeasibility {
    /// Turns that no car can make.
    fn turns(&self, candidate: &Candidate) -> impl Iterator<Item = Violation> {
        let tight = self.0.turn.and_then(|limit| turning::tight_turn(candidate, limit));
        let fast = self.0.lateral.and_then(|limit| turning::fast_turn(candidate, limit));
        let violation = |turn: Excess, rule| Violation::at(candidate, turn.step, rule, EDGE_COST, "");
        let all = [
            half_turn(candidate),
            tight.map(|turn| violation(turn, TURNING_CIRCLE)),
            fast.map(|turn| violation(turn, LATERAL_ACCELERATION)),
        ];
        all.into_iter().flatten()
    }
}

/// A candidate's motion over its map.
struct Drive<'a> {
    options: DrivableOptions,
    candidate: &'a Candidate,
    ctx: &'a Context,
    /// Box at step 0 (*now*).
    now: OrientedBox,
    /// Bounds of the sweeps of each group of [`CHUNK`] steps, and of all.
    chunks: [Aabb; HORIZON / CHUNK],
    bounds: Aabb,
    /// Height of the ground under each step; `None` if all is on one level.
    heights: Option<Vec<f64>>,
    /// Sidewalks that the box is on *now*: feature, and the first step at which it has left it.
    leaving: Vec<(u32, usize)>,
}

impl<'a> Drive<'a> {
    fn new(options: DrivableOptions, candidate: &'a Candidate, ctx: &'a Context) -> Self {
        let now = candidate.box_now();
        let mut chunks = candidate.true_chunks();
        let boxes = candidate.boxes();
        for (chunk, bounds) in chunks.iter_mut().take(boxes.len().div_ceil(CHUNK)).enumerate() {
            let before = if chunk == 0 { &now } else { &boxes[chunk * CHUNK - 1] };
            *bounds = bounds.union(&before.aabb());
        }
        let bounds = chunks.iter().fold(Aabb::EMPTY, |all, chunk| all.union(chunk));
        let mut drive =
            Self { options, candidate, ctx, now, chunks, bounds, heights: None, leaving: Vec::new() };
        if !ctx.index().sidewalks().is_empty() {
            drive.leaving = drive.sidewalks_left();
        }
        drive
    }

    /// The sidewalks that the box is on *now*, with the first step at which it has left each.
    fn sidewalks_left(&self) -> Vec<(u32, usize)> {
        let sidewalks = self.ctx.index().sidewalks();
        let on = sidewalks.near(&self.now.aabb()).into_iter().filter(|k| sidewalks.meets(*k, &self.now));
        on.map(|k| {
            let left = self.candidate.steps().find(|step| !sidewalks.meets(k, self.at(*step)));
            (sidewalks.feature(k), left.unwrap_or(usize::MAX))
        })
        .collect()
    }

    /// Whether the box is still on a sidewalk that it is on *now*, during the sweep to a step.
    fn is_leaving(&self, feature: u32, step: usize) -> bool {
        self.leaving.iter().any(|(left, until)| *left == feature && step <= *until)
    }

    /// Number of groups of [`CHUNK`] steps up to the horizon.
    fn groups(&self) -> usize {
        self.candidate.horizon().div_ceil(CHUNK)
    }

    /// The box at a step, 0 (*now*) to 80.
    fn at(&self, step: usize) -> &OrientedBox {
        if step == 0 { &self.now } else { &self.candidate.boxes()[step - 1] }
    }

    fn violations(&self) -> Vec<Violation> {
        let (candidate, ctx) = (self.candidate, self.ctx);
        let [boundary, median] = self.swept_edges();
        let edge = |found: Option<(usize, u32)>, rule| {
            found.map(|(step, feature)| touching_feature(candidate, ctx, rule, step, feature as usize))
        };
        let agent = self.swept_agent().map(|(step, track)| touching_agent(candidate, ctx, step, track));
        let off_road = if ctx.index().sided() == Sided::None {
            self.far_from_lanes()
        } else if boundary.is_none() {
            edge(self.off_road(), OFF_ROAD)
        } else {
            None
        };
        let boundary = self.on_sidewalk(boundary);
        [edge(boundary, ROAD_EDGE), edge(median, MEDIAN), agent, off_road].into_iter().flatten().collect()
    }

    /// Follows the height of the ground. `false` if nothing in the map lies above something else.
    fn find_heights(&mut self) -> bool {
        let gap = self.options.height_gap;
        let (ctx, track) = (self.ctx, self.ctx.adversary());
        if !ctx.index().has_levels(gap) || !track.is_valid(NOW) {
            return false;
        }
        let mut level = track.ground(NOW);
        let followed = (0..=self.candidate.horizon()).map(|step| {
            level = ctx.index().follow_ground(self.at(step).center, level, gap);
            level
        });
        self.heights = Some(followed.collect());
        true
    }

    fn same_level(&self, step: usize, other: impl FnOnce() -> f64) -> bool {
        self.heights.as_ref().is_none_or(|all| (all[step] - other()).abs() <= self.options.height_gap)
    }

    fn edges(&self) -> &'a SegmentIndex {
        let index = self.ctx.index();
        if self.options.medians { index.edges() } else { index.boundaries() }
    }

    fn is_median(&self, segment: &Segment) -> bool {
        self.ctx.index().map().features[segment.feature as usize].kind == MapKind::EdgeMedian
    }

    /// First step, and feature, at which the sweep touches a boundary and a median of the same level. After a
    /// boundary, medians are sought only to the end of its group of steps.
    fn swept_edges(&self) -> [Option<(usize, u32)>; 2] {
        let edges = self.edges();
        let mut first = [None, None];
        let mut near: Vec<(Aabb, usize, &Segment)> = Vec::with_capacity(64);
        for (chunk, bounds) in self.chunks.iter().take(self.groups()).enumerate() {
            near.clear();
            let segments = edges.near(bounds).flat_map(|run| &edges.segments()[run]);
            let met = segments.map(|s| (s.aabb(), s)).filter(|(aabb, _)| aabb.meets(bounds));
            near.extend(met.map(|(aabb, s)| (aabb, usize::from(self.is_median(s)), s)));
            near.retain(|(_, kind, _)| first[*kind].is_none());
            let mut before = self.at(chunk * CHUNK).aabb();
            for step in chunk * CHUNK + 1..=((chunk + 1) * CHUNK).min(self.candidate.horizon()) {
                if near.is_empty() {
                    break;
                }
                let after = self.at(step).aabb();
                let bounds = before.union(&after);
                before = after;
                let mut sweep = None;
                let mut found = false;
                for (_, kind, segment) in near.iter().filter(|(aabb, ..)| bounds.meets(aabb)) {
                    if first[*kind].is_none()
                        && self
                            .same_level(step, || segment.height(segment.nearest_share(self.at(step).center)))
                        && sweep
                            .get_or_insert_with(|| SweptBox::between(self.at(step - 1), self.at(step)))
                            .intersects_segment(segment.a, segment.b)
                        && !(step == 1 && self.now.intersects_segment(segment.a, segment.b))
                        && !self.is_leaving(segment.feature, step)
                    {
                        first[*kind] = Some((step, segment.feature));
                        found = true;
                    }
                }
                if found {
                    near.retain(|(_, kind, _)| first[*kind].is_none());
                }
            }
            if first[0].is_some() {
                break;
            }
        }
        first
    }

    /// The first contact with a boundary, or the first step before it at which the centre is on a sidewalk. Only a box
    /// that was on it before gets there without a contact: one that left it partly, or changed its level.
    fn on_sidewalk(&self, boundary: Option<(usize, u32)>) -> Option<(usize, u32)> {
        let sidewalks = self.ctx.index().sidewalks();
        if sidewalks.is_empty() {
            return boundary;
        }
        let near = sidewalks.near(&self.bounds);
        let inside = self.candidate.steps_before(boundary.map(|(step, _)| step)).find_map(|step| {
            let is_on = |k: &&usize| {
                sidewalks.holds(**k, self.at(step).center)
                    && !self.is_leaving(sidewalks.feature(**k), step)
                    && self.same_level(step, || sidewalks.height(**k))
            };
            near.iter().find(is_on).map(|k| (step, sidewalks.feature(*k)))
        });
        inside.or(boundary)
    }

    /// First step, and track, at which the sweep touches another road user of the same level.
    fn swept_agent(&self) -> Option<(usize, usize)> {
        let mut first: Option<(usize, usize)> = None;
        // A car that reverses on the spot turns by half a turn between two steps.
        let (mut cos, mut axis) = (1.0_f64, self.now.axis);
        for b in self.candidate.boxes() {
            cos = cos.min(dot(axis, b.axis));
            axis = b.axis;
        }
        let margin = turning_margin(&self.now, cos);
        let bounds = self.bounds.grown(margin);
        let chunks = self.chunks.map(|chunk| chunk.grown(margin));
        for other in self.ctx.others().iter().filter(|other| other.swept_bounds().meets(&bounds)) {
            // Only an earlier contact can replace the current one.
            let end = *self.candidate.steps_before(first.map(|(step, _)| step)).end();
            let near = (0..end.div_ceil(CHUNK)).filter(|&k| other.swept_chunks()[k].meets(&chunks[k]));
            let mut steps = near.flat_map(|chunk| chunk * CHUNK + 1..=((chunk + 1) * CHUNK).min(end));
            if let Some(step) = steps.find(|&step| self.meets(other, step)) {
                first = Some((step, other.track));
            }
        }
        first
    }

    /// Whether the sweep that ends at a step touches a road user of the same level.
    fn meets(&self, other: &OtherAgent, step: usize) -> bool {
        let Some(now) = other.at(step) else { return false };
        let track = &self.ctx.scene().tracks[other.track];
        let frame = NOW + step;
        if !self.same_level(step, || track.ground(frame)) {
            return false;
        }
        match other.at(step - 1) {
            Some(before) if step > 1 || !before.intersects(&self.now) => {
                boxes_meet_between([self.at(step - 1), self.at(step)], [before, now])
            }
            _ => now.intersects(self.at(step)),
        }
    }

    /// First step, and boundary, at which the centre is found beyond the boundary.
    fn off_road(&self) -> Option<(usize, u32)> {
        let index = self.ctx.index();
        let reach = Aabb {
            min: self.bounds.min.map(|x| x - SIDE_REACH),
            max: self.bounds.max.map(|x| x + SIDE_REACH),
        };
        if !index.open_ends().iter().any(|end| reach.meets(&Aabb { min: *end, max: *end })) {
            return None;
        }
        let boundaries = index.boundaries();
        let all_sided = index.sided() == Sided::All;
        let is_sided =
            |s: &Segment| all_sided || index.map().features[s.feature as usize].kind == MapKind::EdgeBoundary;
        let beyond = |step: usize, reach: f64| {
            let p = self.at(step).center;
            let level = |s: &Segment| is_sided(s) && self.same_level(step, || s.height(s.nearest_share(p)));
            let Some(nearest) = boundaries.nearest(p, reach, level) else { return (None, reach) };
            let feature = boundaries.segments()[nearest.segment].feature;
            let is_beyond = boundaries.side(p, &nearest) == Some(Side::Right);
            (is_beyond.then_some(feature), nearest.distance)
        };
        self.first_outside(|step| beyond(step, SIDE_REACH))
    }

    /// The violation of being too far from every motor lane.
    fn far_from_lanes(&self) -> Option<Violation> {
        let (lanes, reach) = (self.ctx.index().motor_lanes(), self.options.lane_reach);
        if lanes.segments().is_empty() {
            return None;
        }
        let outside = |step: usize| {
            let p = self.at(step).center;
            let level = |s: &Segment| self.same_level(step, || s.height(s.nearest_share(p)));
            match lanes.nearest(p, reach, level) {
                Some(near) => (None, reach - near.distance),
                None => (Some(()), 0.0),
            }
        };
        let (step, ()) = self.first_outside(outside)?;
        let lane = lanes.nearest(self.at(step).center, NAMED_REACH, |_| true);
        let feature = lane.map(|near| lanes.segments()[near.segment].feature as usize);
        let id = feature.map_or("", |feature| &*self.ctx.index().map().features[feature].id);
        Some(Violation::at(self.candidate, step, OFF_ROAD, EDGE_COST, id))
    }

    /// First step at which the centre is found outside the road. `test` gives what it is outside of, and a
    /// distance within which this cannot change without a contact. `None` if it is outside *now*.
    fn first_outside<T>(&self, test: impl Fn(usize) -> (Option<T>, f64)) -> Option<(usize, T)> {
        let half_width = self.now.half_width;
        let (mut last, mut clear) = (0, 0.0f64);
        for step in self.candidate.steps() {
            let moved = distance(self.at(last).center, self.at(step).center);
            // A boundary nearer than half the width touches the box.
            let may_have_changed = moved >= clear.max(half_width);
            if !may_have_changed || (step % SIDE_STEPS != 0 && moved < SIDE_STRIDE) {
                continue;
            }
            let (outside, distance) = test(step);
            if outside.is_some() {
                if test(0).0.is_some() {
                    return None;
                }
                let earlier = (last + 1..step).find_map(|k| Some((k, test(k).0?)));
                return earlier.or_else(|| outside.map(|outside| (step, outside)));
            }
            (last, clear) = (step, distance);
        }
        None
    }
}
