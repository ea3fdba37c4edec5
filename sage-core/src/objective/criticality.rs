//! Criticality of an encounter, beyond the paper's reward.
//!
//! All measures compare ego and adversary at the steps at which both have a box. Velocities are backward
//! differences. A measure that is undefined is `None`, never 0.

use serde::{Deserialize, Serialize};

use super::{Candidate, EgoPath, Reward, Situation};
use crate::{
    geometry::{OrientedBox, Point, cross, dot, norm, sub},
    motion::DT,
    registry::{Entry, NoOptions},
};

/// Cap of the required deceleration, m/s²: what tyres transfer on dry asphalt, a friction of 1. A driver who needs more
/// cannot avoid contact by braking, however much more it is.
pub const FULL_BRAKING: f64 = 9.81;
/// Overlap of a collision course that counts in full, metres. A course that would touch by less counts in proportion,
/// so that a course just beside the other box differs little from one that just touches it.
const FULL_OVERLAP: f64 = 0.5;

/// Criticality measures of one candidate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Criticality {
    /// Least time to collision before contact, seconds: the time until the boxes would touch if both kept
    /// velocity and heading. `None` if they are never on a collision course.
    pub time_to_collision: Option<f64>,
    /// Post-encroachment time: least time between one leaving an area and the other entering it, seconds. 0
    /// if they collide, `None` if their swept areas do not overlap.
    pub post_encroachment_time: Option<f64>,
    /// Greatest constant deceleration of the relative motion that avoids contact, m/s², at most [`FULL_BRAKING`], over
    /// the steps on a collision course up to first contact: `Δv / (2 (TTC + 0.1 s))`, less for courses that barely touch;
    /// `None` without one.
    pub required_deceleration: Option<f64>,
    /// Relative speed at first contact, m/s.
    pub impact_speed: Option<f64>,
    /// Side of the ego that is hit first.
    pub side_hit: Option<SideHit>,
}

/// Sides of the ego.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SideHit {
    /// Its front.
    Front,
    /// Its rear.
    Rear,
    /// Its left side.
    Left,
    /// Its right side.
    Right,
}

impl SideHit {
    /// All sides.
    pub const ALL: [Self; 4] = [Self::Front, Self::Rear, Self::Left, Self::Right];

    /// The side of `ego` on which `other` overlaps it: where the centre of the overlap lies, relative to
    /// half length and half width.
    pub fn of(ego: &OrientedBox, other: &OrientedBox) -> Self {
        side_hit(ego, other)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Rear => "rear",
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

impl Criticality {
    /// All measures of a candidate against an ego path.
    pub fn of(situation: &Situation) -> Self {
        let Situation { candidate, ego: path, encounter, .. } = situation;
        let (time_to_collision, required_deceleration) = approach(situation);
        let at_contact = |step: usize| {
            let ego = path.box_at(step)?;
            let speed = path.velocity(step).map(|v| norm(sub(candidate.velocity(step), v)));
            Some((speed, side_hit(ego, &candidate.boxes()[step - 1])))
        };
        let contact = encounter.contact.and_then(at_contact);
        Self {
            time_to_collision,
            post_encroachment_time: post_encroachment_time(candidate, path),
            required_deceleration,
            impact_speed: contact.and_then(|(speed, _)| speed),
            side_hit: contact.map(|(_, side)| side),
        }
    }
}

/// Least time to collision before contact, and greatest required deceleration up to contact.
fn approach(Situation { candidate, ego: path, encounter, .. }: &Situation) -> (Option<f64>, Option<f64>) {
    let last = encounter.contact.unwrap_or(candidate.horizon());
    let mut least: Option<f64> = None;
    let mut hardest: Option<f64> = None;
    for step in 1..=last {
        let (Some(ego), Some(ego_velocity)) = (path.box_at(step), path.velocity(step)) else { continue };
        if !path.is_on_level_of(candidate, step) {
            continue;
        }
        let (other, relative) = (&candidate.boxes()[step - 1], sub(candidate.velocity(step), ego_velocity));
        let needed = if encounter.contact == Some(step) {
            deceleration_within(0.0, norm(relative))
        } else if let Some(time) = time_to_touch(ego, other, relative) {
            least = Some(least.map_or(time, |t| t.min(time)));
            required_deceleration(ego, other, relative, time)
        } else {
            continue;
        };
        hardest = Some(hardest.map_or(needed, |d| d.max(needed)));
    }
    (least, hardest)
}

/// Constant deceleration of the relative motion that avoids contact, m/s², for boxes that would touch after `time`:
///
/// `min(Δv / (2 (TTC + 0.1 s)), 9.81) · min(w / 0.5 m, 1)`
///
/// with the relative speed Δv and the overlap w of the course across its direction. The frame of 0.1 s is the time within
/// which a recording at 10 Hz locates a contact: without it, a last frame that happens to lie just before contact
/// would have any value. At contact TTC is 0 and w is not used, so `Δv / 0.2 s`, or 9.81 from 2 m/s on.
///
/// A steady approach that ends in contact therefore has the value of the contact. It changes little if the contact moves
/// by a fraction of a frame, or becomes a stop just short of it.
fn required_deceleration(ego: &OrientedBox, other: &OrientedBox, velocity: Point, time: f64) -> f64 {
    let speed = norm(velocity);
    if speed == 0.0 {
        return 0.0;
    }
    let across = [-velocity[1] / speed, velocity[0] / speed];
    let overlap =
        reach(ego, across) + reach(other, across) - dot(sub(other.center, ego.center), across).abs();
    deceleration_within(time, speed) * (overlap / FULL_OVERLAP).clamp(0.0, 1.0)
}

fn deceleration_within(time: f64, speed: f64) -> f64 {
    (speed / (2.0 * (time + DT))).min(FULL_BRAKING)
}

/// Half of the extent of a box along a unit vector.
fn reach(b: &OrientedBox, along: Point) -> f64 {
    b.half_length * dot(b.axis, along).abs() + b.half_width * cross(b.axis, along).abs()
}

/// Time until `other`, moving with `velocity` relative to `ego`, touches it; `None` if it never does.
///
/// Separating axes with time: on each axis the boxes overlap during one interval. They touch when all
/// intervals overlap.
pub fn time_to_touch(ego: &OrientedBox, other: &OrientedBox, velocity: Point) -> Option<f64> {
    let offset = sub(other.center, ego.center);
    let c = dot(ego.axis, other.axis).abs();
    let s = cross(ego.axis, other.axis).abs();
    let (mut enter, mut exit) = (0.0f64, f64::INFINITY);
    for (first, second) in [(ego, other), (other, ego)] {
        let along = first.half_length + second.half_length * c + second.half_width * s;
        let across = first.half_width + second.half_length * s + second.half_width * c;
        let axes = [(first.axis, along), ([-first.axis[1], first.axis[0]], across)];
        for (axis, reach) in axes {
            let (position, speed) = (dot(offset, axis), dot(velocity, axis));
            if speed == 0.0 {
                if position.abs() > reach {
                    return None;
                }
                continue;
            }
            let times = [(-reach - position) / speed, (reach - position) / speed];
            enter = enter.max(times[0].min(times[1]));
            exit = exit.min(times[0].max(times[1]));
        }
    }
    (enter <= exit).then_some(enter)
}

/// Least time between the two occupying the same area, seconds.
fn post_encroachment_time(candidate: &Candidate, path: &EgoPath) -> Option<f64> {
    let mut least: Option<usize> = None;
    for (s, ego) in path.boxes().iter().enumerate().take(candidate.horizon()) {
        let Some(ego) = ego else { continue };
        let reach = least.map_or(candidate.horizon(), |gap| gap.saturating_sub(1));
        let steps = s.saturating_sub(reach)..(s + reach + 1).min(candidate.horizon());
        let gaps = steps.filter(|&t| candidate.boxes()[t].intersects(ego)).map(|t| s.abs_diff(t));
        if let Some(gap) = gaps.min() {
            least = Some(least.map_or(gap, |l| l.min(gap)));
        }
    }
    least.map(|gap| gap as f64 * DT)
}

/// The side of `ego` on which `other` overlaps it, from the centroid of the overlap relative to half length
/// and half width.
fn side_hit(ego: &OrientedBox, other: &OrientedBox) -> SideHit {
    let (l, w) = (ego.half_length, ego.half_width);
    let mut overlap: Vec<Point> = other.corners().into_iter().map(|c| ego.box_from_world(c)).collect();
    // Sutherland-Hodgman clipping by the four sides of the ego.
    for (axis, limit, sign) in [(0, l, 1.0), (0, l, -1.0), (1, w, 1.0), (1, w, -1.0)] {
        let inside = |p: Point| sign * p[axis] <= limit;
        let mut clipped = Vec::with_capacity(overlap.len() + 1);
        for (k, &p) in overlap.iter().enumerate() {
            let q = overlap[(k + 1) % overlap.len()];
            if inside(p) {
                clipped.push(p);
            }
            if inside(p) != inside(q) {
                let share = (sign * limit - p[axis]) / (q[axis] - p[axis]);
                clipped.push([p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1])]);
            }
        }
        overlap = clipped;
    }
    // Rounding can remove a mere touch, and the overlap of a fully covered ego has its centroid at the
    // ego's centre. In both cases the other box's centre gives the direction.
    let middle =
        centroid(&overlap).filter(|m| norm(*m) > 1e-6).unwrap_or_else(|| ego.box_from_world(other.center));
    let (x, y) = (middle[0] / l, middle[1] / w);
    match (x.abs() >= y.abs(), x >= 0.0, y >= 0.0) {
        (true, true, _) => SideHit::Front,
        (true, false, _) => SideHit::Rear,
        (false, _, true) => SideHit::Left,
        (false, _, false) => SideHit::Right,
    }
}

/// Centroid of a polygon; mean of its corners if it has no area; `None` if it has no corner.
fn centroid(polygon: &[Point]) -> Option<Point> {
    let first = *polygon.first()?;
    let (mut area, mut moment) = (0.0, [0.0, 0.0]);
    for pair in polygon.windows(2) {
        let (a, b) = (sub(pair[0], first), sub(pair[1], first));
        let part = cross(a, b);
        area += part;
        moment = [moment[0] + part * (a[0] + b[0]) / 3.0, moment[1] + part * (a[1] + b[1]) / 3.0];
    }
    if area.abs() > 1e-9 {
        return Some([first[0] + moment[0] / area, first[1] + moment[1] / area]);
    }
    let sum = polygon.iter().fold([0.0, 0.0], |sum, p| [sum[0] + p[0], sum[1] + p[1]]);
    Some([sum[0] / polygon.len() as f64, sum[1] / polygon.len() as f64])
}

/// Relative speed at first contact as a reward; 0 without contact.
pub struct ImpactSpeed;

impl Entry<dyn Reward> for ImpactSpeed {
    const NAME: &'static str = "impact-speed";
    const SUMMARY: &'static str = "relative speed at first contact, m/s; 0 without contact";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self))
    }
}

impl Reward for ImpactSpeed {
    fn score(&self, situation: &Situation) -> Option<f64> {
        Some(Criticality::of(situation).impact_speed.unwrap_or(0.0))
    }
}

/// Required deceleration as a reward; 0 without a collision course.
pub struct RequiredDeceleration;

impl Entry<dyn Reward> for RequiredDeceleration {
    const NAME: &'static str = "required-deceleration";
    const SUMMARY: &'static str =
        "greatest deceleration required to avoid contact, m/s², at most 9.81; 0 without a collision course";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self))
    }
}

impl Reward for RequiredDeceleration {
    fn score(&self, situation: &Situation) -> Option<f64> {
        Some(approach(situation).1.unwrap_or(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Rng;

    #[test]
    fn time_to_touch_is_the_gap_over_the_closing_speed() {
        let ego = OrientedBox::new([0.0, 0.0], 0.0, 4.0, 2.0);
        let ahead = OrientedBox::new([24.0, 0.0], 0.0, 4.0, 2.0);
        assert_eq!(time_to_touch(&ego, &ahead, [-5.0, 0.0]), Some(4.0));
        assert_eq!(time_to_touch(&ego, &ahead, [5.0, 0.0]), None);
        assert_eq!(time_to_touch(&ego, &OrientedBox::new([24.0, 3.0], 0.0, 4.0, 2.0), [-5.0, 0.0]), None);
        assert_eq!(time_to_touch(&ego, &ahead, [0.0, 0.0]), None);
    }

    #[test]
    fn time_to_touch_agrees_with_stepping() {
        let mut rng = Rng::new(5, "criticality", "walk");
        for _ in 0..500 {
            let ego = OrientedBox::new([0.0, 0.0], rng.uniform(-3.0, 3.0), 4.5, 2.0);
            let center = [rng.uniform(-20.0, 20.0), rng.uniform(-20.0, 20.0)];
            let other = OrientedBox::new(center, rng.uniform(-3.0, 3.0), 5.0, 2.2);
            let velocity = [rng.uniform(-9.0, 9.0), rng.uniform(-9.0, 9.0)];
            let stepped = (0..10_000).map(|k| k as f64 * 1e-3).find(|t| {
                let moved = [center[0] + t * velocity[0], center[1] + t * velocity[1]];
                ego.intersects(&OrientedBox { center: moved, ..other })
            });
            match (time_to_touch(&ego, &other, velocity), stepped) {
                (Some(time), Some(stepped)) => {
                    assert!(time <= stepped + 1e-9 && stepped - time < 0.05, "{time} {stepped}")
                }
                (Some(time), None) => assert!(time > 9.9 || time.is_finite()),
                (None, found) => assert_eq!(found, None),
            }
        }
    }

    #[test]
    fn the_side_hit_is_that_of_the_overlaps_centroid() {
        let ego = OrientedBox::new([10.0, 5.0], 0.7, 4.0, 2.0);
        let at = |x: f64, y: f64| {
            let (s, c) = 0.7f64.sin_cos();
            OrientedBox::new([10.0 + x * c - y * s, 5.0 + x * s + y * c], 0.7, 4.0, 2.0)
        };
        assert_eq!(side_hit(&ego, &at(3.5, 0.2)), SideHit::Front);
        assert_eq!(side_hit(&ego, &at(-3.5, -0.2)), SideHit::Rear);
        assert_eq!(side_hit(&ego, &at(0.3, 1.8)), SideHit::Left);
        assert_eq!(side_hit(&ego, &at(-0.3, -1.8)), SideHit::Right);
    }
}
