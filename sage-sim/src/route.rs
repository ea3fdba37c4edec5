//! Routes: the logged path of a road user as a polyline, with coordinates along and across it.
//!
//! Successive positions closer than 1 m are merged. `across` is positive to the **right** of the direction of
//! travel, as in MetaDrive.

use std::ops::RangeInclusive;

use sage_core::{
    geometry::{Aabb, Point, Segment, distance, dot, norm, sub},
    scene::{SceneIndex, Track},
};

/// Positions closer than this to the start of a segment are merged into it, metres.
const SPACING: f64 = 1.0;
/// A jump of the log longer than this ends the route, metres.
const LONGEST_JUMP: f64 = 100.0;
/// Shortest last segment, metres.
const SHORTEST: f64 = 1e-6;

/// Legs with common bounds: most of a route is far from a point, and not looked at leg by leg.
const RUN: usize = 8;
/// Distance by which bounds may be wrong without any effect, metres: far more than rounding.
const SLACK: f64 = 0.01;

/// Largest distance of the lane at the end of a route, metres, and least cosine of the angle between them.
const LANE_REACH: f64 = 3.0;
const ALONG: f64 = 0.8;
/// Distance in which a continued route changes over to the lane, metres.
const LANE_ENTRY: f64 = 6.0;
/// Largest number of lanes that continue a route.
const MAX_LANES: usize = 50;

/// One straight segment of a route.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Leg {
    start: Point,
    /// Unit direction.
    along: Point,
    length: f64,
    /// Length of the route before the segment.
    before: f64,
    heading: f64,
}

impl Leg {
    /// Coordinates of a point in the frame of the leg.
    fn leg_from_world(&self, p: Point) -> Coordinates {
        let d = sub(p, self.start);
        Coordinates { along: dot(d, self.along), across: dot(d, [self.along[1], -self.along[0]]) }
    }
}

/// Position relative to a route, metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coordinates {
    /// Distance along the route from its start.
    pub along: f64,
    /// Distance across, positive to the right.
    pub across: f64,
}

/// How a point far from the route gets its coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Localization {
    /// The nearest point of the route.
    #[default]
    Nearest,
    /// MetaDrive: the first leg that the point lies just before, otherwise the leg whose *line* is nearest.
    /// A leg far away but in line with the point can win, and positions can jump.
    MetaDrive,
}

/// [`RUN`] legs, the last one fewer.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Run {
    start: Point,
    bounds: Aabb,
}

/// A polyline with arc length.
///
/// ```
/// use sage_sim::route::{Localization, Route};
///
/// // 10 m east, then north.
/// let route = Route::new(&[[0.0, 0.0], [10.0, 0.0], [10.0, 20.0]]);
/// assert_eq!(route.length(), 30.0);
/// // A point beside its second leg: 15 m along, 2 m to the right.
/// let at = route.locate([12.0, 5.0], Localization::Nearest);
/// assert_eq!((at.along, at.across), (15.0, 2.0));
/// assert_eq!(route.point(at), [12.0, 5.0]);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    legs: Vec<Leg>,
    runs: Vec<Run>,
    length: f64,
}

impl Route {
    /// The route through positions. Positions without motion give a route of 0.1 m along +x.
    pub fn new(positions: &[Point]) -> Self {
        let mut route = Self { legs: Vec::new(), runs: Vec::new(), length: 0.0 };
        let mut k = 0;
        while k + 1 < positions.len() {
            let next = (k + 1..positions.len()).find(|&n| distance(positions[k], positions[n]) > SPACING);
            let end = next.unwrap_or(positions.len() - 1);
            if distance(positions[k], positions[end]) > SHORTEST {
                route.push(positions[k], positions[end]);
            }
            k = end;
        }
        if route.legs.is_empty() {
            let start = positions.first().copied().unwrap_or([0.0, 0.0]);
            route.push(start, [start[0] + 0.1, start[1]]);
        }
        route
    }

    fn push(&mut self, start: Point, end: Point) {
        let length = distance(start, end);
        let along = [(end[0] - start[0]) / length, (end[1] - start[1]) / length];
        let heading = along[1].atan2(along[0]);
        if self.legs.len().is_multiple_of(RUN) {
            self.runs.push(Run { start, bounds: Aabb::EMPTY });
        }
        if let Some(run) = self.runs.last_mut() {
            run.bounds = run.bounds.union(&Aabb::of([start, end]));
        }
        self.legs.push(Leg { start, along, length, before: self.length, heading });
        self.length += length;
    }

    /// The route of a track's valid positions from a frame on, up to a jump of more than 100 m. With
    /// `one_run`, it ends at the first frame that is not valid.
    pub fn of_track(track: &Track, from: usize, one_run: bool) -> Self {
        Self::of_frames(track, from..=track.valid.len().saturating_sub(1), one_run)
    }

    /// As [`Route::of_track`], of some frames.
    pub(crate) fn of_frames(track: &Track, frames: RangeInclusive<usize>, one_run: bool) -> Self {
        let mut positions: Vec<Point> = Vec::new();
        for frame in frames {
            if !track.is_valid(frame) {
                if one_run && !positions.is_empty() {
                    break;
                }
                continue;
            }
            let p = track.point(frame);
            if positions.last().is_some_and(|&last| distance(last, p) > LONGEST_JUMP) {
                break;
            }
            positions.push(p);
        }
        Self::new(&positions)
    }

    /// The route continued along the lanes at its end, by at most `length` metres: policies follow it, because one that is
    /// faster than the recording would run out of path. Rewards and completion use the recorded route alone. Of several lanes
    /// that follow, the one that turns least is taken. Without a lane at its end, the route is not continued.
    pub fn continued(&self, index: &SceneIndex, length: f64) -> Self {
        let end = at(&self.legs[self.legs.len() - 1], self.legs[self.legs.len() - 1].length, 0.0);
        let mut route = self.clone();
        let Some(mut lane) = lane_at(index, end, self.legs[self.legs.len() - 1].along) else { return route };
        let map = index.map();
        let mut last = end;
        // The car changes over to the centre line within this distance.
        let mut skip = LANE_ENTRY;
        let mut is_first = true;
        for _ in 0..MAX_LANES {
            let feature = &map.features[lane];
            let points = map.points_of(feature);
            let flat = || points.iter().map(|p| [p[0], p[1]]);
            let nearest = flat().enumerate().min_by(|a, b| distance(a.1, end).total_cmp(&distance(b.1, end)));
            let from = if is_first { nearest.map_or(0, |(k, _)| k) } else { 0 };
            is_first = false;
            for p in flat().skip(from) {
                if distance(last, p) > skip {
                    route.push(last, p);
                    (last, skip) = (p, SPACING);
                }
                if route.length > self.length + length {
                    return route;
                }
            }
            let direction = route.legs[route.legs.len() - 1].along;
            let exits = feature.lane.as_ref().map_or(&[][..], |lane| &lane.exits);
            let straightness = |k: usize| {
                let points = map.points_of(&map.features[k]);
                let (Some(first), Some(last)) = (points.first(), points.last()) else { return -1.0 };
                let d = sub([last[0], last[1]], [first[0], first[1]]);
                dot(d, direction) / dot(d, d).sqrt().max(SHORTEST)
            };
            let next = exits.iter().copied().filter(|&k| k < map.features.len());
            let Some(next) = next.max_by(|a, b| straightness(*a).total_cmp(&straightness(*b))) else { break };
            lane = next;
        }
        route
    }

    /// Length, metres.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Corner points, the start first.
    pub fn points(&self) -> impl Iterator<Item = Point> {
        let last = self.legs.last().map(|leg| at(leg, leg.length, 0.0));
        self.legs.iter().map(|leg| leg.start).chain(last)
    }

    /// Coordinates of a point.
    pub fn locate(&self, p: Point, how: Localization) -> Coordinates {
        match how {
            Localization::Nearest => self.nearest(p),
            Localization::MetaDrive => self.by_lines(p, false),
        }
    }

    /// Coordinates by [`Localization::MetaDrive`], limited to legs beside which the point lies by at most
    /// 1 m, if there is one.
    pub fn locate_restricted(&self, p: Point) -> Coordinates {
        self.by_lines(p, true)
    }

    /// [`Localization::Nearest`] for a point near another one. `leg` is that of the other one, and then the point's: any
    /// leg gives the same coordinates, a near one the fastest.
    pub(crate) fn locate_near(&self, p: Point, leg: &mut usize) -> Coordinates {
        let near = &self.legs[(*leg).min(self.legs.len() - 1)];
        let local = near.leg_from_world(p);
        let out = [local.along - local.along.clamp(0.0, near.length), local.across];
        let found = self.nearest_within(p, squared(out).sqrt());
        *leg = found.0;
        found.1
    }

    fn nearest(&self, p: Point) -> Coordinates {
        let corners = self.runs.iter().map(|run| squared(sub(run.start, p)));
        self.nearest_within(p, corners.fold(f64::INFINITY, f64::min).sqrt()).1
    }

    /// The nearest leg, and the coordinates. `reach` is the distance of any point of the route.
    fn nearest_within(&self, p: Point, reach: f64) -> (usize, Coordinates) {
        let mut best = (f64::INFINITY, (0, Coordinates::default()));
        // Legs beyond the distance of a point of the route hold no nearest point.
        let mut least = (reach + SLACK) * (reach + SLACK);
        let last = self.runs.len() - 1;
        for (number, (run, legs)) in self.runs.iter().zip(self.legs.chunks(RUN)).enumerate() {
            // The first and the last leg have no bounds.
            let is_inner = number > 0 && number < last;
            if is_inner && run.bounds.squared_distance(p) > least {
                continue;
            }
            for (k, leg) in (number * RUN..).zip(legs) {
                let local = leg.leg_from_world(p);
                // Before the start and beyond the end the route continues straight.
                let first = if k == 0 { f64::NEG_INFINITY } else { 0.0 };
                let last = if k + 1 == self.legs.len() { f64::INFINITY } else { leg.length };
                let along = local.along.clamp(first, last);
                let out = [local.along - along, local.across];
                // Most legs of a run are farther than the nearest one so far, and `hypot` is slow.
                if squared(out) > least {
                    continue;
                }
                let away = out[0].hypot(out[1]);
                if away < best.0 {
                    let across = away.copysign(local.across);
                    best = (away, (k, Coordinates { along: leg.before + along, across }));
                    least = least.min((away + SLACK) * (away + SLACK));
                }
            }
        }
        best.1
    }

    fn by_lines(&self, p: Point, restricted: bool) -> Coordinates {
        let mut best: Option<Coordinates> = None;
        let mut inside: Option<Coordinates> = None;
        let least = |best: &mut Option<Coordinates>, found: Coordinates| {
            if best.is_none_or(|b| found.across.abs() < b.across.abs()) {
                *best = Some(found);
            }
        };
        for leg in &self.legs {
            let local = leg.leg_from_world(p);
            let found = Coordinates { along: leg.before + local.along, across: local.across };
            if local.along < 0.0 && distance(p, leg.start) < 2.0 * leg.length {
                return found;
            }
            least(&mut best, found);
            if found.across.abs() <= 1.0 && (-1.0..=self.length + 1.0).contains(&found.along) {
                least(&mut inside, found);
            }
        }
        inside.filter(|_| restricted).or(best).unwrap_or_default()
    }

    /// The point at coordinates; beyond the ends the route continues straight.
    pub fn point(&self, c: Coordinates) -> Point {
        at_leg(self.leg(c.along), c)
    }

    /// Heading of the route at a distance along it, rad.
    pub fn heading(&self, along: f64) -> f64 {
        self.leg(along).heading
    }

    /// Direction at a distance along the route by MetaDrive's choice of the leg.
    pub fn direction_metadrive(&self, along: f64) -> Point {
        self.leg_metadrive(along).along
    }

    /// The point at coordinates by MetaDrive's choice of the leg.
    pub fn point_metadrive(&self, c: Coordinates) -> Point {
        at_leg(self.leg_metadrive(c.along), c)
    }

    /// MetaDrive lets a leg reach 0.1 m farther.
    fn leg_metadrive(&self, along: f64) -> &Leg {
        let k = self.legs.partition_point(|leg| leg.before + leg.length + 0.1 < along);
        &self.legs[k.min(self.legs.len() - 1)]
    }

    /// As [`Route::point`], for a place that is some legs away from a leg.
    pub(crate) fn point_near(&self, c: Coordinates, leg: usize) -> Point {
        let is_before = |leg: &Leg| leg.before + leg.length <= c.along;
        let mut k = leg.min(self.legs.len() - 1);
        while k > 0 && !is_before(&self.legs[k - 1]) {
            k -= 1;
        }
        while k + 1 < self.legs.len() && is_before(&self.legs[k]) {
            k += 1;
        }
        at_leg(&self.legs[k], c)
    }

    fn leg(&self, along: f64) -> &Leg {
        let k = self.legs.partition_point(|leg| leg.before + leg.length <= along);
        &self.legs[k.min(self.legs.len() - 1)]
    }
}

/// Points of equal spacing on a polyline, metres; at least two.
pub(crate) fn resampled(all: &[Point], spacing: f64) -> Vec<Point> {
    let mut points = vec![all[0]];
    let mut rest = spacing;
    for pair in all.windows(2) {
        let d = sub(pair[1], pair[0]);
        let length = norm(d);
        let mut at = rest;
        while at <= length {
            let share = at / length;
            points.push([pair[0][0] + share * d[0], pair[0][1] + share * d[1]]);
            at += spacing;
        }
        rest = at - length;
    }
    if points.len() == 1 {
        points.push([all[0][0] + spacing, all[0][1]]);
    }
    points
}

/// The motor lane (map feature) at a point, in a direction.
fn lane_at(index: &SceneIndex, p: Point, direction: Point) -> Option<usize> {
    let lanes = index.motor_lanes();
    let is_along = |segment: &Segment| {
        let d = sub(segment.b, segment.a);
        dot(d, direction) > ALONG * dot(d, d).sqrt()
    };
    let near = lanes.nearest(p, LANE_REACH, is_along)?;
    Some(lanes.segments()[near.segment].feature as usize)
}

fn squared(d: Point) -> f64 {
    dot(d, d)
}

fn at(leg: &Leg, along: f64, across: f64) -> Point {
    let [tx, ty] = leg.along;
    [leg.start[0] + along * tx + across * ty, leg.start[1] + along * ty - across * tx]
}

fn at_leg(leg: &Leg, c: Coordinates) -> Point {
    at(leg, c.along - leg.before, c.across)
}

#[cfg(test)]
mod tests;
