//! Input rows of the interaction head.

use std::f32::consts::FRAC_PI_2;

use candle_core::{Result, Tensor};

use super::trajectory_batch::{
    Boxes, Clearance, FAR, LANES, Lanes, NEVER, TrajectoryBatch, greater, lanes, less,
};
use crate::{
    features::{FORECAST_STEPS, Features, STRIDE},
    nn::wide,
};

/// Points along the centre line of the target's box that are tested for a road edge, as shares of half its
/// length.
const ALONG: [f32; 3] = [-0.9, 0.0, 0.9];
/// Number of positions relative to the ego's likeliest mode: one at every second forecast step.
const POSITIONS: usize = FORECAST_STEPS / 2;
/// Number of inputs of the head.
pub(super) const COLUMNS: usize = 2 * POSITIONS + 27;
/// Seconds between forecast steps.
const SPAN: f32 = STRIDE as f32 * 0.1;

/// Input rows of trajectories; `None` without an ego forecast, for instance if the ego is the target.
///
/// *Shapes*: `points` (n, 20, 2) at the forecast steps, target frame; result (n, columns).
pub(crate) fn describe(points: &Tensor, features: &Features) -> Result<Option<Tensor>> {
    if features.agent_forecasts.ego.is_empty() {
        return Ok(None);
    }
    let n = points.dim(0)?;
    let numbers = points.to_dtype(candle_core::DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
    let trajectories = numbers.as_chunks::<2>().0.as_chunks::<FORECAST_STEPS>().0;
    let table = |modes: &[_]| modes.iter().map(Boxes::of).collect::<Vec<_>>();
    let (ego, others) = (table(&features.agent_forecasts.ego), table(&features.agent_forecasts.others));
    let mut rows = vec![0.0; n * COLUMNS];
    wide(
        #[inline(always)]
        || {
            for (batch, rows) in trajectories.chunks(LANES).zip(rows.chunks_mut(LANES * COLUMNS)) {
                let own = TrajectoryBatch::along(batch, features.half);
                let mut columns = Columns { values: [[0.0; LANES]; COLUMNS], filled: 0 };
                push_ego(&own, &ego, features.speed(), &mut columns);
                push_others(&own, &others, &mut columns);
                push_own(&own, features, &mut columns);
                columns.write(rows);
            }
        },
    );
    Ok(Some(Tensor::from_vec(rows, (n, COLUMNS), points.device())?.to_dtype(points.dtype())?))
}

/// Input columns of a batch of trajectories.
struct Columns {
    values: [Lanes; COLUMNS],
    filled: usize,
}

impl Columns {
    #[inline(always)]
    fn push<const N: usize>(&mut self, values: [Lanes; N]) {
        self.values[self.filled..self.filled + N].copy_from_slice(&values);
        self.filled += N;
    }

    /// Writes one row per trajectory.
    #[inline(always)]
    fn write(&self, rows: &mut [f32]) {
        debug_assert_eq!(self.filled, COLUMNS);
        for (lane, row) in rows.chunks_exact_mut(COLUMNS).enumerate() {
            for (number, column) in row.iter_mut().zip(&self.values) {
                *number = column[lane];
            }
        }
    }
}

/// Share of the forecast steps that come after a step.
#[inline(always)]
fn early(step: f32) -> f32 {
    1.0 - (step + 1.0) / NEVER
}

/// Columns of the ego: position relative to its likeliest mode, gaps, and probability and time of contact.
#[inline(always)]
fn push_ego(own: &TrajectoryBatch, ego: &[Boxes], speed: f32, out: &mut Columns) {
    let likeliest = &ego[0];
    for k in (1..FORECAST_STEPS).step_by(2) {
        out.push([
            lanes(|l| signed_root(own.x[k][l] - likeliest.x[k])),
            lanes(|l| signed_root(own.y[k][l] - likeliest.y[k])),
        ]);
    }
    let [mut hit, mut proximity, mut soon] = [[0.0; LANES]; 3];
    let first = own.clearance(likeliest);
    let (mut gap, mut nearest) = (first.gap, first.nearest);
    for (k, mode) in ego.iter().enumerate() {
        let here = if k == 0 { first } else { own.clearance(mode) };
        for l in 0..LANES {
            proximity[l] += mode.weight / (1.0 + greater(here.gap[l], 0.0));
            let touches = here.touch[l] < NEVER;
            hit[l] += if touches { mode.weight } else { 0.0 };
            soon[l] += if touches { mode.weight * early(here.touch[l]) } else { 0.0 };
            nearest[l] = if here.gap[l] < gap[l] { here.nearest[l] } else { nearest[l] };
            gap[l] = less(gap[l], here.gap[l]);
        }
    }
    out.push([
        hit.map(|hit| 2.0 * hit),
        proximity.map(|proximity| 2.0 * proximity),
        soon.map(|soon| 2.0 * soon),
        gap.map(signed_root),
        nearest.map(early),
        first.gap.map(signed_root),
        first.touch.map(|touch| if touch < NEVER { 1.0 } else { 0.0 }),
        first.nearest.map(early),
    ]);
    push_closest(own, likeliest, &first, speed, out);
}

/// Columns of the step at which the trajectory and the ego's likeliest mode are nearest: their velocities;
/// and the mean speed of the trajectory.
#[inline(always)]
fn push_closest(own: &TrajectoryBatch, likeliest: &Boxes, first: &Clearance, speed: f32, out: &mut Columns) {
    let mut columns = [[0.0; LANES]; 4];
    for (l, nearest) in first.nearest.iter().enumerate() {
        let to = (*nearest as usize).max(1);
        let from = to - 1;
        let [vx, vy] = [own.x[to][l] - own.x[from][l], own.y[to][l] - own.y[from][l]].map(|d| d / SPAN);
        let [ex, ey] =
            [likeliest.x[to] - likeliest.x[from], likeliest.y[to] - likeliest.y[from]].map(|d| d / SPAN);
        let [x, y] = [own.x[FORECAST_STEPS - 1][l], own.y[FORECAST_STEPS - 1][l]];
        columns[0][l] = (vx - ex) / 10.0;
        columns[1][l] = (vy - ey) / 10.0;
        columns[2][l] = (ex * ex + ey * ey).sqrt() / 10.0;
        columns[3][l] = ((x * x + y * y).sqrt() / 8.0 - speed) / 10.0;
    }
    out.push(columns);
}

/// Columns of the standing and of the moving agents: clearance, and probability and time of contact.
#[inline(always)]
fn push_others(own: &TrajectoryBatch, others: &[Boxes], out: &mut Columns) {
    for stands in [true, false] {
        let [mut gap, mut free, mut soonest] = [[FAR; LANES], [1.0; LANES], [0.0; LANES]];
        for mode in others.iter().filter(|mode| mode.stands == stands) {
            let here = own.clearance(mode);
            for l in 0..LANES {
                gap[l] = less(gap[l], here.gap[l]);
                free[l] *= if here.touch[l] < NEVER { 1.0 - mode.weight } else { 1.0 };
                // Zero without contact, and for contact at the last step.
                soonest[l] = greater(soonest[l], early(here.touch[l]));
            }
        }
        out.push([
            free.map(|free| 1.0 - free),
            soonest,
            gap.map(signed_root),
            gap.map(|gap| 1.0 / (1.0 + greater(gap, 0.0))),
        ]);
    }
}

/// Columns of the trajectory alone: contact with a road edge, and kinematics.
#[inline(always)]
fn push_own(own: &TrajectoryBatch, features: &Features, out: &mut Columns) {
    let [mut last_x, mut last_y, mut last_cos, mut last_sin] =
        [[0.0; LANES], [0.0; LANES], [1.0; LANES], [0.0; LANES]];
    let mut speed = [features.speed(); LANES];
    let [mut brake, mut gain, mut across, mut turned, mut winding] = [[0.0; LANES]; 5];
    let mut edge = [NEVER; LANES];
    for step in 0..FORECAST_STEPS {
        let (x, y, cos, sin) = (&own.x[step], &own.y[step], &own.cos[step], &own.sin[step]);
        for l in 0..LANES {
            let [dx, dy] = [x[l] - last_x[l], y[l] - last_y[l]];
            let now = (dx * dx + dy * dy).sqrt() / SPAN;
            let acceleration = (now - speed[l]) / SPAN;
            brake[l] = greater(brake[l], -acceleration);
            gain[l] = greater(gain[l], acceleration);
            let turn_sin = last_cos[l] * sin[l] - last_sin[l] * cos[l];
            let turn_cos = last_cos[l] * cos[l] + last_sin[l] * sin[l];
            // The turn of one step is small, so two terms of the arc sine suffice. It is at most a quarter
            // turn.
            let small = turn_sin.abs() * (1.0 + turn_sin * turn_sin / 6.0);
            let turn = if turn_cos > 0.0 { small } else { FRAC_PI_2 };
            across[l] = greater(across[l], turn / SPAN * now);
            turned[l] += turn;
            winding[l] += turn / SPAN / (now + 0.5);
            speed[l] = now;
        }
        for (l, edge) in edge.iter_mut().enumerate() {
            if *edge == NEVER && touches_edge(features, [x[l], y[l]], [cos[l], sin[l]]) {
                *edge = step as f32;
            }
        }
        (last_x, last_y, last_cos, last_sin) = (*x, *y, *cos, *sin);
    }
    let share = |values: Lanes, scale: f32| values.map(|value| less(value / scale, 4.0));
    out.push([
        edge.map(|edge| if edge < NEVER { 1.0 } else { 0.0 }),
        edge.map(|edge| if edge < NEVER { early(edge) } else { 0.0 }),
        share(brake, 4.0),
        share(gain, 4.0),
        share(across, 4.0),
        share(turned, 2.0),
        share(winding, 4.0),
    ]);
}

/// Whether points along and across a box lie on a road edge.
#[inline(always)]
fn touches_edge(features: &Features, [x, y]: [f32; 2], [c, s]: [f32; 2]) -> bool {
    let [length, width] = features.half;
    features.edges.is_near(x, y)
        && ALONG.iter().any(|share| {
            let along = share * length;
            [-width, 0.0, width]
                .iter()
                .any(|across| features.edges.holds(x + along * c - across * s, y + along * s + across * c))
        })
}

/// Compresses large distances.
#[inline(always)]
fn signed_root(x: f32) -> f32 {
    0.7 * x / (1.0 + x.abs()).sqrt()
}
