//! Scores of driven proposals: contacts at fault, edges, direction, progress, time to collision, comfort.

use std::cell::OnceCell;

use sage_core::{
    geometry::{Aabb, OrientedBox, Point, dot},
    motion::DT,
};

use super::{
    comfort::is_comfortable, others::Other, path::Path, proposals::Shape, surroundings::Surroundings,
    tracker::Driven,
};
use crate::{
    body::BodyKind,
    fault::{bearing, classify_meeting, is_behind, is_in_one_lane, lanes_at},
    policy::View,
};

/// Factor of a contact with a standing object.
const OBJECT_CONTACT: f64 = 0.5;
/// Weights of progress, time to collision and comfort.
const WEIGHTS: [f64; 3] = [5.0, 5.0, 2.0];
/// Progress below which all proposals count as equal, metres.
const LEAST_PROGRESS: f64 = 0.1;
/// Steps ahead at which a constant velocity must not lead into another.
const AHEAD: [usize; 4] = [0, 3, 6, 9];
const LAST_AHEAD: usize = AHEAD[AHEAD.len() - 1];
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

/// A driven proposal.
pub(super) struct Drive {
    states: Vec<Driven>,
    /// Boxes of the states.
    areas: Vec<OrientedBox>,
    bounds: Aabb,
}

impl Drive {
    /// A drive of states, with their boxes.
    pub(super) fn new(states: Vec<Driven>, areas: Vec<OrientedBox>) -> Self {
        let bounds = areas.iter().fold(Aabb::EMPTY, |all, area| all.union(&area.aabb()));
        Self { states, areas, bounds }
    }
}

/// Factors that any proposal needs, and its progress, metres.
#[derive(Clone, Copy)]
struct Checked {
    at_fault: Option<usize>,
    factor: f64,
    progress: f64,
}

/// Road users with the bounds of their forecasts.
type Bounded<'a> = Vec<(Aabb, &'a Other)>;

impl Scorer<'_> {
    /// Scores of all proposals. That of a proposal which cannot be the best one, or is not the first of the best, may be
    /// given as 0.
    pub(super) fn scores(&self, drives: &[Drive]) -> Vec<Scored> {
        let checked = self.check(drives);
        let best = checked.iter().map(|one| one.factor * one.progress).fold(0.0, f64::max);
        let value = |one: &Checked, keeps_time: bool, is_comfortable: bool| {
            let progress = if best > LEAST_PROGRESS { one.factor * one.progress / best } else { 1.0 };
            let holds = |is_fulfilled: bool| f64::from(u8::from(is_fulfilled));
            let parts = [progress, holds(keeps_time), holds(is_comfortable)];
            let sum: f64 = WEIGHTS.iter().zip(parts).map(|(weight, part)| weight * part).sum();
            one.factor * sum / WEIGHTS.iter().sum::<f64>()
        };
        let mut scores: Vec<Scored> =
            checked.iter().map(|one| Scored { value: 0.0, at_fault: one.at_fault }).collect();
        let ahead = self.bounded(drives.first().map_or(0, |drive| drive.states.len()) + LAST_AHEAD);
        // Those that can reach most come first, so that the others need no test of time and comfort.
        let mut order: Vec<usize> = (0..drives.len()).filter(|k| checked[*k].factor > 0.0).collect();
        let most: Vec<f64> = checked.iter().map(|one| value(one, true, true)).collect();
        order.sort_by(|a, b| most[*b].total_cmp(&most[*a]));
        let (mut first, mut highest) = (usize::MAX, 0.0);
        for k in order {
            let can_win = |most: f64| most > highest || (most == highest && k < first);
            if !can_win(most[k]) {
                continue;
            }
            let keeps_time = self.keeps_time(&drives[k], &ahead);
            if !can_win(value(&checked[k], keeps_time, true)) {
                continue;
            }
            let found = value(&checked[k], keeps_time, is_comfortable(&drives[k].states));
            scores[k].value = found;
            if can_win(found) {
                (first, highest) = (k, found);
            }
        }
        scores
    }

    /// Road users with the bounds of their forecasts up to a step.
    fn bounded(&self, step: usize) -> Bounded<'_> {
        self.others.iter().map(|other| (other.bounds(step), other)).collect()
    }

    /// All drives start with the same state.
    fn check(&self, drives: &[Drive]) -> Vec<Checked> {
        let Some(start) = drives.first() else { return Vec::new() };
        let bounds = drives.iter().fold(Aabb::EMPTY, |all, drive| all.union(&drive.bounds));
        let surroundings = Surroundings::new(self.view, &start.areas[0], &bounds);
        let others = self.bounded(start.states.len());
        let mut place = 0;
        let mut along = |area: &OrientedBox| self.center.project_near(area.center, &mut place);
        let first = along(&start.areas[0]);
        let check = |drive: &Drive| {
            let (contacts, at_fault) = self.contacts(drive, &others);
            let mut factor = contacts;
            if factor > 0.0 && surroundings.touches_edge(&drive.areas) {
                factor = 0.0;
            }
            if factor > 0.0 {
                factor *= surroundings.direction(&drive.areas);
            }
            let last = &drive.areas[drive.areas.len() - 1];
            let progress = if factor > 0.0 { (along(last) - first).max(0.0) } else { 0.0 };
            Checked { at_fault, factor, progress }
        };
        drives.iter().map(check).collect()
    }

    /// Factor of contacts at fault, and the step of the first one. A contact without fault ends the interest in that
    /// road user.
    fn contacts(&self, drive: &Drive, others: &Bounded) -> (f64, Option<usize>) {
        let (mut factor, mut first) = (1.0, None);
        for (_, other) in others.iter().filter(|(bounds, _)| bounds.meets(&drive.bounds)) {
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

    /// Whether no step, continued for 0.9 s at constant velocity, meets another: one ahead, or, where the car is not in
    /// one lane or is in an intersection, one that is not behind. A first meeting that does not count ends the
    /// interest in that road user.
    fn keeps_time(&self, drive: &Drive, others: &Bounded) -> bool {
        let fastest = drive.states.iter().map(|state| state.speed).fold(0.0, f64::max);
        let reach = fastest * DT * LAST_AHEAD as f64;
        let bounds =
            Aabb { min: drive.bounds.min.map(|x| x - reach), max: drive.bounds.max.map(|x| x + reach) };
        let near = others.iter().filter(|(forecast, _)| forecast.meets(&bounds));
        let mut left: Vec<&Other> = near.map(|(_, other)| *other).collect();
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
