//! Clearance of eight trajectories at a time to an agent's forecast. Each operation works on eight numbers,
//! as many as one vector register holds.

use crate::features::{FORECAST_STEPS, ForecastMode};

/// Trajectories in a batch.
pub(super) const LANES: usize = 8;
/// One number per trajectory of a batch.
pub(super) type Lanes = [f32; LANES];

/// Upper limit of a gap, metres.
pub(super) const FAR: f32 = 10.0;
/// Step of the first contact if boxes never overlap.
pub(super) const NEVER: f32 = FORECAST_STEPS as f32;
/// Displacements up to this size do not change the heading, metres squared (5 cm).
const STEP_SQUARED: f32 = 0.0025;

/// One number for each trajectory, by a function of its index.
#[inline(always)]
pub(super) fn lanes(of: impl FnMut(usize) -> f32) -> Lanes {
    std::array::from_fn(of)
}

// Both functions return `a` if `b` is NaN, as the machine instruction does.
#[inline(always)]
pub(super) fn less(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

#[inline(always)]
pub(super) fn greater(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// An agent's boxes at the forecast steps.
pub(super) struct Boxes {
    pub(super) weight: f32,
    pub(super) stands: bool,
    half: [f32; 2],
    /// Distance of a corner from the centre.
    reach: f32,
    pub(super) x: [f32; FORECAST_STEPS],
    pub(super) y: [f32; FORECAST_STEPS],
    cos: [f32; FORECAST_STEPS],
    sin: [f32; FORECAST_STEPS],
    /// Least and greatest x and y.
    bounds: [f32; 4],
}

impl Boxes {
    pub(super) fn of(mode: &ForecastMode) -> Self {
        let row = |k: usize| std::array::from_fn(|step| mode.poses[step][k]);
        let (x, y): ([f32; FORECAST_STEPS], [f32; FORECAST_STEPS]) = (row(0), row(1));
        let least = |values: &[f32]| values.iter().copied().fold(f32::INFINITY, less);
        let most = |values: &[f32]| values.iter().copied().fold(f32::NEG_INFINITY, greater);
        Self {
            weight: mode.weight,
            stands: mode.stands,
            half: mode.half,
            reach: mode.half[0].hypot(mode.half[1]),
            bounds: [least(&x), most(&x), least(&y), most(&y)],
            x,
            y,
            cos: row(2),
            sin: row(3),
        }
    }
}

/// Clearance of the boxes of eight trajectories to an agent's boxes.
#[derive(Clone, Copy)]
pub(super) struct Clearance {
    /// Gap of the boxes, metres, at most [`FAR`]; negative where they overlap.
    pub(super) gap: Lanes,
    /// Step at which it is least; the last where the agent is far away.
    pub(super) nearest: Lanes,
    /// First step at which they overlap, or [`NEVER`].
    pub(super) touch: Lanes,
}

impl Clearance {
    const OPEN: Self = Self { gap: [FAR; LANES], nearest: [NEVER - 1.0; LANES], touch: [NEVER; LANES] };
}

/// The target's boxes along eight trajectories from the origin.
pub(super) struct TrajectoryBatch {
    half: [f32; 2],
    reach: f32,
    pub(super) x: [Lanes; FORECAST_STEPS],
    pub(super) y: [Lanes; FORECAST_STEPS],
    pub(super) cos: [Lanes; FORECAST_STEPS],
    pub(super) sin: [Lanes; FORECAST_STEPS],
    /// Least and greatest x and y of all of them.
    bounds: [f32; 4],
}

impl TrajectoryBatch {
    /// A batch of up to eight trajectories; copies of the last one fill the batch.
    #[inline(always)]
    pub(super) fn along(trajectories: &[[[f32; 2]; FORECAST_STEPS]], half: [f32; 2]) -> Self {
        let zero = [[0.0; LANES]; FORECAST_STEPS];
        let mut own = Self {
            half,
            reach: half[0].hypot(half[1]),
            x: zero,
            y: zero,
            cos: zero,
            sin: zero,
            bounds: [0.0; 4],
        };
        for lane in 0..LANES {
            for (step, [x, y]) in trajectories[lane.min(trajectories.len() - 1)].iter().enumerate() {
                (own.x[step][lane], own.y[step][lane]) = (*x, *y);
            }
        }
        let [mut last_x, mut last_y, mut cos, mut sin] =
            [[0.0; LANES], [0.0; LANES], [1.0; LANES], [0.0; LANES]];
        for step in 0..FORECAST_STEPS {
            let (x, y) = (&own.x[step], &own.y[step]);
            for l in 0..LANES {
                let [dx, dy] = [x[l] - last_x[l], y[l] - last_y[l]];
                let squared = dx * dx + dy * dy;
                let length = squared.sqrt();
                let moves = squared > STEP_SQUARED;
                cos[l] = if moves { dx / length } else { cos[l] };
                sin[l] = if moves { dy / length } else { sin[l] };
            }
            (last_x, last_y) = (*x, *y);
            (own.cos[step], own.sin[step]) = (cos, sin);
        }
        let over = |values: &[Lanes; FORECAST_STEPS], pick: fn(f32, f32) -> f32| {
            let mut best = values[0];
            for row in values {
                best = lanes(|l| pick(best[l], row[l]));
            }
            best.into_iter().fold(best[0], pick)
        };
        own.bounds = [over(&own.x, less), over(&own.x, greater), over(&own.y, less), over(&own.y, greater)];
        own
    }

    /// Gaps to an agent's boxes by separating axes; exact where boxes overlap.
    #[inline(always)]
    pub(super) fn clearance(&self, other: &Boxes) -> Clearance {
        let ([hl, hw], [ol, ow]) = (self.half, other.half);
        let apart = self.reach + other.reach + FAR;
        let [a, b] = [&self.bounds, &other.bounds];
        if a[0] > b[1] + apart || b[0] > a[1] + apart || a[2] > b[3] + apart || b[2] > a[3] + apart {
            return Clearance::OPEN;
        }
        let mut squared = [f32::INFINITY; LANES];
        for k in 0..FORECAST_STEPS {
            for (l, squared) in squared.iter_mut().enumerate() {
                let [dx, dy] = [other.x[k] - self.x[k][l], other.y[k] - self.y[k][l]];
                *squared = less(*squared, dx * dx + dy * dy);
            }
        }
        if squared.iter().all(|squared| *squared > apart * apart) {
            return Clearance::OPEN;
        }
        let Clearance { mut gap, mut nearest, mut touch } =
            Clearance { gap: [f32::INFINITY; LANES], ..Clearance::OPEN };
        for k in 0..FORECAST_STEPS {
            let (ox, oy, oc, os) = (other.x[k], other.y[k], other.cos[k], other.sin[k]);
            let step = k as f32;
            for l in 0..LANES {
                let [dx, dy] = [ox - self.x[k][l], oy - self.y[k][l]];
                let (c, s) = (self.cos[k][l], self.sin[k][l]);
                let along = (c * oc + s * os).abs();
                let across = (c * os - s * oc).abs();
                let a = (dx * c + dy * s).abs() - hl - ol * along - ow * across;
                let b = (dy * c - dx * s).abs() - hw - ol * across - ow * along;
                let d = (dx * oc + dy * os).abs() - ol - hl * along - hw * across;
                let e = (dy * oc - dx * os).abs() - ow - hl * across - hw * along;
                let here = greater(greater(a, b), greater(d, e));
                nearest[l] = if here < gap[l] { step } else { nearest[l] };
                gap[l] = less(gap[l], here);
                touch[l] = if here < 0.0 { less(touch[l], step) } else { touch[l] };
            }
        }
        // The result of a far trajectory must not depend on the other trajectories of the batch.
        let is_open = squared.map(|squared| squared > apart * apart);
        Clearance {
            gap: lanes(|l| if is_open[l] { FAR } else { less(gap[l], FAR) }),
            nearest: lanes(|l| if is_open[l] { NEVER - 1.0 } else { nearest[l] }),
            touch,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::{geometry::OrientedBox, seed::Rng};

    const HALF: [f32; 2] = [2.4, 1.0];

    /// A winding trajectory from the origin.
    fn trajectory(rng: &mut Rng) -> [[f32; 2]; FORECAST_STEPS] {
        let (mut at, mut heading) = ([0.0, 0.0], rng.uniform(-3.0, 3.0));
        let (speed, turn) = (rng.uniform(0.0, 6.0), rng.uniform(-0.3, 0.3));
        std::array::from_fn(|_| {
            heading += turn;
            at = [at[0] + speed * heading.cos(), at[1] + speed * heading.sin()];
            at.map(|x| x as f32)
        })
    }

    fn mode(rng: &mut Rng) -> ForecastMode {
        let points = trajectory(rng);
        let from = [rng.uniform(-30.0, 30.0) as f32, rng.uniform(-30.0, 30.0) as f32];
        let poses = points.map(|[x, y]| {
            let (sin, cos) = (rng.uniform(-3.0, 3.0) as f32).sin_cos();
            [x + from[0], y + from[1], cos, sin]
        });
        ForecastMode { weight: 0.5, half: [2.0, 0.9], stands: false, poses }
    }

    fn oriented([x, y]: [f32; 2], [cos, sin]: [f32; 2], [length, width]: [f32; 2]) -> OrientedBox {
        OrientedBox {
            center: [f64::from(x), f64::from(y)],
            axis: [f64::from(cos), f64::from(sin)],
            half_length: f64::from(length),
            half_width: f64::from(width),
        }
    }

    #[test]
    fn boxes_touch_exactly_if_the_boxes_of_the_objectives_intersect() {
        let mut rng = Rng::new(1, "eight", "touch");
        let (mut touching, mut open) = (0, 0);
        for _ in 0..400 {
            let trajectories: [_; LANES] = std::array::from_fn(|_| trajectory(&mut rng));
            let (own, mode) = (TrajectoryBatch::along(&trajectories, HALF), mode(&mut rng));
            let found = own.clearance(&Boxes::of(&mode));
            for l in 0..LANES {
                let touch = (0..FORECAST_STEPS).find(|&k| {
                    let [x, y, cos, sin] = mode.poses[k];
                    let own = oriented([own.x[k][l], own.y[k][l]], [own.cos[k][l], own.sin[k][l]], HALF);
                    own.intersects(&oriented([x, y], [cos, sin], mode.half))
                });
                assert_eq!(touch.map_or(NEVER, |k| k as f32), found.touch[l]);
                assert_eq!(touch.is_some(), found.gap[l] < 0.0);
                touching += usize::from(touch.is_some());
                open += usize::from(found.gap[l] == FAR);
            }
        }
        assert!(touching > 100 && open > 100, "{touching} touch, {open} are far");
    }

    #[test]
    fn the_clearance_of_a_trajectory_does_not_depend_on_its_batch() {
        let mut rng = Rng::new(2, "eight", "alone");
        for _ in 0..100 {
            let trajectories: [_; LANES] = std::array::from_fn(|_| trajectory(&mut rng));
            let other = Boxes::of(&mode(&mut rng));
            let in_batch = TrajectoryBatch::along(&trajectories, HALF).clearance(&other);
            for l in 0..LANES {
                let alone = TrajectoryBatch::along(&trajectories[l..=l], HALF).clearance(&other);
                let bits = |c: &Clearance, l: usize| [c.gap[l], c.nearest[l], c.touch[l]].map(f32::to_bits);
                assert_eq!(bits(&alone, 0), bits(&in_batch, l));
            }
        }
    }
}
