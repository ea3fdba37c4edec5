//! Centre lines of lanes that a file describes by their outline alone.
//!
//! The outline is split at the two ends of the lane into its left and its right side. The centre line lies halfway
//! between points at equal shares of both sides. The ends are the pair of edges, half the outline apart, between which
//! the sides are nearest to each other. The lane leads along the order of its points, unless its links say otherwise.

use sage_core::{
    geometry::{Point, distance},
    scene::{Lane, Map},
};

/// Most corners of an outline whose ends are searched: the search is quadratic.
const MOST: usize = 512;
/// How far from half the outline the second end may be, as a share of the outline. In a curve the sides differ in length.
const SKEW: f64 = 0.08;
/// Places at which the distance of the sides is measured.
const PLACES: usize = 9;
/// Largest distance between the sides, metres.
const WIDEST: f64 = 15.0;
/// Outlines whose corners are nearer are one corner, metres.
const SAME: f64 = 1e-6;
/// Shares of a side that differ by less are equal.
const SAME_SHARE: f64 = 1e-6;

/// Replaces the outlines of lanes by centre lines. A lane without one keeps the centre of its outline as a single point.
pub(crate) fn derive_center_lines(map: &mut Map, lanes: &[usize], notes: &mut Vec<String>) {
    if lanes.is_empty() {
        return;
    }
    let mut points: Vec<[f64; 3]> = Vec::with_capacity(map.points.len());
    let (mut derived, mut failed, mut is_ring) = (Vec::new(), Vec::new(), lanes.iter().peekable());
    for (k, feature) in map.features.iter_mut().enumerate() {
        let own = &map.points[feature.points.clone()];
        let first = points.len();
        if is_ring.next_if_eq(&&k).is_none() {
            points.extend(own);
        } else if let Some(CenterLine { line, widths }) = CenterLine::of(own) {
            points.extend(line);
            if let Some(lane) = feature.lane.as_deref_mut().filter(|lane| lane.width.is_empty()) {
                lane.width = widths.iter().map(|width| [0.5 * width; 2]).collect();
            }
            derived.push(k);
        } else {
            points.push(center(own));
            failed.push(k);
        }
        feature.points = first..points.len();
    }
    map.points = points;
    derived.iter().for_each(|k| orient(map, *k));
    let names = |of: &[usize]| {
        let all: Vec<String> = of.iter().take(3).map(|k| format!("`{}`", map.features[*k].id)).collect();
        let more = of.len().saturating_sub(3);
        all.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
    };
    if !derived.is_empty() {
        notes.push(format!("centre lines are derived from the polygons of {}: lane {}", count(derived.len()), names(&derived)));
    }
    if !failed.is_empty() {
        notes.push(format!("no centre line fits the polygons of {}, which have none: lane {}", count(failed.len()), names(&failed)));
    }
}

fn count(lanes: usize) -> String {
    if lanes == 1 { "1 lane".to_owned() } else { format!("{lanes} lanes") }
}

/// Mean of the corners.
fn center(points: &[[f64; 3]]) -> [f64; 3] {
    [0, 1, 2].map(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / points.len() as f64)
}

fn plane([x, y, _]: [f64; 3]) -> Point {
    [x, y]
}

/// Turns a lane around if its neighbours along the road say that it leads the other way.
fn orient(map: &mut Map, lane: usize) {
    let end_of = |k: usize| map.points_of(&map.features[k]).last().copied().map(plane);
    let start_of = |k: usize| map.points_of(&map.features[k]).first().copied().map(plane);
    let (Some(start), Some(end), Some(links)) = (start_of(lane), end_of(lane), map.features[lane].lane.as_deref())
    else {
        return;
    };
    let Lane { entries, exits, .. } = links;
    let before = entries.iter().filter(|k| **k != lane).filter_map(|k| end_of(*k)).map(|p| [p, start, end]);
    let after = exits.iter().filter(|k| **k != lane).filter_map(|k| start_of(*k)).map(|p| [p, end, start]);
    let gain: f64 = before.chain(after).map(|[p, own, other]| distance(p, own) - distance(p, other)).sum();
    if gain > 0.0 {
        let range = map.features[lane].points.clone();
        map.points[range].reverse();
        if let Some(lane) = map.features[lane].lane.as_deref_mut() {
            lane.width.reverse();
        }
    }
}

/// A centre line with the width of the lane at each point, metres.
struct CenterLine {
    line: Vec<[f64; 3]>,
    widths: Vec<f64>,
}

impl CenterLine {
    /// The centre line of an outline; `None` if it is not one of a lane.
    fn of(outline: &[[f64; 3]]) -> Option<Self> {
        let mut ring: Vec<[f64; 3]> = Vec::with_capacity(outline.len());
        for point in outline {
            if ring.last().is_none_or(|last| distance(plane(*last), plane(*point)) > SAME) {
                ring.push(*point);
            }
        }
        while ring.len() > 1 && distance(plane(ring[0]), plane(ring[ring.len() - 1])) <= SAME {
            ring.pop();
        }
        if !(4..=MOST).contains(&ring.len()) {
            return None;
        }
        let sides = ends(&ring).map(|ends| sides(&ring, ends))?;
        let line = Self::between(&sides);
        let length: f64 = line.line.windows(2).map(|w| distance(plane(w[0]), plane(w[1]))).sum();
        let mean = line.widths.iter().sum::<f64>() / line.widths.len() as f64;
        // What is wider than long has no direction.
        (mean > 0.0 && length >= mean && line.widths.iter().all(|width| *width <= WIDEST)).then_some(line)
    }

    fn between([left, right]: &[Side; 2]) -> Self {
        let mut shares: Vec<f64> = left.shares.iter().chain(&right.shares).copied().collect();
        shares.sort_by(f64::total_cmp);
        shares.dedup_by(|b, a| *b - *a < SAME_SHARE);
        let pairs: Vec<[[f64; 3]; 2]> = shares.iter().map(|share| [left.at(*share), right.at(*share)]).collect();
        let line = pairs.iter().map(|[l, r]| [0, 1, 2].map(|axis| 0.5 * (l[axis] + r[axis]))).collect();
        let widths = pairs.iter().map(|[l, r]| distance(plane(*l), plane(*r))).collect();
        Self { line, widths }
    }
}

/// One side of a lane from its start to its end.
struct Side {
    points: Vec<[f64; 3]>,
    /// Share of the side's length at each point, from 0 to 1.
    shares: Vec<f64>,
}

impl Side {
    fn new(points: Vec<[f64; 3]>) -> Self {
        let mut along = vec![0.0];
        for pair in points.windows(2) {
            along.push(along[along.len() - 1] + distance(plane(pair[0]), plane(pair[1])));
        }
        let length = along[along.len() - 1].max(f64::MIN_POSITIVE);
        let mut shares: Vec<f64> = along.into_iter().map(|s| s / length).collect();
        if let Some(last) = shares.last_mut().filter(|_| points.len() > 1) {
            *last = 1.0;
        }
        Self { points, shares }
    }

    fn at(&self, share: f64) -> [f64; 3] {
        let next = self.shares.partition_point(|s| *s < share).min(self.points.len() - 1);
        let Some(before) = next.checked_sub(1) else { return self.points[next] };
        let span = self.shares[next] - self.shares[before];
        let part = if span > 0.0 { ((share - self.shares[before]) / span).clamp(0.0, 1.0) } else { 1.0 };
        let [a, b] = [before, next].map(|k| self.points[k]);
        [0, 1, 2].map(|axis| a[axis] + part * (b[axis] - a[axis]))
    }
}

/// The two edges at the ends of the lane, by the index of their first corner: the end behind the lane, and the one
/// ahead of it. `None` if no pair is about half the outline apart.
fn ends(ring: &[[f64; 3]]) -> Option<[usize; 2]> {
    let n = ring.len();
    let mut along = vec![0.0];
    for k in 0..n {
        along.push(along[k] + distance(plane(ring[k]), plane(ring[(k + 1) % n])));
    }
    let total = along[n];
    let middle = |k: usize| 0.5 * (along[k] + along[k + 1]);
    let mut best: Option<(f64, [usize; 2])> = None;
    // The lane begins with the first point, so the last edge is tried first: of equal pairs the earliest stays.
    for behind in (0..n).rev() {
        for ahead in 0..behind {
            let apart = middle(behind) - middle(ahead);
            let slack = SKEW * total + along[behind + 1] - along[behind] + along[ahead + 1] - along[ahead];
            if (apart - 0.5 * total).abs() > 0.5 * slack {
                continue;
            }
            let apart = mean_distance(ring, &along, [behind, ahead]);
            if best.is_none_or(|(least, _)| apart < least * (1.0 - 1e-6)) {
                best = Some((apart, [behind, ahead]));
            }
        }
    }
    best.map(|(_, ends)| ends)
}

/// Mean distance of the two sides between a pair of ends, at equal shares of their lengths.
fn mean_distance(ring: &[[f64; 3]], along: &[f64], [behind, ahead]: [usize; 2]) -> f64 {
    let total = along[ring.len()];
    let at = |s: f64| {
        let s = s.rem_euclid(total);
        let next = along.partition_point(|a| *a <= s).clamp(1, ring.len());
        let (from, span) = (along[next - 1], along[next] - along[next - 1]);
        let share = if span > 0.0 { (s - from) / span } else { 0.0 };
        let [a, b] = [ring[next - 1], ring[next % ring.len()]].map(plane);
        [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
    };
    // Forwards from the end of the edge behind, and backwards from its start.
    let (first, second) = (along[behind + 1] - total, along[behind]);
    let lengths = [along[ahead] - first, second - along[ahead + 1]];
    let apart = |k: usize| {
        let share = k as f64 / (PLACES - 1) as f64;
        distance(at(first + share * lengths[0]), at(second - share * lengths[1]))
    };
    (0..PLACES).map(apart).sum::<f64>() / PLACES as f64
}

/// The sides between two ends, both along the order of the points of the first side.
fn sides(ring: &[[f64; 3]], [behind, ahead]: [usize; 2]) -> [Side; 2] {
    let n = ring.len();
    let first = (0..(ahead + n - behind) % n).map(|k| ring[(behind + 1 + k) % n]).collect();
    let second = (ahead + 1..=behind).rev().map(|k| ring[k]).collect();
    [Side::new(first), Side::new(second)]
}
