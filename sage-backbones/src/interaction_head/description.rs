//! Input rows of the interaction head.

use std::f32::consts::FRAC_PI_2;

use candle_core::{Device, Result, Tensor};

use super::trajectory_batch::{
    Boxes, Clearance, FAR, LANES, Lanes, NEVER, TrajectoryBatch, greater, lanes, less,
};
use crate::{
    features::{FORECAST_STEPS, Features, STRIDE},
    nn::wide,
};

/// Points along a car's centre line that are tested for a road edge, shares of half its length.
const ALONG: [f32; 3] = [-0.9, 0.0, 0.9];
/// Positions relative to the ego's likeliest mode: every second forecast step.
const POSITIONS: usize = FORECAST_STEPS / 2;
/// Inputs of the head.
pub(super) const COLUMNS: usize = 2 * POSITIONS + 27;
/// Seconds between forecast steps.
const SPAN: f32 = STRIDE as f32 * 0.1;

/// Input rows of trajectories, given by their points at the forecast steps (n, 20, 2), target frame. None
/// without an ego, for instance if the ego is the target.
pub(crate) fn describe(points: &Tensor, features: &Features) -> Result<Option<Tensor>> {
    if features.agent_forecasts.ego.is_empty() {
        return Ok(None);
    }
    let n = points.dim(0)?;
    let numbers = points.to_dtype(candle_core::DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
    let paths = numbers.as_chunks::<2>().0.as_chunks::<FORECAST_STEPS>().0;
    let table = |modes: &[_]| modes.iter().map(Boxes::of).collect::<Vec<_>>();
    let (ego, others) = (table(&features.agent_forecasts.ego), table(&features.agent_forecasts.others));
    let mut rows = vec![0.0; n * COLUMNS];
    wide(
        #[inline(always)]
        || {
            for (paths, rows) in paths.chunks(LANES).zip(rows.chunks_mut(LANES * COLUMNS)) {
                let own = TrajectoryBatch::along(paths, features.half);
                let mut columns = Columns { values: [[0.0; LANES]; COLUMNS], filled: 0 };
                towards_ego(&own, &ego, features.speed(), &mut columns);
                towards_others(&own, &others, &mut columns);
                of_itself(&own, features, &mut columns);
                columns.write(rows);
            }
        },
    );
    Ok(Some(Tensor::from_vec(rows, (n, COLUMNS), &Device::Cpu)?.to_dtype(points.dtype())?))
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

    /// As rows, one a trajectory.
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

/// Share of the forecast steps after a step.
#[inline(always)]
fn early(step: f32) -> f32 {
    1.0 - (step + 1.0) / NEVER
}

/// Position relative to the ego's likeliest mode; probability, time and kind of contact with the ego.
#[inline(always)]
fn towards_ego(own: &TrajectoryBatch, ego: &[Boxes], speed: f32, out: &mut Columns) {
    let likeliest = &ego[0];
    for k in (1..FORECAST_STEPS).step_by(2) {
        out.push([
            lanes(|l| signed_root(own.x[k][l] - likeliest.x[k])),
            lanes(|l| signed_root(own.y[k][l] - likeliest.y[k])),
        ]);
    }
    let [mut hit, mut near, mut soon] = [[0.0; LANES]; 3];
    let first = own.clearance(likeliest);
    let (mut gap, mut nearest) = (first.gap, first.nearest);
    for (k, mode) in ego.iter().enumerate() {
        let here = if k == 0 { first } else { own.clearance(mode) };
        for l in 0..LANES {
            near[l] += mode.weight / (1.0 + greater(here.gap[l], 0.0));
            let meets = here.touch[l] < NEVER;
            hit[l] += if meets { mode.weight } else { 0.0 };
            soon[l] += if meets { mode.weight * early(here.touch[l]) } else { 0.0 };
            nearest[l] = if here.gap[l] < gap[l] { here.nearest[l] } else { nearest[l] };
            gap[l] = less(gap[l], here.gap[l]);
        }
    }
    out.push([
        hit.map(|hit| 2.0 * hit),
        near.map(|near| 2.0 * near),
        soon.map(|soon| 2.0 * soon),
        gap.map(signed_root),
        nearest.map(early),
        first.gap.map(signed_root),
        first.touch.map(|touch| if touch < NEVER { 1.0 } else { 0.0 }),
        first.nearest.map(early),
    ]);
    as_they_meet(own, likeliest, &first, speed, out);
}

/// Velocities where the trajectory and the ego's likeliest mode are nearest, and mean speed.
#[inline(always)]
fn as_they_meet(own: &TrajectoryBatch, likeliest: &Boxes, first: &Clearance, speed: f32, out: &mut Columns) {
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

/// Clearance to standing and to moving agents; probability and time of contact.
#[inline(always)]
fn towards_others(own: &TrajectoryBatch, others: &[Boxes], out: &mut Columns) {
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

/// Contact with a road edge, and kinematics.
#[inline(always)]
fn of_itself(own: &TrajectoryBatch, features: &Features, out: &mut Columns) {
    let [mut last_x, mut last_y, mut last_cos, mut last_sin] =
        [[0.0; LANES], [0.0; LANES], [1.0; LANES], [0.0; LANES]];
    let mut speed = [features.speed(); LANES];
    let [mut brake, mut gain, mut across, mut turned, mut restless] = [[0.0; LANES]; 5];
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
            // The turn of one step is small: two terms of the arc sine do; a quarter turn is the most.
            let small = turn_sin.abs() * (1.0 + turn_sin * turn_sin / 6.0);
            let turn = if turn_cos > 0.0 { small } else { FRAC_PI_2 };
            across[l] = greater(across[l], turn / SPAN * now);
            turned[l] += turn;
            restless[l] += turn / SPAN / (now + 0.5);
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
        share(restless, 4.0),
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
