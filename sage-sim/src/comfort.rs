//! Comfort of a drive by the bounds of nuPlan's scorer.
//!
//! Logged poses are noisy, and filters extrapolate at both ends: many recordings fail too, so a share of comfortable
//! drives means something only beside that of the recordings.

use std::sync::LazyLock;

use sage_core::motion::DT;

use crate::{smoothing::Filter, vehicle::Motion};

/// Range of the longitudinal acceleration, m/s².
pub(crate) const ACCELERATION: [f64; 2] = [-4.05, 2.40];
/// Largest lateral acceleration, m/s².
const LATERAL: f64 = 4.89;
/// Largest longitudinal jerk, and largest jerk of the acceleration's magnitude, m/s³.
pub(crate) const JERK: f64 = 4.13;
pub(crate) const JERK_OF_MAGNITUDE: f64 = 8.37;
/// Largest yaw rate, rad/s, and yaw acceleration, rad/s².
const YAW_RATE: f64 = 0.95;
const YAW_ACCELERATION: f64 = 1.93;

static ACCELERATION_FILTER: LazyLock<Filter> = LazyLock::new(|| Filter::new(8, 2, 0));
static JERK_FILTER: LazyLock<Filter> = LazyLock::new(|| Filter::new(15, 2, 1));
static YAW_RATE_FILTER: LazyLock<Filter> = LazyLock::new(|| Filter::new(5, 2, 1));
static YAW_ACCELERATION_FILTER: LazyLock<Filter> = LazyLock::new(|| Filter::new(5, 3, 2));

/// Whether a drive, motion by motion every 0.1 s, keeps all bounds; `None` if it is shorter than 1.5 s.
///
/// Bounds: longitudinal acceleration −4.05 to 2.40 m/s², lateral 4.89 m/s², longitudinal jerk 4.13 m/s³, jerk of the
/// magnitude 8.37 m/s³, yaw rate 0.95 rad/s, yaw acceleration 1.93 rad/s².
///
/// ```
/// use sage_sim::{comfort::is_comfortable, vehicle::Motion};
///
/// // 3 s at 10 m/s, and then braking at a deceleration, m/s².
/// let drive = |deceleration: f64| -> Vec<Motion> {
///     let speed = |step: i32| 10.0 - deceleration * 0.1 * f64::from((step - 10).max(0));
///     let at = |step| Motion { velocity: [speed(step), 0.0], ..Motion::default() };
///     (0..=30).map(at).collect()
/// };
/// assert_eq!((is_comfortable(&drive(0.0)), is_comfortable(&drive(5.0))), (Some(true), Some(false)));
/// // Too short to tell.
/// assert_eq!(is_comfortable(&drive(0.0)[..10]), None);
/// ```
pub fn is_comfortable(motions: &[Motion]) -> Option<bool> {
    let last = motions.len().checked_sub(1).filter(|last| *last >= 14)?;
    let (mut along, mut across) = (Vec::with_capacity(last + 1), Vec::with_capacity(last + 1));
    for k in 0..=last {
        let (before, after) = (k.saturating_sub(1), (k + 1).min(last));
        let time = DT * (after - before) as f64;
        let [ax, ay] = [0, 1].map(|i| (motions[after].velocity[i] - motions[before].velocity[i]) / time);
        let (sin, cos) = motions[k].heading.sin_cos();
        along.push(ax * cos + ay * sin);
        across.push(ay * cos - ax * sin);
    }
    let [along, across] = [along, across].map(|series| ACCELERATION_FILTER.apply(&series));
    let magnitude: Vec<f64> = along.iter().zip(&across).map(|(a, b)| a.hypot(*b)).collect();
    let within = |series: &[f64], most: f64| series.iter().all(|x| x.abs() <= most);
    let jerk = |series: &[f64], most: f64| within(&JERK_FILTER.apply(series), most * DT);
    let headings: Vec<f64> = motions.iter().map(|motion| motion.heading).collect();
    Some(
        along.iter().all(|a| (ACCELERATION[0]..=ACCELERATION[1]).contains(a))
            && within(&across, LATERAL)
            && jerk(&along, JERK)
            && jerk(&magnitude, JERK_OF_MAGNITUDE)
            && turns_gently(&headings),
    )
}

/// Whether headings (rad) every 0.1 s keep the bounds of yaw rate and yaw acceleration.
pub(crate) fn turns_gently(headings: &[f64]) -> bool {
    // Steps over ±π are no turns.
    let mut turned = 0.0;
    let mut unwrapped = vec![0.0; headings.len()];
    for k in 1..headings.len() {
        turned += sage_core::geometry::wrap_angle(headings[k] - headings[k - 1]);
        unwrapped[k] = turned;
    }
    let within = |filter: &Filter, most: f64| filter.apply(&unwrapped).iter().all(|x| x.abs() <= most);
    within(&YAW_RATE_FILTER, YAW_RATE * DT) && within(&YAW_ACCELERATION_FILTER, YAW_ACCELERATION * DT * DT)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four seconds with an acceleration and a yaw rate at each time.
    fn motions(of: impl Fn(f64) -> (f64, f64)) -> Vec<Motion> {
        let (mut speed, mut heading) = (20.0, 3.0);
        let motion = |k: usize| {
            let (acceleration, yaw_rate) = of(DT * k as f64);
            speed += DT * acceleration;
            heading += DT * yaw_rate;
            let wrapped = sage_core::geometry::wrap_angle(heading);
            let velocity = [speed * wrapped.cos(), speed * wrapped.sin()];
            Motion { position: [0.0; 2], heading: wrapped, velocity, yaw_rate }
        };
        (0..=40).map(motion).collect()
    }

    fn holds(of: impl Fn(f64) -> (f64, f64)) -> bool {
        is_comfortable(&motions(of)).unwrap_or_default()
    }

    #[test]
    fn each_bound_is_nuplans() {
        assert!(holds(|_| (-4.0, 0.0)) && !holds(|_| (-4.1, 0.0)));
        assert!(holds(|_| (2.35, 0.0)) && !holds(|_| (2.45, 0.0)));
        // 20 m/s at 0.24 rad/s are 4.8 m/s² across.
        assert!(holds(|_| (0.0, 0.24)) && !holds(|_| (0.0, 0.25)));
        assert!(!holds(|t| (if t < 2.0 { 0.0 } else { -4.0 }, 0.0)));
        assert!(holds(|t| ((-2.0 * t).max(-4.0), 0.0)));
        assert!(holds(|t| (-4.0, if t < 2.0 { 0.0 } else { 0.1 })));
        assert!(!holds(|t| (0.0, if t < 2.0 { -0.23 } else { 0.23 })));
        assert!(is_comfortable(&motions(|_| (0.0, 0.0))[..14]).is_none());
    }
}
