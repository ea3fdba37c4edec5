//! Smooth surrogate of the adversarial reward.
//!
//! The boxes' signed gap `s_t` (greatest separation along their four axes, negative in contact) gives a soft contact
//! `q_t = σ(−s_t / τ)` and a soft "no contact before" `S_t = Π_{k<t} (1 − q_k)`. The value is
//! `Σ_t 10 (1 − t/T) q_t S_t + S_T exp(−0.2 d) − γ max(0, s)` with soft minima `d` of the centres' distance and `s` of the gap.
//! The last term pulls from afar and vanishes at contact. As τ → 0 with γ = 0 the value tends to the published
//! reward, but for its cut at 20 m and a soft minimum of the distance.

use super::{Context, DifferentiableReward, PoseGradient};
use crate::{
    geometry::{OrientedBox, Point, cross, dot, norm, sub},
    motion::{HORIZON, Pose},
};

/// Reward of an immediate contact, and decay of closeness with distance, 1/m.
const CONTACT: f64 = 10.0;
const DECAY: f64 = 0.2;
/// Softness of the minima of distance and gap, metres.
const DISTANCE_SOFTNESS: f64 = 0.5;
const GAP_SOFTNESS: f64 = 1.0;

/// Smooth adversarial reward.
#[derive(Clone, Copy, Debug)]
pub struct SmoothAdversarial {
    /// τ, the gap over which a contact sets in, metres, > 0. A smaller value orders trajectories more exactly, a larger one
    /// gives gradients farther away.
    pub softness: f64,
    /// γ, reward for each metre by which the gap shrinks, 1/m.
    pub pull: f64,
}

impl Default for SmoothAdversarial {
    fn default() -> Self {
        Self { softness: 0.5, pull: 0.05 }
    }
}

/// Signed gap of the boxes at a step, and the distance of their centres, with gradients.
#[derive(Clone, Copy)]
struct Gap {
    gap: f64,
    by_position: Point,
    by_heading: f64,
    distance: f64,
    distance_by_position: Point,
}

impl DifferentiableReward for SmoothAdversarial {
    fn name(&self) -> &str {
        "adversarial"
    }

    fn value(&self, poses: &[Pose], ctx: &Context, gradient: &mut PoseGradient) -> f64 {
        let (ego, [length, width]) = (ctx.ego(), ctx.size());
        let gaps: Vec<Option<Gap>> = poses
            .iter()
            .enumerate()
            .map(|(k, pose)| Some(Gap::of(pose, [0.5 * length, 0.5 * width], ego.box_at(k + 1)?)))
            .collect();
        let worth = |k: usize| CONTACT * (1.0 - k as f64 / HORIZON as f64);
        // Soft contact, and "no contact before" each step.
        let mut free = 1.0;
        let mut soft: Vec<[f64; 2]> = Vec::with_capacity(gaps.len());
        let mut value = 0.0;
        for (k, gap) in gaps.iter().enumerate() {
            let touch = gap.map_or(0.0, |gap| 1.0 / (1.0 + (gap.gap / self.softness).exp()));
            soft.push([touch, free]);
            value += worth(k) * touch * free;
            free *= 1.0 - touch;
        }
        let known = || gaps.iter().enumerate().filter_map(|(k, gap)| gap.map(|gap| (k, gap)));
        let (near, near_shares) = soft_minimum(known().map(|(_, gap)| gap.distance), DISTANCE_SOFTNESS);
        let (close, close_shares) = soft_minimum(known().map(|(_, gap)| gap.gap), GAP_SOFTNESS);
        let closeness = free * (-DECAY * near).exp();
        value += closeness - self.pull * close.max(0.0);
        // Everything that the steps after `k` add.
        let mut later = closeness;
        for (n, (k, gap)) in known().enumerate().collect::<Vec<_>>().into_iter().rev() {
            let [touch, before] = soft[k];
            let by_touch = worth(k) * before * (1.0 - touch) - later;
            let mut by_gap = -by_touch * touch / self.softness;
            later += worth(k) * touch * before;
            if close > 0.0 {
                by_gap -= self.pull * close_shares[n];
            }
            let by_distance = -DECAY * closeness * near_shares[n];
            for axis in 0..2 {
                gradient.position[k][axis] +=
                    by_gap * gap.by_position[axis] + by_distance * gap.distance_by_position[axis];
            }
            gradient.heading[k] += by_gap * gap.by_heading;
        }
        value
    }
}

/// `Σ p_k x_k` with `p = softmax(−x / softness)`, and its gradient.
fn soft_minimum(values: impl Iterator<Item = f64> + Clone, softness: f64) -> (f64, Vec<f64>) {
    let least = values.clone().fold(f64::INFINITY, f64::min);
    let weights: Vec<f64> = values.clone().map(|x| ((least - x) / softness).exp()).collect();
    let sum: f64 = weights.iter().sum();
    if sum == 0.0 {
        return (0.0, weights);
    }
    let mean = weights.iter().zip(values.clone()).map(|(w, x)| w * x).sum::<f64>() / sum;
    let shares = weights.iter().zip(values).map(|(w, x)| w / sum * (1.0 - (x - mean) / softness));
    (mean, shares.collect())
}

impl Gap {
    fn of(pose: &Pose, [half_length, half_width]: [f64; 2], ego: &OrientedBox) -> Self {
        let (sin, cos) = pose.heading.sin_cos();
        let (along, across): (Point, Point) = ([cos, sin], [-sin, cos]);
        let (ahead, aside) = (ego.axis, [-ego.axis[1], ego.axis[0]]);
        let d = sub(ego.center, pose.position);
        let [half_ahead, half_aside] = [ego.half_length, ego.half_width];
        let c = dot(along, ahead);
        let s = cross(ahead, along);
        let extent = |a: f64, b: f64| a * c.abs() + b * s.abs();
        // Derivatives of |c| and |s| with respect to the heading.
        let (dc, ds) = (-s * c.signum(), c * s.signum());
        let turned = |a: f64, b: f64| a * dc + b * ds;
        let side = |n: Point| dot(d, n).signum();
        // Separation along each axis: gap, its gradient by position, and by heading.
        let own = |n: Point, half: f64, theirs: [f64; 2], by_axis: f64| {
            let [a, b] = theirs;
            let sign = side(n);
            (
                dot(d, n).abs() - half - extent(a, b),
                [-sign * n[0], -sign * n[1]],
                sign * by_axis - turned(a, b),
            )
        };
        let theirs = |n: Point, half: f64, [a, b]: [f64; 2]| {
            let sign = side(n);
            (dot(d, n).abs() - half - extent(a, b), [-sign * n[0], -sign * n[1]], -turned(a, b))
        };
        let axes = [
            own(along, half_length, [half_ahead, half_aside], dot(d, across)),
            own(across, half_width, [half_aside, half_ahead], -dot(d, along)),
            theirs(ahead, half_ahead, [half_length, half_width]),
            theirs(aside, half_aside, [half_width, half_length]),
        ];
        let first = axes[0];
        let (gap, by_position, by_heading) =
            axes[1..].iter().fold(first, |best, axis| if axis.0 > best.0 { *axis } else { best });
        let distance = norm(d);
        let distance_by_position = if distance > 0.0 { d.map(|x| -x / distance) } else { [0.0; 2] };
        Self { gap, by_position, by_heading, distance, distance_by_position }
    }
}
