//! Selection of ego and adversary: two cars whose paths conflict, and a check that some attack succeeds.

use std::sync::Arc;

use sage_core::{
    geometry::{Point, distance, wrap_angle},
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Encounter, Feasibility, MapFeasibility},
    scene::{AdversaryOrigin, Scene, SceneIndex, Track, TrackKind},
};

use super::medians;

/// Least displacement of ego and adversary in the future, metres.
const LEAST_DISPLACEMENT: f64 = 15.0;
/// Accepted gaps between the two arrivals at the closest point of their paths, frames.
const GAPS: std::ops::RangeInclusive<usize> = 6..=45;
/// Largest distance of a conflict from the centre of the scene, metres.
const NEAR: f64 = 40.0;
/// Number of pairs that are tried.
const PAIRS: usize = 12;
/// Constant accelerations of the simple attacks, m/s².
const GAINS: [f64; 11] = [-6.0, -4.0, -2.5, -1.5, -0.8, -0.3, 0.0, 0.4, 0.9, 1.6, 2.4];
/// Lateral shifts of the simple attacks, to the left, metres, and their names.
const SHIFTS: [(f64, &str); 3] = [(0.0, ""), (3.5, "left, "), (-3.5, "right, ")];
/// Duration of a shift, seconds, and its least length, metres.
const SHIFT_TIME: f64 = 3.0;
const SHIFT_LENGTH: f64 = 18.0;

/// Simple attacks of a scene's adversary, named: its logged path with other constant accelerations, in its
/// own lane and with a lane change. Empty without an adversary that is valid in all of the future.
pub fn attacks(scene: &Scene) -> Vec<(String, Trajectory)> {
    let Some(track) = scene.adversary.map(|k| &scene.tracks[k]) else { return Vec::new() };
    if track.count_valid(NOW..NOW + HORIZON + 1) <= HORIZON {
        return Vec::new();
    }
    let path = LoggedPath::of(track);
    let [vx, vy] = track.velocity[NOW];
    let speed = vx.hypot(vy);
    let mut out = Vec::new();
    for (shift, side) in SHIFTS {
        for gain in GAINS {
            let change = match gain {
                g if g < 0.0 => format!("brake {:.1} m/s²", -g),
                g if g > 0.0 => format!("gain {g:.1} m/s²"),
                _ => "same speed".to_owned(),
            };
            let name = format!("{side}{change}");
            if let Ok(trajectory) = Trajectory::new(&name, path.retimed(speed, gain, shift)) {
                out.push((name, trajectory));
            }
        }
    }
    out
}

/// A logged path by arc length, extended straight beyond its end.
struct LoggedPath {
    points: Vec<Point>,
    lengths: Vec<f64>,
    heading: f64,
}

impl LoggedPath {
    fn of(track: &Track) -> Self {
        let mut points = vec![track.point(NOW)];
        let mut lengths = vec![0.0];
        for frame in NOW + 1..=NOW + HORIZON {
            let (last, length) = (points[points.len() - 1], lengths[lengths.len() - 1]);
            let step = distance(last, track.point(frame));
            // Standing adds no length and no direction.
            if step > 0.05 {
                points.push(track.point(frame));
                lengths.push(length + step);
            }
        }
        Self { points, lengths, heading: track.heading[NOW + HORIZON] }
    }

    fn at(&self, s: f64) -> (Point, f64) {
        let k = self.lengths.partition_point(|length| *length <= s);
        match (k.checked_sub(1), self.points.get(k)) {
            (Some(before), Some(b)) => {
                let (a, length) = (self.points[before], self.lengths[before]);
                let share = (s - length) / (self.lengths[k] - length);
                let at = [0, 1].map(|c| a[c] + share * (b[c] - a[c]));
                (at, (b[1] - a[1]).atan2(b[0] - a[0]))
            }
            _ => {
                let (end, length) =
                    (self.points[self.points.len() - 1], self.lengths[self.lengths.len() - 1]);
                let (sin, cos) = self.heading.sin_cos();
                ([end[0] + (s - length) * cos, end[1] + (s - length) * sin], self.heading)
            }
        }
    }

    fn retimed(&self, speed: f64, gain: f64, shift: f64) -> Vec<Point> {
        let (mut s, mut v) = (0.0, speed);
        let shift_length = (speed * SHIFT_TIME).max(SHIFT_LENGTH);
        (0..HORIZON)
            .map(|_| {
                let next = (v + gain * DT).clamp(0.0, 30.0);
                s += 0.5 * (v + next) * DT;
                v = next;
                let (at, heading) = self.at(s);
                // The shift depends on the distance driven, so that a standing car does not slide.
                let t = (s / shift_length).min(1.0);
                let left = shift * t * t * (3.0 - 2.0 * t);
                [at[0] - left * heading.sin(), at[1] + left * heading.cos()]
            })
            .collect()
    }
}

/// Conflict of two logged paths; smaller is better.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
struct Conflict {
    /// Whether it is far from the centre of the scene.
    far: bool,
    /// 0: the paths cross or merge; 1: one follows the other; 2: they are parallel.
    kind: u8,
    /// Frames between the arrivals at the closest point.
    gap: usize,
    distance: f64,
}

/// The conflict of two logged futures, if there is one.
fn conflict(a: &Track, b: &Track, middle: Point) -> Option<Conflict> {
    let future = NOW + 1..=NOW + HORIZON;
    let mut nearest = (f64::INFINITY, 0, 0);
    for s in future.clone().step_by(2) {
        for t in future.clone().step_by(2) {
            let d = distance(a.point(s), b.point(t));
            if d < nearest.0 {
                nearest = (d, s, t);
            }
        }
    }
    let (d, s, t) = nearest;
    let turn = wrap_angle(a.heading[s] - b.heading[t]).abs();
    let kind = match (d, turn) {
        (d, turn) if d < 2.0 && turn > 0.3 => 0,
        (d, _) if d < 2.0 => 1,
        (d, turn) if d < 4.5 && turn < 0.3 => 2,
        _ => return None,
    };
    let far = distance(a.point(s), middle) > NEAR;
    GAPS.contains(&s.abs_diff(t)).then_some(Conflict { far, kind, gap: s.abs_diff(t), distance: d })
}

/// Assigns ego and adversary to two of the first `cars` tracks, preferably near `middle`. The logged
/// futures of both must be feasible and without contact, and some simple attack must succeed. In a scene with
/// medians, one is between the two, and the attack avoids it.
pub(super) fn assign(scene: &mut Scene, index: &Arc<SceneIndex>, cars: usize, middle: Point) -> bool {
    let moving = |k: &usize| {
        let track = &scene.tracks[*k];
        let all = track.count_valid(0..scene.frames) == scene.frames;
        all && distance(track.point(NOW), track.point(NOW + HORIZON)) > LEAST_DISPLACEMENT
    };
    let usable: Vec<usize> = (0..cars).filter(moving).collect();
    let mut pairs: Vec<(Conflict, usize, usize)> = Vec::new();
    for &i in &usable {
        for &j in usable.iter().filter(|j| **j != i) {
            let (a, b) = (&scene.tracks[i], &scene.tracks[j]);
            let found = conflict(a, b, middle).filter(|_| medians::separate(a, b, index));
            pairs.extend(found.map(|c| (c, i, j)));
        }
    }
    pairs.sort_by(|a, b| {
        let key = |p: &(Conflict, usize, usize)| (p.0.far, p.0.kind, p.0.gap, p.1, p.2);
        key(a).cmp(&key(b)).then(a.0.distance.total_cmp(&b.0.distance))
    });
    scene.adversary_origin = AdversaryOrigin::File;
    pairs.into_iter().take(PAIRS).any(|(_, ego, adversary)| is_usable_pair(scene, index, ego, adversary))
}

fn is_usable_pair(scene: &mut Scene, index: &Arc<SceneIndex>, ego: usize, adversary: usize) -> bool {
    let log = |track: &Track| {
        Trajectory::new("log", (NOW + 1..=NOW + HORIZON).map(|f| track.point(f)).collect()).ok()
    };
    (scene.ego, scene.adversary) = (ego, Some(adversary));
    let swapped = Arc::new(Scene { ego: adversary, adversary: Some(ego), ..scene.clone() });
    let scene = Arc::new(scene.clone());
    let rule = MapFeasibility::default();
    // The ego's own log, checked as if it were the adversary's.
    if !is_clean(&swapped, index, &rule, log(&scene.tracks[ego]))
        || !is_clean(&scene, index, &rule, log(&scene.tracks[adversary]))
    {
        return false;
    }
    let Ok(ctx) = Context::new(&scene, index, &ContextOptions::default()) else { return false };
    attacks(&scene).into_iter().any(|(_, trajectory)| {
        let candidate = ctx.candidate(trajectory);
        Encounter::of(&candidate, ctx.ego()).contact.is_some()
            && rule.is_feasible(&candidate, &ctx)
            && !medians::touched_by(&candidate, index)
    })
}

/// Whether a logged future is feasible and without contact with the ego.
fn is_clean(
    scene: &Arc<Scene>,
    index: &Arc<SceneIndex>,
    rule: &MapFeasibility,
    trajectory: Option<Trajectory>,
) -> bool {
    let (Some(trajectory), Ok(ctx)) = (trajectory, Context::new(scene, index, &ContextOptions::default()))
    else {
        return false;
    };
    let candidate = ctx.candidate(trajectory);
    Encounter::of(&candidate, ctx.ego()).contact.is_none() && rule.is_feasible(&candidate, &ctx)
}

/// Whether two vehicles of a scene touch at any frame.
pub(super) fn any_vehicles_touch(scene: &Scene) -> bool {
    let cars: Vec<&Track> = scene.tracks.iter().filter(|t| t.kind == TrackKind::Vehicle).collect();
    (0..scene.frames).any(|f| {
        let boxes: Vec<_> = cars.iter().filter(|t| t.is_valid(f)).map(|t| t.oriented_box(f)).collect();
        boxes.iter().enumerate().any(|(k, a)| boxes[..k].iter().any(|b| a.intersects(b)))
    })
}
