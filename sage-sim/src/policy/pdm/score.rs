//! Scores of driven proposals: contacts at fault, edges, direction, progress, time to collision, comfort.

use std::cell::OnceCell;

use sage_core::{
    geometry::{Aabb, OrientedBox, Point, SweptBox, distance, dot, norm, sub},
    motion::DT,
};

use super::{comfort::is_comfortable, others::Other, path::Path, proposals::Shape, tracker::Driven};
use crate::{
    body::BodyKind,
    fault::{bearing, classify_meeting, is_behind, is_in_one_lane, lanes_at},
    policy::View,
};

/// Factor of a contact with a standing object.
const OBJECT_CONTACT: f64 = 0.5;
/// Space to edges, metres: half their width in the simulation, and what the tyres may miss.
const EDGE_SPACE: f64 = 0.2;
/// Metres against the traffic: below the first nothing happens, below the second the factor is a half, then 0.
const AGAINST: [f64; 2] = [2.0, 6.0];
/// Half the width of a lane in the test of its direction, metres: stated widths are distances to the next boundary.
const HALF_LANE: f64 = 1.85;
/// Cosine of the angle from which a lane counts as opposite (120°).
const OPPOSITE: f64 = -0.5;
/// Weights of progress, time to collision and comfort.
const WEIGHTS: [f64; 3] = [5.0, 5.0, 2.0];
/// Progress below which all proposals count as equal, metres.
const LEAST_PROGRESS: f64 = 0.1;
/// Steps ahead at which a constant velocity must not lead into another.
const AHEAD: [usize; 4] = [0, 3, 6, 9];
/// Speed below which no time to collision is asked for, m/s.
const STANDING: f64 = 5e-3;
/// Cosine of the angle within which others count as ahead (30°).
const IN_FRONT: f64 = 0.866_025_403_784_438_6;
/// Cosine of the angle from which lanes cross (30°).
const CROSSING: f64 = 0.866_025_403_784_438_6;

/// A scored proposal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scored {
    /// The score, 0 to 1.
    pub(super) value: f64,
    /// Step of its first contact at fault.
    pub(super) at_fault: Option<usize>,
}

/// Scores driven proposals against the same surroundings.
pub(super) struct Scorer<'a> {
    pub(super) view: &'a View<'a>,
    pub(super) shape: Shape,
    pub(super) others: &'a [Other],
    /// The path along which progress counts.
    pub(super) center: &'a Path,
}

/// A proposal with its boxes.
struct Drive<'a> {
    states: &'a [Driven],
    areas: Vec<OrientedBox>,
    bounds: Aabb,
}

/// Factors that any proposal needs, and its progress, metres.
struct Checked<'a> {
    drive: Drive<'a>,
    at_fault: Option<usize>,
    factor: f64,
    progress: f64,
}

impl Scorer<'_> {
    /// Scores of all proposals.
    pub(super) fn scores(&self, proposals: &[Vec<Driven>]) -> Vec<Scored> {
        let checked: Vec<Checked> = proposals.iter().map(|states| self.check(states)).collect();
        let best = checked.iter().map(|one| one.factor * one.progress).fold(0.0, f64::max);
        let score = |one: &Checked| {
            let value = if one.factor > 0.0 {
                let progress = if best > LEAST_PROGRESS { one.factor * one.progress / best } else { 1.0 };
                let holds = |is_fulfilled: bool| f64::from(u8::from(is_fulfilled));
                let parts =
                    [progress, holds(self.keeps_time(&one.drive)), holds(is_comfortable(one.drive.states))];
                let sum: f64 = WEIGHTS.iter().zip(parts).map(|(weight, part)| weight * part).sum();
                one.factor * sum / WEIGHTS.iter().sum::<f64>()
            } else {
                0.0
            };
            Scored { value, at_fault: one.at_fault }
        };
        checked.iter().map(score).collect()
    }

    fn check<'s>(&self, states: &'s [Driven]) -> Checked<'s> {
        let area = |state: &Driven| {
            let (sin, cos) = state.heading.sin_cos();
            self.shape.area(state.axle, [cos, sin])
        };
        let areas: Vec<OrientedBox> = states.iter().map(area).collect();
        let bounds = areas.iter().fold(Aabb::EMPTY, |all, area| all.union(&area.aabb()));
        let drive = Drive { states, areas, bounds };
        let (contacts, at_fault) = self.contacts(&drive);
        let mut factor = contacts;
        if factor > 0.0 && self.touches_edge(&drive) {
            factor = 0.0;
        }
        if factor > 0.0 {
            factor *= self.direction(&drive);
        }
        let along = |area: &OrientedBox| self.center.project(area.center);
        let (first, last) = (&drive.areas[0], &drive.areas[drive.areas.len() - 1]);
        let progress = if factor > 0.0 { (along(last) - along(first)).max(0.0) } else { 0.0 };
        Checked { drive, at_fault, factor, progress }
    }

    /// Factor of contacts at fault, and the step of the first one. A contact without fault ends the interest in that
    /// road user.
    fn contacts(&self, drive: &Drive) -> (f64, Option<usize>) {
        let (mut factor, mut first) = (1.0, None);
        for other in self.others.iter().filter(|other| other.bounds(drive.states.len()).meets(&drive.bounds))
        {
            let met = drive.areas.iter().enumerate().find_map(|(step, own)| {
                let area = other.at(step);
                area.intersects(own).then_some((step, area))
            });
            let Some((step, area)) = met else { continue };
            let speeds = [drive.states[step].speed, other.speed];
            let rear = self.shape.rear;
            let class =
                classify_meeting([&drive.areas[step], &area], speeds, other.kind, rear, self.view.index());
            // On a map without lanes a side contact counts.
            if class.is_at_fault() != Some(false) {
                factor = f64::min(factor, if other.kind == BodyKind::Object { OBJECT_CONTACT } else { 0.0 });
                first = Some(first.map_or(step, |before: usize| before.min(step)));
            }
        }
        (factor, first)
    }

    /// Whether an edge or median is touched. One that is nearer than the space at the start must only not be touched; one
    /// that is touched there does not count.
    fn touches_edge(&self, drive: &Drive) -> bool {
        let edges = self.view.index().edges();
        let grown = |area: &OrientedBox| OrientedBox {
            half_length: area.half_length + EDGE_SPACE,
            half_width: area.half_width + EDGE_SPACE,
            ..*area
        };
        let start = &drive.areas[0];
        let features_at = |area: &OrientedBox| -> Vec<u32> {
            let bounds = area.aabb();
            let touched = edges.near(&bounds).flatten().map(|k| &edges.segments()[k]);
            touched.filter(|s| area.intersects_segment(s.a, s.b)).map(|s| s.feature).collect()
        };
        let (near, touched) = (features_at(&grown(start)), features_at(start));
        drive.areas.windows(2).any(|pair| {
            let [from, to] = [grown(&pair[0]), grown(&pair[1])];
            let (wide, narrow) = (SweptBox::between(&from, &to), SweptBox::between(&pair[0], &pair[1]));
            let bounds = from.aabb().union(&to.aabb());
            edges.near(&bounds).flatten().any(|k| {
                let segment = &edges.segments()[k];
                let sweep = if near.contains(&segment.feature) { &narrow } else { &wide };
                sweep.intersects_segment(segment.a, segment.b)
                    && self.view.is_level(segment.height(0.5))
                    && !touched.contains(&segment.feature)
            })
        })
    }

    /// Factor of driving against the traffic.
    fn direction(&self, drive: &Drive) -> f64 {
        let (mut run, mut longest) = (0.0, 0.0f64);
        for pair in drive.areas.windows(2) {
            let way = distance(pair[0].center, pair[1].center);
            // A car that stands keeps its run.
            if way > 0.0 {
                run = if self.is_against(&pair[1]) { run + way } else { 0.0 };
                longest = longest.max(run);
            }
        }
        match longest {
            l if l < AGAINST[0] => 1.0,
            l if l < AGAINST[1] => 0.5,
            _ => 0.0,
        }
    }

    /// Whether the centre is in a lane of the opposite direction and in none of its own.
    fn is_against(&self, own: &OrientedBox) -> bool {
        let lanes = self.view.index().motor_lanes();
        let mut is_opposite = false;
        for k in lanes.near(&Aabb::around(own.center, HALF_LANE)).flatten() {
            let segment = &lanes.segments()[k];
            let away = sub(own.center, segment.at(segment.nearest_share(own.center)));
            if dot(away, away) <= HALF_LANE * HALF_LANE {
                let direction = sub(segment.b, segment.a);
                let along = dot(direction, own.axis);
                if along >= 0.0 {
                    return false;
                }
                is_opposite |= along < OPPOSITE * norm(direction);
            }
        }
        is_opposite
    }

    /// Whether no step, continued for 0.9 s at constant velocity, meets another: one ahead, or, where the car is not in
    /// one lane or is in an intersection, one that is not behind. A first meeting that does not count ends the
    /// interest in that road user.
    fn keeps_time(&self, drive: &Drive) -> bool {
        let last = AHEAD[AHEAD.len() - 1];
        let reach = drive.states.iter().map(|state| state.speed).fold(0.0, f64::max) * DT * last as f64;
        let bounds =
            Aabb { min: drive.bounds.min.map(|x| x - reach), max: drive.bounds.max.map(|x| x + reach) };
        let near = self.others.iter().filter(|other| other.bounds(drive.states.len() + last).meets(&bounds));
        let mut left: Vec<&Other> = near.collect();
        for (step, (state, own)) in drive.states.iter().zip(&drive.areas).enumerate() {
            if state.speed < STANDING {
                continue;
            }
            // Looked up at most once a step, and only where something is met.
            let is_between_lanes = OnceCell::new();
            for ahead in AHEAD {
                let way = state.speed * DT * ahead as f64;
                let center = [own.center[0] + way * own.axis[0], own.center[1] + way * own.axis[1]];
                let moved = OrientedBox { center, ..*own };
                let mut is_counted = false;
                left.retain(|other| {
                    let area = other.at(step + ahead);
                    if is_counted || !moved.intersects(&area) {
                        return true;
                    }
                    let rear = self.shape.rear;
                    is_counted = bearing(&moved, rear, area.center) > IN_FRONT
                        || (!is_behind(&moved, rear, area.center)
                            && *is_between_lanes.get_or_init(|| self.is_between_lanes(own, state.axle)));
                    false
                });
                if is_counted {
                    return false;
                }
            }
        }
        true
    }

    /// Whether a car is in several lanes, or its rear axle where lanes cross.
    fn is_between_lanes(&self, own: &OrientedBox, axle: Point) -> bool {
        let index = self.view.index();
        if is_in_one_lane(own, index) != Some(true) {
            return true;
        }
        let lanes = lanes_at(axle, 0.0, index);
        let crosses = |a: &(usize, Point), b: &(usize, Point)| dot(a.1, b.1) < CROSSING;
        lanes.iter().enumerate().any(|(k, a)| lanes[k + 1..].iter().any(|b| crosses(a, b)))
    }
}
