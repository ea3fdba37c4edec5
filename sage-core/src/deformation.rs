//! A plan deformed by six numbers, and a (1+1) evolution strategy over them.
//!
//! The plan p(t) is read between its steps by Catmull and Rom's spline, p(0) *now*, and straight on behind its end. With
//! s = k/80, r(s) = s² (3 − 2s) and b(s) = sin²(πs), step k of the deformed plan is
//!
//! `p(k + 10 (z₅ b + z₆ r)) + r (z₁ n_e + z₂ u_e) + b (z₃ n_m + z₄ u_m)`,
//!
//! where u_e and u_m are the directions of the plan at its end and at half time, and n is to the left of u. All shifts and
//! their first derivatives are 0 *now*, so a deformed plan goes on from the recording as the plan does. Time never runs
//! backwards.

use std::f64::consts::PI;

use crate::{
    Error,
    geometry::{Point, norm, sub},
    motion::{HORIZON, Pose, Trajectory},
    seed::Rng,
};

/// Scales of the numbers: goal across and along, middle across and along (metres), ahead in the middle and at the end (seconds).
const SCALES: [f64; 6] = [5.0, 7.5, 1.75, 3.75, 1.0, 1.25];
/// Steps a second.
const STEPS: f64 = 10.0;
/// Least way over which a direction is measured, metres.
const LEAST_WAY: f64 = 0.5;
/// Steps of the shortest time over which it is measured.
const STRIDE: usize = 10;

/// A plan that can be deformed.
///
/// ```
/// use sage_core::{
///     deformation::Deformable,
///     motion::{Pose, Trajectory},
/// };
///
/// let straight = Trajectory::new("plan", (1..=80).map(|step| [f64::from(step), 0.0]).collect())?;
/// let plan = Deformable::new(&straight, &Pose::new(0.0, 0.0, 0.0));
/// assert_eq!(plan.deformed(&[0.0; 6])?, straight);
/// // The goal 3 m to the left: half of it at half time, and none now.
/// let left = plan.deformed(&[3.0, 0.0, 0.0, 0.0, 0.0, 0.0])?;
/// assert_eq!([left.points()[39], left.points()[79]], [[40.0, 1.5], [80.0, 3.0]]);
/// // Half a second ahead at the end.
/// assert_eq!(plan.deformed(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.5])?.points()[79], [85.0, 0.0]);
/// # Ok::<(), sage_core::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Deformable {
    /// The point before *now* on the straight way to the first step, *now*, the 80 steps, and one behind them.
    points: [Point; HORIZON + 3],
    /// Directions at the end and at half time.
    axes: [Point; 2],
}

impl Deformable {
    /// A plan, and the pose from which it starts.
    pub fn new(plan: &Trajectory, start: &Pose) -> Self {
        let mut points = [start.position; HORIZON + 3];
        points[2..HORIZON + 2].copy_from_slice(plan.points());
        points[0] = ahead(points[2], points[1], 1.0);
        points[HORIZON + 2] = ahead(points[HORIZON], points[HORIZON + 1], 1.0);
        let (sin, cos) = start.heading.sin_cos();
        let axis = |step: usize| {
            let around = |reach: usize| {
                let way =
                    sub(points[1 + (step + reach).min(HORIZON)], points[1 + step.saturating_sub(reach)]);
                let length = norm(way);
                (length > LEAST_WAY).then(|| way.map(|x| x / length))
            };
            (STRIDE..=HORIZON).step_by(STRIDE).find_map(around).unwrap_or([cos, sin])
        };
        let axes = [HORIZON, HORIZON / 2].map(axis);
        Self { points, axes }
    }

    /// The plan deformed by six numbers: the goal to the left and ahead, the middle to the left and ahead (metres), and how much
    /// earlier it is driven at half time and at the end (seconds).
    ///
    /// *Errors*: a step that no trajectory may have.
    pub fn deformed(&self, z: &[f64; 6]) -> Result<Trajectory, Error> {
        let [end, middle] = self.axes;
        let mut time: f64 = 0.0;
        let point = |k: usize| {
            let s = k as f64 / HORIZON as f64;
            let (r, b) = (s * s * (3.0 - 2.0 * s), (PI * s).sin().powi(2));
            time = time.max(k as f64 + STEPS * (b * z[4] + r * z[5]));
            let [x, y] = self.at(time);
            [
                x + r * (z[1] * end[0] - z[0] * end[1]) + b * (z[3] * middle[0] - z[2] * middle[1]),
                y + r * (z[1] * end[1] + z[0] * end[0]) + b * (z[3] * middle[1] + z[2] * middle[0]),
            ]
        };
        Trajectory::new("deformed plan", (1..=HORIZON).map(point).collect())
    }

    /// The plan at a time, steps from *now* on.
    fn at(&self, time: f64) -> Point {
        if time >= HORIZON as f64 {
            return ahead(self.points[HORIZON], self.points[HORIZON + 1], time - HORIZON as f64);
        }
        let k = time as usize;
        let u = time - k as f64;
        [0, 1].map(|axis| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|before| self.points[k + before][axis]);
            b + 0.5 * u * (c - a + u * (2.0 * a - 5.0 * b + 4.0 * c - d + u * (3.0 * (b - c) + d - a)))
        })
    }
}

/// The point behind `b` on the way from `a`, at some multiple of that way.
fn ahead(a: Point, b: Point, multiple: f64) -> Point {
    [b[0] + multiple * (b[0] - a[0]), b[1] + multiple * (b[1] - a[1])]
}

/// Gain of a value from which a try is better: less is rounding, which is another where a scene is turned or lies elsewhere.
pub const LEAST_GAIN: f64 = 1e-6;

/// Chance of a number to be changed in a try.
const CHANGED: f64 = 0.6;
/// Size of the first change, in scales, and the factors after a success and a failure.
const FIRST: f64 = 0.5;
const GROWTH: f64 = 1.5;
const DECAY: f64 = 0.92;
/// Least and largest size.
const SIZES: [f64; 2] = [0.03, 2.0];

/// A (1+1) evolution strategy over the deformations of a plan: a try changes some of the numbers at random, and is kept if it is
/// better.
///
/// ```
/// # use sage_core::{deformation::{Deformable, Evolution}, motion::{Pose, Trajectory}, seed::Rng};
/// let straight = Trajectory::new("plan", (1..=80).map(|step| [f64::from(step), 0.0]).collect())?;
/// let mut evolution = Evolution::new(Deformable::new(&straight, &Pose::new(0.0, 0.0, 0.0)));
/// // What ends near (70, 5) is better.
/// let miss = |plan: &Trajectory| (plan.points()[79][0] - 70.0).hypot(plan.points()[79][1] - 5.0);
/// let mut least = miss(&straight);
/// evolution.run(100, &mut Rng::new(0, "scene", "example"), |plan| {
///     let is_better = miss(&plan) < least;
///     least = least.min(miss(&plan));
///     is_better
/// });
/// assert!(least < 0.5);
/// # Ok::<(), sage_core::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Evolution {
    plan: Deformable,
    z: [f64; 6],
    size: f64,
}

impl Evolution {
    /// Begins with the plan as it is.
    pub fn new(plan: Deformable) -> Self {
        Self { plan, z: [0.0; 6], size: FIRST }
    }

    /// Some tries. `is_better` says of a plan whether it is better than the last one of which it said so, or than the first.
    pub fn run(&mut self, tries: usize, rng: &mut Rng, mut is_better: impl FnMut(Trajectory) -> bool) {
        for _ in 0..tries {
            let mut z = self.z;
            for (z, scale) in z.iter_mut().zip(SCALES) {
                if rng.unit() < CHANGED {
                    *z += self.size * scale * rng.normal();
                }
            }
            let is_kept = self.plan.deformed(&z).is_ok_and(&mut is_better);
            if is_kept {
                self.z = z;
            }
            let factor = if is_kept { GROWTH } else { DECAY };
            self.size = (self.size * factor).clamp(SIZES[0], SIZES[1]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve() -> (Trajectory, Pose) {
        let at = |step: usize| {
            let angle = 0.02 * step as f64;
            [20.0 * angle.sin(), 20.0 * (1.0 - angle.cos())]
        };
        (Trajectory::new("curve", (1..=HORIZON).map(at).collect()).unwrap(), Pose::new(0.0, 0.0, 0.0))
    }

    #[test]
    fn every_number_moves_what_its_name_says_and_nothing_moves_now() {
        let (curve, start) = curve();
        let plan = Deformable::new(&curve, &start);
        let moved = |number: usize, size: f64| {
            let mut z = [0.0; 6];
            z[number] = size;
            let deformed = plan.deformed(&z).unwrap();
            deformed.points().iter().zip(curve.points()).map(|(a, b)| norm(sub(*a, *b))).collect::<Vec<_>>()
        };
        for (number, at) in [(0, 79), (1, 79), (2, 39), (3, 39), (4, 39), (5, 79)] {
            let all = moved(number, 1.0);
            let most = (0..HORIZON).max_by(|a, b| all[*a].total_cmp(&all[*b])).unwrap();
            // The chord of an arc is shorter than the arc, and time shifts follow the curve.
            let metres = if number < 4 { 1.0 } else { 20.0 * 2.0 * (0.5_f64 * 0.2).sin() };
            assert!((all[at] - metres).abs() < 0.1, "{number}: {}", all[at]);
            assert!(most.abs_diff(at) <= 2, "{number}: the largest move is at {most}");
            assert!(all[0] < 2e-3 * metres.max(1.0), "{number}: {} in the first step", all[0]);
        }
    }

    #[test]
    fn time_never_runs_backwards_and_standing_plans_have_a_direction() {
        let (curve, start) = curve();
        let late = Deformable::new(&curve, &start).deformed(&[0.0, 0.0, 0.0, 0.0, -9.0, 0.0]).unwrap();
        let angle = |p: &Point| p[0].atan2(20.0 - p[1]);
        let angles: Vec<f64> = late.points().iter().map(angle).collect();
        assert!(angles.windows(2).all(|two| two[1] >= two[0] - 1e-9));
        let standing = Trajectory::new("standing", vec![[3.0, 4.0]; HORIZON]).unwrap();
        let plan = Deformable::new(&standing, &Pose::new(3.0, 4.0, PI / 2.0));
        let goal = plan.deformed(&[0.0, 2.0, 0.0, 0.0, 0.0, 0.0]).unwrap().points()[79];
        assert!(norm(sub(goal, [3.0, 6.0])) < 1e-9);
    }

    #[test]
    fn the_spline_goes_through_the_plan_and_equals_a_line_where_it_is_one() {
        let (curve, start) = curve();
        let plan = Deformable::new(&curve, &start);
        assert_eq!(plan.deformed(&[0.0; 6]).unwrap(), curve);
        let between = plan.at(20.5);
        let [x, y] = between;
        assert!((x.hypot(y - 20.0) - 20.0).abs() < 1e-5, "{between:?}");
    }
}
