//! Ego and adversary: two cars whose ways conflict, and a check that trouble is possible.

use std::sync::Arc;

use sage_core::{
    geometry::{Point, distance, wrap_angle},
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Encounter, Feasibility, MapFeasibility},
    scene::{AdversaryOrigin, Scene, SceneIndex, Track, TrackKind},
};

/// Least way of ego and adversary in the future, metres.
const LEAST_WAY: f64 = 15.0;
/// Gaps between the two arrivals where their ways come nearest, frames.
const GAPS: std::ops::RangeInclusive<usize> = 6..=45;
/// Distance from the middle of the scene within which a conflict belongs to it, metres.
const NEAR: f64 = 40.0;
/// Pairs that are tried.
const PAIRS: usize = 12;
/// Constant accelerations that are tried, m/s².
const GAINS: [f64; 11] = [-6.0, -4.0, -2.5, -1.5, -0.8, -0.3, 0.0, 0.4, 0.9, 1.6, 2.4];
/// Shifts to the left that are tried, metres, and their names.
const SHIFTS: [(f64, &str); 3] = [(0.0, ""), (3.5, "left, "), (-3.5, "right, ")];
/// Time of a shift, seconds, and the least way that it takes, metres.
const SHIFT_TIME: f64 = 3.0;
const SHIFT_WAY: f64 = 18.0;

/// Simple attacks of a scene's adversary, named: its logged way driven with other constant
/// accelerations, in its own lane and moving one lane over. Empty without an adversary that is
/// seen in all of the future.
pub fn attacks(scene: &Scene) -> Vec<(String, Trajectory)> {
    let Some(track) = scene.adversary.map(|k| &scene.tracks[k]) else { return Vec::new() };
    if track.count_valid(NOW..NOW + HORIZON + 1) <= HORIZON {
        return Vec::new();
    }
    let way = Way::of(track);
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
            if let Ok(path) = Trajectory::new(&name, way.driven(speed, gain, shift)) {
                out.push((name, path));
            }
        }
    }
    out
}

/// A logged way by length, straight on beyond its end.
struct Way {
    points: Vec<Point>,
    lengths: Vec<f64>,
    heading: f64,
}

impl Way {
    fn of(track: &Track) -> Self {
        let mut points = vec![track.point(NOW)];
        let mut lengths = vec![0.0];
        for frame in NOW + 1..=NOW + HORIZON {
            let (last, length) = (points[points.len() - 1], lengths[lengths.len() - 1]);
            let step = distance(last, track.point(frame));
            // Standing adds nothing, and no direction.
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

    fn driven(&self, speed: f64, gain: f64, shift: f64) -> Vec<Point> {
        let (mut s, mut v) = (0.0, speed);
        let shift_way = (speed * SHIFT_TIME).max(SHIFT_WAY);
        (0..HORIZON)
            .map(|_| {
                let next = (v + gain * DT).clamp(0.0, 30.0);
                s += 0.5 * (v + next) * DT;
                v = next;
                let (at, heading) = self.at(s);
                // Smoothly by way driven, so that a car that stands does not slide.
                let t = (s / shift_way).min(1.0);
                let left = shift * t * t * (3.0 - 2.0 * t);
                [at[0] - left * heading.sin(), at[1] + left * heading.cos()]
            })
            .collect()
    }
}

/// How two logged ways conflict; smaller is better.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
struct Conflict {
    /// Whether it lies far from the middle of the scene, where its kind shows.
    far: bool,
    /// 0 ways cross or merge, 1 one follows the other, 2 they run side by side.
    kind: u8,
    /// Frames between the arrivals where the ways come nearest.
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

/// Makes two of the first `cars` tracks ego and adversary, near `middle` rather than far, if the log of both is feasible, they do
/// not touch, and some simple attack hits.
pub(super) fn choose(scene: &mut Scene, cars: usize, middle: Point) -> bool {
    let moving = |k: &usize| {
        let track = &scene.tracks[*k];
        let all = track.count_valid(0..scene.frames) == scene.frames;
        all && distance(track.point(NOW), track.point(NOW + HORIZON)) > LEAST_WAY
    };
    let usable: Vec<usize> = (0..cars).filter(moving).collect();
    let mut pairs: Vec<(Conflict, usize, usize)> = Vec::new();
    for &i in &usable {
        for &j in usable.iter().filter(|j| **j != i) {
            pairs.extend(conflict(&scene.tracks[i], &scene.tracks[j], middle).map(|c| (c, i, j)));
        }
    }
    pairs.sort_by(|a, b| {
        let key = |p: &(Conflict, usize, usize)| (p.0.far, p.0.kind, p.0.gap, p.1, p.2);
        key(a).cmp(&key(b)).then(a.0.distance.total_cmp(&b.0.distance))
    });
    let index = SceneIndex::new(scene.map.clone());
    scene.adversary_origin = AdversaryOrigin::File;
    pairs.into_iter().take(PAIRS).any(|(_, ego, adversary)| works(scene, &index, ego, adversary))
}

fn works(scene: &mut Scene, index: &Arc<SceneIndex>, ego: usize, adversary: usize) -> bool {
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
    attacks(&scene).into_iter().any(|(_, path)| {
        let candidate = ctx.candidate(path);
        Encounter::of(&candidate, ctx.ego()).contact.is_some() && rule.is_feasible(&candidate, &ctx)
    })
}

/// Whether a logged path is feasible and touches nobody.
fn is_clean(
    scene: &Arc<Scene>,
    index: &Arc<SceneIndex>,
    rule: &MapFeasibility,
    path: Option<Trajectory>,
) -> bool {
    let (Some(path), Ok(ctx)) = (path, Context::new(scene, index, &ContextOptions::default())) else {
        return false;
    };
    let candidate = ctx.candidate(path);
    Encounter::of(&candidate, ctx.ego()).contact.is_none() && rule.is_feasible(&candidate, &ctx)
}

/// Whether any two vehicles of a scene touch at a frame.
pub(super) fn anybody_touches(scene: &Scene) -> bool {
    let cars: Vec<&Track> = scene.tracks.iter().filter(|t| t.kind == TrackKind::Vehicle).collect();
    (0..scene.frames).any(|f| {
        let boxes: Vec<_> = cars.iter().filter(|t| t.is_valid(f)).map(|t| t.oriented_box(f)).collect();
        boxes.iter().enumerate().any(|(k, a)| boxes[..k].iter().any(|b| a.intersects(b)))
    })
}
