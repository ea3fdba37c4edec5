//! Proposals: car following on three paths at five speeds, and braking to a stop on each path.

use sage_core::{
    geometry::{OrientedBox, Point, distance},
    motion::{
        DT,
        idm::{Idm, Leader},
    },
};

use super::{
    others::Other,
    path::{OFFSETS, Path, Place},
    tracker::Reference,
};
use crate::fault::is_behind;

/// Steps of a proposal.
pub(super) const STEPS: usize = 40;
/// Target speeds as shares of the limit.
const SPEEDS: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
/// Steps after which the leader is looked for again.
const RENEWED: usize = 2;
/// Limits of the acceleration in car following, m/s².
const LIMITS: [f64; 2] = [-3.0, 1.5];
/// Deceleration of the proposals that brake to a stop, m/s².
pub(super) const BRAKE: f64 = 8.0;
/// Time at the speed limit that a corridor reaches ahead, seconds.
const CORRIDOR: f64 = 8.0;

fn model(desired_speed: f64) -> Idm {
    Idm {
        desired_speed,
        time_gap: 1.5,
        standing_gap: 1.0,
        acceleration: 1.5,
        deceleration: 3.0,
        exponent: 10.0,
    }
}

/// What the proposals start from.
pub(super) struct Outset<'a> {
    /// Centre of the rear axle.
    pub(super) axle: Point,
    /// Speed, m/s.
    pub(super) speed: f64,
    /// Speed limit, m/s.
    pub(super) limit: f64,
    pub(super) shape: Shape,
    pub(super) others: &'a [Other],
    /// Stop point of a red light: a standing leader.
    pub(super) stop: Option<Point>,
    /// With the defects of the published code.
    pub(super) as_published: bool,
}

/// Shape of the car.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    /// Half its length and half its width, metres.
    pub(super) half: [f64; 2],
    /// Distance of the rear axle behind the centre, metres.
    pub(super) rear: f64,
}

impl Shape {
    /// The box of the car with its rear axle at a point.
    pub(super) fn area(&self, axle: Point, axis: Point) -> OrientedBox {
        let center = [axle[0] + self.rear * axis[0], axle[1] + self.rear * axis[1]];
        OrientedBox { center, axis, half_length: self.half[0], half_width: self.half[1] }
    }
}

/// A way to drive the next four seconds.
pub(super) struct Proposal {
    /// Index of its path.
    pub(super) path: usize,
    /// Whether it brakes to a stop, by a command that no tracker delays.
    pub(super) brakes: bool,
    /// Distance of the rear axle along the path, metres, and speed, m/s, at each step.
    states: Vec<[f64; 2]>,
}

impl Proposal {
    /// Where the car should be at each step.
    pub(super) fn references(&self, path: &Path) -> Vec<Reference> {
        let reference = |[along, speed]: &[f64; 2]| {
            let Place { position, axis, curvature, .. } = path.at(*along);
            Reference { position, heading: axis[1].atan2(axis[0]), speed: *speed, curvature }
        };
        self.states.iter().map(reference).collect()
    }
}

/// A road user in the corridor of a path.
struct Ahead<'a> {
    other: &'a Other,
    /// Distance of its centre along the path, metres.
    along: f64,
    area: OrientedBox,
}

/// What a proposal follows: an obstacle at a distance along the path, half of whose length is `half_length`.
#[derive(Clone, Copy)]
struct Followed {
    along: f64,
    speed: f64,
    half_length: f64,
}

/// The 15 proposals, path by path in the order of their speeds. They start on their paths, beside the car.
pub(super) fn proposals(paths: &[Path; 3], outset: &Outset) -> Vec<Proposal> {
    let mut all = Vec::with_capacity(OFFSETS.len() * SPEEDS.len());
    for (k, path) in paths.iter().enumerate() {
        let start = path.project(outset.axle);
        let corridor = corridor(path, start, outset);
        let stop = outset.stop.map(|point| path.project(point));
        // Defect: before the first search, something stands where the path begins.
        let first = Followed { along: 0.0, speed: 0.0, half_length: 0.0 };
        let mut states = [[start, outset.speed]; SPEEDS.len()];
        let mut followed = [first; SPEEDS.len()];
        let mut driven: [Vec<[f64; 2]>; SPEEDS.len()] = std::array::from_fn(|n| {
            let mut all = Vec::with_capacity(STEPS + 1);
            all.push(states[n]);
            all
        });
        for step in 1..=STEPS {
            if step % RENEWED == 0 || (step == 1 && !outset.as_published) {
                let mut half_length = 0.0;
                for n in 0..SPEEDS.len() {
                    followed[n] = leader(path, &corridor[step / RENEWED], states[n][0], stop, outset);
                    if outset.as_published {
                        // Defect: the half length of a path's end stays for the proposals after it.
                        half_length = f64::max(half_length, followed[n].half_length);
                        followed[n].half_length = half_length;
                    }
                }
            }
            for n in 0..SPEEDS.len() {
                let target = (SPEEDS[n] * outset.limit).min(path.speed(states[n][0]));
                states[n] = follow(states[n], &followed[n], target, outset.as_published);
                driven[n].push(states[n]);
            }
        }
        all.extend(driven.map(|states| Proposal { path: k, brakes: false, states }));
    }
    all
}

/// Three proposals that brake to a stop, one a path.
pub(super) fn stops(paths: &[Path; 3], outset: &Outset) -> impl Iterator<Item = Proposal> {
    paths.iter().enumerate().map(|(k, path)| {
        let start = path.project(outset.axle);
        let at = |step: usize| {
            let time = DT * step as f64;
            let braked = time.min(outset.speed / BRAKE);
            [start + braked * (outset.speed - 0.5 * BRAKE * braked), (outset.speed - BRAKE * time).max(0.0)]
        };
        Proposal { path: k, brakes: true, states: (0..=STEPS).map(at).collect() }
    })
}

/// One step of car following.
fn follow([along, speed]: [f64; 2], followed: &Followed, target: f64, as_published: bool) -> [f64; 2] {
    let model = model(target.max(1e-3));
    let gap = (followed.along - along - followed.half_length).max(model.standing_gap);
    let wanted = if as_published {
        // The published gap may become negative behind a much faster leader; its square then brakes.
        let root = 2.0 * (model.acceleration * model.deceleration).sqrt();
        let desired = model.standing_gap + speed * model.time_gap + speed * (speed - followed.speed) / root;
        let free = 1.0 - (speed.max(0.0) / model.desired_speed).powf(model.exponent);
        model.acceleration * (free - (desired / gap).powi(2))
    } else {
        model.acceleration(speed, Some(Leader { gap, speed: followed.speed }))
    };
    let next = speed + DT * wanted.clamp(LIMITS[0], LIMITS[1]);
    [along + DT * speed, if as_published { next } else { next.max(0.0) }]
}

/// Road users in the corridor of a path, by the time of the forecast.
fn corridor<'a>(path: &Path, start: f64, outset: &Outset<'a>) -> Vec<Vec<Ahead<'a>>> {
    let range = [start, start + CORRIDOR * outset.limit];
    let half_width = outset.shape.half[1];
    let bounds = path.bounds([range[0], range[1].min(path.length())], half_width);
    let parts = path.corridor(range, half_width);
    let place = path.at(start);
    let own = outset.shape.area(place.position, place.axis);
    let mut found: Vec<Vec<Ahead>> = (0..=STEPS / RENEWED).map(|_| Vec::new()).collect();
    for other in outset.others.iter().filter(|other| other.bounds(STEPS).meets(&bounds)) {
        // A forecast that does not react takes those behind through the car; nobody brakes for them.
        if !outset.as_published && is_behind(&own, outset.shape.rear, other.at(0).center) {
            continue;
        }
        let mut last = 0;
        let mut look = |step: usize| {
            let area = other.at(step);
            let radius = area.radius();
            // Most are never near the corridor, and need no search of the nearest point.
            if !parts.iter().any(|part| part.squared_distance(area.center) <= radius * radius) {
                return None;
            }
            let along = path.project_near(area.center, &mut last);
            path.meets(&area, along, half_width, range).then_some((along, area))
        };
        let standing = other.stands().then(|| look(0));
        for (k, list) in found.iter_mut().enumerate() {
            if let Some((along, area)) = standing.unwrap_or_else(|| look(k * RENEWED)) {
                list.push(Ahead { other, along, area });
            }
        }
    }
    found
}

/// The nearest road user before a car whose rear axle is at a distance along the path, the red light if its stop point
/// is nearer, or the end of the path.
fn leader(path: &Path, corridor: &[Ahead], along: f64, stop: Option<f64>, outset: &Outset) -> Followed {
    // Without anybody ahead the place does not matter.
    let place = if corridor.is_empty() { Place::default() } else { path.at(along) };
    let own = outset.shape.area(place.position, place.axis);
    let mut nearest: Option<(f64, &Ahead)> = None;
    for ahead in corridor.iter().filter(|ahead| ahead.along > along) {
        let least = distance(ahead.area.center, own.center) - ahead.area.radius() - own.radius();
        if nearest.is_some_and(|(gap, _)| least >= gap) {
            continue;
        }
        let gap = own.distance(&ahead.area);
        if nearest.is_none_or(|(other, _)| gap < other) {
            nearest = Some((gap, ahead));
        }
    }
    let Shape { half, rear } = outset.shape;
    let to_stop = stop.map(|stop| stop - along - rear - half[0]);
    if let Some(gap) = to_stop.filter(|gap| nearest.is_none_or(|(other, _)| *gap < other)) {
        return Followed { along: along + gap, speed: 0.0, half_length: 0.0 };
    }
    match nearest {
        Some((gap, ahead)) => {
            Followed { along: along + gap, speed: ahead.other.speed_along(place.axis), half_length: 0.0 }
        }
        None => Followed { along: path.length(), speed: 0.0, half_length: outset.shape.half[0] },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn behind_a_much_faster_leader_only_the_published_formula_brakes() {
        let followed = Followed { along: 5.0, speed: 20.0, half_length: 0.0 };
        let gain = |as_published| (follow([0.0, 5.0], &followed, 15.0, as_published)[1] - 5.0) / DT;
        assert!((gain(true) + 3.0).abs() < 1e-9 && gain(false) > 1.0, "{} {}", gain(true), gain(false));
    }

    /// Gap at the end behind a standing leader, and whether it was ever below 0.
    fn stopped(speed: f64, gap: f64) -> (f64, bool) {
        let (mut state, mut hit) = ([0.0, speed], false);
        let followed = Followed { along: gap, speed: 0.0, half_length: 0.0 };
        for _ in 0..400 {
            state = follow(state, &followed, 15.0, false);
            hit |= state[0] > gap;
        }
        (gap - state[0], hit)
    }

    #[test]
    fn it_stops_a_metre_behind_a_standing_leader() {
        for (speed, gap) in [(10.0, 20.0), (10.0, 30.0), (13.0, 40.0)] {
            let (left, hit) = stopped(speed, gap);
            assert!((left - 1.0).abs() < 0.05 && !hit, "{speed}, {gap}: {left}");
        }
        // The strongest deceleration of 3 m/s² is not enough from 10 m/s within 15 m.
        let (left, hit) = stopped(10.0, 15.0);
        assert!(hit && (left + 2.19).abs() < 0.02, "{left}");
    }

    #[test]
    fn the_published_first_step_brakes_for_nothing() {
        let line: Vec<Point> = (0..60).map(|k| [f64::from(k), 0.0]).collect();
        let paths = Path::all(&crate::route::Route::new(&line), None);
        let shape = Shape { half: [2.3, 1.0], rear: 1.4 };
        let first = |as_published| {
            let outset = Outset {
                axle: [0.0; 2],
                speed: 10.0,
                limit: 15.0,
                shape,
                others: &[],
                stop: None,
                as_published,
            };
            proposals(&paths, &outset)[4].states[1][1]
        };
        assert!((first(true) - 9.7).abs() < 1e-9);
        assert!(first(false) > 10.1);
    }
}
