//! What a goal's trajectory means for the ego and for everybody else: the part of the score that
//! fine-tuning steers by.
//!
//! It gives zero until it is fine-tuned, so that the base model knows nothing of it. What it sees is
//! what the target could know *now*: the map, the ego's futures as a network predicts them, the others
//! along their lanes, the shape of the path itself; never the logged future.

use candle_core::{DType, Device, Result, Tensor};

use crate::{
    backbone::indices,
    features::{Features, LOOKS, STRIDE, Way},
    nn::{Linear, Mlp, wide},
    parameters::Scope,
};

/// Places along a car's middle line that are asked for an edge, shares of half its length.
const ALONG: [f32; 3] = [-0.9, 0.0, 0.9];
/// Relative positions to the ego's likeliest way that are seen: every second look.
const PLACES: usize = LOOKS / 2;
/// Inputs of the branch.
const COLUMNS: usize = 2 * PLACES + 27;
/// Width of its layers.
const WIDTH: usize = 64;

pub(crate) struct SteeringBranch {
    first: Mlp,
    second: Mlp,
    last: Linear,
}

impl SteeringBranch {
    pub(crate) fn new(scope: &Scope) -> Result<Self> {
        Ok(Self {
            first: Mlp::new(&scope.at("first"), COLUMNS, WIDTH)?,
            second: Mlp::new(&scope.at("second"), WIDTH, WIDTH)?,
            last: Linear::zero(&scope.at("last"), WIDTH, 1)?,
        })
    }

    /// Whether it gives zero whatever it sees: nothing to compute then, unless it is in training.
    pub(crate) fn is_silent(&self) -> Result<bool> {
        let zero = |tensor: &Tensor| -> Result<bool> {
            let numbers = tensor.flatten_all()?.to_dtype(DType::F32)?.to_vec1::<f32>()?;
            Ok(!tensor.is_variable() && numbers.iter().all(|x| *x == 0.0))
        };
        Ok(zero(&self.last.weight)? && zero(&self.last.bias)?)
    }

    /// What to add to the scores of described paths.
    ///
    /// *Shapes*: `rows` (n, columns) of [`describe`]; result (n).
    pub(crate) fn forward(&self, rows: &Tensor) -> Result<Tensor> {
        let x = self.second.forward(&self.first.forward(rows)?)?;
        self.last.forward(&x)?.squeeze(1)
    }

    /// Log-probabilities of some modes if they were driven along other places than those that
    /// `described` rows (modes) tell of.
    pub(crate) fn moved(
        &self,
        log_probs: &Tensor,
        modes: &[usize],
        described: &Tensor,
        places: &Tensor,
        features: &Features,
    ) -> Result<Tensor> {
        let index = indices(modes)?;
        let log_probs = log_probs.index_select(&index, 0)?;
        let Some(rows) = describe(places, features)? else { return Ok(log_probs) };
        let own = self.forward(&described.index_select(&index, 0)?)?;
        (log_probs - own)? + self.forward(&rows)?
    }
}

/// Rows of what the branch sees of paths, given by their places at the looks ahead (n, 20, 2), target
/// frame. Without an ego to look at, as when it is the target itself, there are none.
pub(crate) fn describe(places: &Tensor, features: &Features) -> Result<Option<Tensor>> {
    if features.outlook.ego.is_empty() {
        return Ok(None);
    }
    let n = places.dim(0)?;
    let numbers = places.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
    let table = |ways: &[Way]| ways.iter().map(Looks::of).collect::<Vec<_>>();
    let (ego, others) = (table(&features.outlook.ego), table(&features.outlook.others));
    let reach = features.half[0].hypot(features.half[1]);
    let mut rows = Vec::with_capacity(n * COLUMNS);
    wide(
        #[inline(always)]
        || {
            for path in numbers.as_chunks::<2>().0.as_chunks::<LOOKS>().0 {
                let own = Looks::along(path, features.half, reach);
                towards_ego(&own, &ego, features.speed(), &mut rows);
                towards_others(&own, &others, &mut rows);
                of_itself(&own, features, &mut rows);
            }
        },
    );
    debug_assert_eq!(rows.len(), n * COLUMNS);
    Ok(Some(Tensor::from_vec(rows, (n, COLUMNS), &Device::Cpu)?.to_dtype(places.dtype())?))
}

/// A box at every look ahead, a row a coordinate.
struct Looks {
    weight: f32,
    stands: bool,
    half: [f32; 2],
    /// Distance of a corner from the centre.
    reach: f32,
    x: [f32; LOOKS],
    y: [f32; LOOKS],
    cos: [f32; LOOKS],
    sin: [f32; LOOKS],
    /// Least and greatest x and y.
    bounds: [f32; 4],
}

/// How near a box comes to another at one of the looks.
#[derive(Clone, Copy)]
struct Clearance {
    /// Gap of the boxes, metres; negative where they overlap.
    gap: f32,
    /// Look at which it is least.
    nearest: usize,
    /// First look at which they overlap.
    touch: Option<usize>,
}

/// Gaps are told apart up to this, metres.
const FAR: f32 = 10.0;

/// Share of the looks that lie after one.
#[inline(always)]
fn early(look: usize) -> f32 {
    1.0 - (look + 1) as f32 / LOOKS as f32
}

/// The least of some numbers, four at a time.
#[inline(always)]
fn least(values: &[f32; LOOKS]) -> f32 {
    let less = |a: f32, b: f32| if b < a { b } else { a };
    let mut lanes = [f32::INFINITY; 4];
    for four in values.as_chunks::<4>().0 {
        for (lane, value) in lanes.iter_mut().zip(four) {
            *lane = less(*lane, *value);
        }
    }
    less(less(lanes[0], lanes[1]), less(lanes[2], lanes[3]))
}

impl Looks {
    fn of(way: &Way) -> Self {
        let row = |k: usize| std::array::from_fn(|look| way.poses[look][k]);
        let (weight, stands, half) = (way.weight, way.stands, way.half);
        let (x, y, cos, sin) = (row(0), row(1), row(2), row(3));
        Self { weight, stands, half, reach: half[0].hypot(half[1]), x, y, cos, sin, bounds: [0.0; 4] }
            .bounded()
    }

    /// The target's own boxes along a path from the origin.
    #[inline(always)]
    fn along(path: &[[f32; 2]; LOOKS], half: [f32; 2], reach: f32) -> Self {
        let zero = [0.0; LOOKS];
        let (x, y, cos, sin) = (zero, zero, zero, zero);
        let mut own = Self { weight: 1.0, stands: false, half, reach, x, y, cos, sin, bounds: [0.0; 4] };
        let (mut last, mut axis) = ([0.0, 0.0], [1.0, 0.0]);
        for (look, &at) in path.iter().enumerate() {
            let [dx, dy] = [at[0] - last[0], at[1] - last[1]];
            let squared = dx * dx + dy * dy;
            if squared > 0.0025 {
                let way = squared.sqrt();
                axis = [dx / way, dy / way];
            }
            [own.x[look], own.y[look]] = at;
            [own.cos[look], own.sin[look]] = axis;
            last = at;
        }
        own.bounded()
    }

    #[inline(always)]
    fn bounded(mut self) -> Self {
        let most = |values: &[f32; LOOKS]| -least(&values.map(|v| -v));
        self.bounds = [least(&self.x), most(&self.x), least(&self.y), most(&self.y)];
        self
    }

    /// Whether two ways stay farther apart than gaps are told apart, wherever they are when.
    #[inline(always)]
    fn is_far_from(&self, other: &Self, reach: f32) -> bool {
        let [a, b] = [&self.bounds, &other.bounds];
        let apart = reach + FAR;
        a[0] > b[1] + apart || b[0] > a[1] + apart || a[2] > b[3] + apart || b[2] > a[3] + apart
    }

    /// Gaps to another's boxes by separating axes: exact where they overlap.
    #[inline(always)]
    fn clearance(&self, other: &Self) -> Clearance {
        const OPEN: Clearance = Clearance { gap: FAR, nearest: LOOKS - 1, touch: None };
        let ([hl, hw], [ol, ow]) = (self.half, other.half);
        let reach = self.reach + other.reach;
        if self.is_far_from(other, reach) {
            return OPEN;
        }
        let mut gaps = [0.0_f32; LOOKS];
        for (k, gap) in gaps.iter_mut().enumerate() {
            let [dx, dy] = [other.x[k] - self.x[k], other.y[k] - self.y[k]];
            *gap = dx * dx + dy * dy;
        }
        if least(&gaps) > (reach + FAR) * (reach + FAR) {
            return OPEN;
        }
        for (k, gap) in gaps.iter_mut().enumerate() {
            let [dx, dy] = [other.x[k] - self.x[k], other.y[k] - self.y[k]];
            let (c, s, oc, os) = (self.cos[k], self.sin[k], other.cos[k], other.sin[k]);
            let along = (c * oc + s * os).abs();
            let across = (c * os - s * oc).abs();
            let greater = |a: f32, b: f32| if b > a { b } else { a };
            let a = (dx * c + dy * s).abs() - hl - ol * along - ow * across;
            let b = (dy * c - dx * s).abs() - hw - ol * across - ow * along;
            let d = (dx * oc + dy * os).abs() - ol - hl * along - hw * across;
            let e = (dy * oc - dx * os).abs() - ow - hl * across - hw * along;
            *gap = greater(greater(a, b), greater(d, e));
        }
        let gap = least(&gaps);
        let nearest = gaps.iter().position(|g| *g == gap).unwrap_or(LOOKS - 1);
        let touch = if gap < 0.0 { gaps.iter().position(|g| *g < 0.0) } else { None };
        Clearance { gap: gap.min(FAR), nearest, touch }
    }
}

/// Where the path is relative to the ego's likeliest way, how likely it meets the ego, when, and how.
#[inline(always)]
fn towards_ego(own: &Looks, ego: &[Looks], speed: f32, out: &mut Vec<f32>) {
    let likeliest = &ego[0];
    let mut places = [0.0; 2 * PLACES];
    for (place, k) in places.as_chunks_mut::<2>().0.iter_mut().zip((1..LOOKS).step_by(2)) {
        *place = [own.x[k] - likeliest.x[k], own.y[k] - likeliest.y[k]];
    }
    out.extend_from_slice(&places.map(signed_root));
    let (mut hit, mut near, mut soon) = (0.0, 0.0, 0.0);
    let (mut best, mut first) = (None::<Clearance>, None::<Clearance>);
    for way in ego {
        let clearance = own.clearance(way);
        near += way.weight / (1.0 + clearance.gap.max(0.0));
        if let Some(look) = clearance.touch {
            hit += way.weight;
            soon += way.weight * early(look);
        }
        if best.is_none_or(|best| clearance.gap < best.gap) {
            best = Some(clearance);
        }
        first.get_or_insert(clearance);
    }
    let touchless = Clearance { gap: FAR, nearest: 0, touch: None };
    let (best, first) = (best.unwrap_or(touchless), first.unwrap_or(touchless));
    let k = first.nearest;
    let velocity = |way: &Looks| {
        let [from, to] = if k == 0 { [0, 1] } else { [k - 1, k] };
        [way.x[to] - way.x[from], way.y[to] - way.y[from]].map(|d| d / (STRIDE as f32 * 0.1))
    };
    let ([vx, vy], [ex, ey]) = (velocity(own), velocity(likeliest));
    let [x, y] = [own.x[LOOKS - 1], own.y[LOOKS - 1]];
    let length = (x * x + y * y).sqrt();
    out.extend([
        2.0 * hit,
        2.0 * near,
        2.0 * soon,
        signed_root(best.gap),
        early(best.nearest),
        signed_root(first.gap),
        f32::from(first.touch.is_some()),
        early(first.nearest),
        (vx - ex) / 10.0,
        (vy - ey) / 10.0,
        (ex * ex + ey * ey).sqrt() / 10.0,
        (length / 8.0 - speed) / 10.0,
    ]);
}

/// How near the path comes to those who stand and to those who drive, how likely it touches one, when.
#[inline(always)]
fn towards_others(own: &Looks, others: &[Looks], out: &mut Vec<f32>) {
    for stands in [true, false] {
        let (mut gap, mut free, mut soonest) = (FAR, 1.0, 0.0_f32);
        for way in others.iter().filter(|way| way.stands == stands) {
            let clearance = own.clearance(way);
            gap = gap.min(clearance.gap);
            if let Some(look) = clearance.touch {
                free *= 1.0 - way.weight;
                soonest = soonest.max(early(look));
            }
        }
        out.extend([1.0 - free, soonest, signed_root(gap), 1.0 / (1.0 + gap.max(0.0))]);
    }
}

/// Whether the path touches an edge, and how it is driven.
#[inline(always)]
fn of_itself(own: &Looks, features: &Features, out: &mut Vec<f32>) {
    let (mut last, mut axis, mut speed) = ([0.0, 0.0], [1.0, 0.0], features.speed());
    let mut edge = None;
    let (mut brake, mut gain, mut across, mut turned, mut restless) =
        (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
    let span = STRIDE as f32 * 0.1;
    for look in 0..LOOKS {
        let at = [own.x[look], own.y[look]];
        let [dx, dy] = [at[0] - last[0], at[1] - last[1]];
        let now = (dx * dx + dy * dy).sqrt() / span;
        let acceleration = (now - speed) / span;
        brake = brake.max(-acceleration);
        gain = gain.max(acceleration);
        let [c, s] = [own.cos[look], own.sin[look]];
        let sin = axis[0] * s - axis[1] * c;
        // The turn of one look is small: two terms of the arc sine do; a quarter turn is the most.
        let cos = axis[0] * c + axis[1] * s;
        let turn = if cos > 0.0 { sin.abs() * (1.0 + sin * sin / 6.0) } else { std::f32::consts::FRAC_PI_2 };
        across = across.max(turn / span * now);
        turned += turn;
        restless += turn / span / (now + 0.5);
        if edge.is_none() && touches_edge(features, at, [c, s]) {
            edge = Some(look);
        }
        (last, speed, axis) = (at, now, [c, s]);
    }
    out.extend([
        f32::from(edge.is_some()),
        edge.map_or(0.0, early),
        (brake / 4.0).min(4.0),
        (gain / 4.0).min(4.0),
        (across / 4.0).min(4.0),
        (turned / 2.0).min(4.0),
        (restless / 4.0).min(4.0),
    ]);
}

#[inline(always)]
fn touches_edge(features: &Features, [x, y]: [f32; 2], [c, s]: [f32; 2]) -> bool {
    let [length, width] = features.half;
    if !features.edges.is_near(x, y) {
        return false;
    }
    ALONG.iter().any(|share| {
        let along = share * length;
        [-width, 0.0, width]
            .iter()
            .any(|across| features.edges.holds(x + along * c - across * s, y + along * s + across * c))
    })
}

/// Keeps what is near apart and what is far together.
#[inline(always)]
fn signed_root(x: f32) -> f32 {
    0.7 * x / (1.0 + x.abs()).sqrt()
}
