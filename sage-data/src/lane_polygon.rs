//! Centre lines of lanes that a file describes by their outline alone.
//!
//! The outline is split at the two ends of the lane into its left and its right side. The centre line lies halfway
//! between points at equal shares of both sides. The ends are the pair of edges, half the outline apart, between which
//! the sides are nearest to each other and most parallel. The lane leads along the order of its points, unless its links say otherwise.

use sage_core::{
    geometry::{Point, distance},
    scene::Note,
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
/// Largest distance of a point that is left out from the line of its neighbours, metres.
const COLLINEAR: f64 = 1e-4;
/// Shares of a side that differ by less are equal.
const SAME_SHARE: f64 = 1e-6;

/// Replaces the outlines of lanes by centre lines. A lane without one keeps the centre of its outline as a single point.
pub(crate) fn derive_center_lines(map: &mut Map, lanes: &[usize], notes: &mut Vec<Note>) {
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
        notes.push(Note::Other(format!(
            "centre lines are derived from the polygons of {}: lane {}",
            count(derived.len()),
            names(&derived)
        )));
    }
    if !failed.is_empty() {
        notes.push(Note::Other(format!(
            "no centre line fits the polygons of {}, which have none: lane {}",
            count(failed.len()),
            names(&failed)
        )));
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
    let (Some(start), Some(end), Some(links)) =
        (start_of(lane), end_of(lane), map.features[lane].lane.as_deref())
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

/// An outline without the points on the straight line between their neighbours.
fn without_collinear(ring: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let mut kept: Vec<[f64; 3]> = Vec::with_capacity(ring.len());
    for (k, point) in ring.iter().enumerate() {
        let next = ring[(k + 1) % ring.len()];
        let is_on_line = kept.last().is_some_and(|last| {
            let (chord, to) = ([0, 1, 2].map(|x| next[x] - last[x]), [0, 1, 2].map(|x| point[x] - last[x]));
            let [c2, ct] = [chord, to].map(|v| (0..3).map(|x| chord[x] * v[x]).sum::<f64>());
            let share = if c2 > 0.0 { ct / c2 } else { 0.0 };
            let off = (0..3).map(|x| (to[x] - share * chord[x]).powi(2)).sum::<f64>();
            (0.0..=1.0).contains(&share) && off <= COLLINEAR * COLLINEAR
        });
        if !is_on_line {
            kept.push(*point);
        }
    }
    kept
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
        if ring.len() > MOST {
            ring = without_collinear(&ring);
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
        let pairs: Vec<[[f64; 3]; 2]> =
            shares.iter().map(|share| [left.at(*share), right.at(*share)]).collect();
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
            let apart = misfit(ring, &along, [behind, ahead]);
            if best.is_none_or(|(least, _)| apart < least * (1.0 - 1e-6)) {
                best = Some((apart, [behind, ahead]));
            }
        }
    }
    best.map(|(_, ends)| ends)
}

/// How badly a pair of ends fits, metres: mean distance of the two sides at equal shares of their lengths, and half of
/// what it varies by.
fn misfit(ring: &[[f64; 3]], along: &[f64], [behind, ahead]: [usize; 2]) -> f64 {
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
    // Not at the ends: a short edge there says nothing of the width.
    let apart: [f64; PLACES] = std::array::from_fn(|k| {
        let share = (k as f64 + 0.5) / PLACES as f64;
        distance(at(first + share * lengths[0]), at(second - share * lengths[1]))
    });
    let (least, most) = apart.iter().fold((f64::MAX, 0.0f64), |(l, m), x| (l.min(*x), m.max(*x)));
    apart.iter().sum::<f64>() / PLACES as f64 + 0.5 * (most - least)
}

/// The sides between two ends, both along the order of the points of the first side.
fn sides(ring: &[[f64; 3]], [behind, ahead]: [usize; 2]) -> [Side; 2] {
    let n = ring.len();
    let first = (0..(ahead + n - behind) % n).map(|k| ring[(behind + 1 + k) % n]).collect();
    let second = (ahead + 1..=behind).rev().map(|k| ring[k]).collect();
    [Side::new(first), Side::new(second)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::scene::{MapFeature, MapKind};

    fn ring(points: &[[f64; 2]]) -> Vec<[f64; 3]> {
        points.iter().map(|[x, y]| [*x, *y, 0.0]).collect()
    }

    /// An outline from two sides that both lead along the lane.
    fn outline(left: &[[f64; 2]], right: &[[f64; 2]]) -> Vec<[f64; 3]> {
        ring(&left.iter().chain(right.iter().rev()).copied().collect::<Vec<_>>())
    }

    fn straight(y: f64, length: f64, step: f64) -> Vec<[f64; 2]> {
        let count = (length / step).round() as i32;
        (0..=count).map(|k| [f64::from(k) * length / f64::from(count), y]).collect()
    }

    /// A quarter of a circle around the origin, counter-clockwise from the x axis.
    fn quarter(radius: f64, count: i32) -> Vec<[f64; 2]> {
        let angle = |k: i32| std::f64::consts::FRAC_PI_2 * f64::from(k) / f64::from(count);
        (0..=count).map(|k| [radius * angle(k).cos(), radius * angle(k).sin()]).collect()
    }

    fn rotated(mut points: Vec<[f64; 3]>, by: usize) -> Vec<[f64; 3]> {
        points.rotate_left(by);
        points
    }

    fn closed(mut points: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
        points.push(points[0]);
        points
    }

    /// Largest distance of the line's points from what they must lie on.
    fn error(line: &[[f64; 3]], off: impl Fn(Point) -> f64) -> f64 {
        line.iter().map(|p| off(plane(*p)).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn straight_lanes_have_their_centre_line() {
        let (left, right) = (straight(0.0, 400.0, 2.0), straight(-3.5, 400.0, 2.0));
        let dense = outline(&left, &right);
        let coarse = outline(&straight(0.0, 400.0, 400.0), &straight(-3.5, 400.0, 400.0));
        let mixed = outline(&left, &straight(-3.5, 400.0, 50.0));
        let mut backwards = dense.clone();
        backwards.reverse();
        let round_end =
            outline(&left, &[&right[..], &[[401.0, -2.6], [401.3, -1.75], [401.0, -0.9]]].concat());
        let cases = [
            ("dense", dense.clone()),
            ("closed", closed(dense.clone())),
            ("four corners", coarse.clone()),
            ("four corners, closed", closed(coarse)),
            ("other steps", mixed),
            (
                "more points than are searched",
                outline(&straight(0.0, 400.0, 0.5), &straight(-3.5, 400.0, 0.5)),
            ),
            ("rotated by 1", rotated(dense.clone(), 1)),
            ("rotated by 77", rotated(dense.clone(), 77)),
            ("rotated to the other side", rotated(dense.clone(), 201)),
            ("rotated by 300 and closed", closed(rotated(dense.clone(), 300))),
            ("backwards", backwards),
            ("every point twice", dense.iter().flat_map(|p| [*p, *p]).collect()),
            ("a round end", round_end),
        ];
        for (name, outline) in cases {
            let found = CenterLine::of(&outline).unwrap_or_else(|| panic!("{name}: none"));
            let xs: Vec<f64> = found.line.iter().map(|p| p[0]).collect();
            let (low, high) = xs.iter().fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(*x), h.max(*x)));
            let is_sharp = name != "a round end";
            if is_sharp {
                assert!(error(&found.line, |p| p[1] + 1.75) < 1e-9, "{name}");
                assert_eq!((low, high), (0.0, 400.0), "{name}");
                assert!(found.widths.iter().all(|width| (width - 3.5).abs() < 1e-9), "{name}");
            } else {
                assert!(
                    error(&found.line, |p| p[1] + 1.75) < 1.0 && high > 398.0 && low < 2.0,
                    "{name} {low} {high}"
                );
            }
            let is_forward = xs.windows(2).all(|pair| pair[1] > pair[0]);
            let is_backward = xs.windows(2).all(|pair| pair[1] < pair[0]);
            assert!(is_forward || is_backward, "{name}");
        }
        let forward = CenterLine::of(&dense).unwrap().line;
        assert_eq!((forward[0], forward.len()), ([0.0, -1.75, 0.0], 201));
    }

    #[test]
    fn curved_and_tapered_lanes_have_their_centre_line() {
        for (inner, count, other) in
            [(8.0, 20, 20), (8.0, 20, 33), (3.0, 16, 16), (50.0, 60, 40), (20.0, 30, 30)]
        {
            let outline = outline(&quarter(inner, count), &quarter(inner + 3.5, other));
            for outline in [outline.clone(), closed(outline.clone()), rotated(outline, 7)] {
                let found = CenterLine::of(&outline).unwrap_or_else(|| panic!("{inner} {count}: none"));
                let off = error(&found.line, |p| p[0].hypot(p[1]) - (inner + 1.75));
                assert!(off < 0.1, "{inner} {count} {other}: {off}");
            }
        }
        // From 3 m to 5 m wide, and an S of two lines.
        let taper = outline(&[[0.0, 1.5], [60.0, 2.5]], &[[0.0, -1.5], [60.0, -2.5]]);
        let found = CenterLine::of(&taper).unwrap();
        assert!(error(&found.line, |p| p[1]) < 1e-9 && found.widths[0] == 3.0 && found.widths[1] == 5.0);
        let bent = |y: f64| [[0.0, y], [20.0, y], [30.0, y + 3.0], [50.0, y + 3.0]];
        let found = CenterLine::of(&outline(&bent(1.75), &bent(-1.75))).unwrap();
        assert_eq!(found.line.first().zip(found.line.last()), Some((&[0.0, 0.0, 0.0], &[50.0, 3.0, 0.0])));
    }

    #[test]
    fn what_is_no_lane_has_no_centre_line() {
        let big = outline(&straight(0.0, 100.0, 2.0), &straight(-30.0, 100.0, 2.0));
        for (name, outline) in [
            ("a point", ring(&[[0.0, 0.0]])),
            ("two points", ring(&[[0.0, 0.0], [9.0, 0.0]])),
            ("a triangle", ring(&[[0.0, 0.0], [9.0, 0.0], [0.0, 3.0]])),
            ("one place", ring(&[[1.0, 1.0]; 9])),
            (
                "a square",
                ring(&[[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0], [0.0, 0.0]])
                    .iter()
                    .map(|p| [p[0], 1.3 * p[1], 0.0])
                    .take(3)
                    .collect(),
            ),
            ("a place of 30 m", big),
            ("too many corners", outline(&quarter(90.0, 400), &quarter(93.5, 400))),
        ] {
            assert!(CenterLine::of(&outline).is_none(), "{name}");
        }
    }

    #[test]
    fn the_lanes_around_say_which_way_a_lane_leads() {
        let lane = |id: &str, points: std::ops::Range<usize>, lane: Lane| MapFeature {
            id: id.to_owned(),
            kind: MapKind::LaneSurfaceStreet,
            points,
            lane: Some(Box::new(lane)),
        };
        let mut points = outline(&straight(0.0, 20.0, 2.0), &straight(-3.5, 20.0, 2.0));
        let n = points.len();
        // The next lane begins where the outline does.
        points.extend([[0.0, -1.75, 0.0], [-20.0, -1.75, 0.0]]);
        let square = ring(&[[50.0, 0.0], [52.0, 0.0], [51.0, 1.0]]);
        points.extend(&square);
        let own = Lane { exits: vec![1], ..Lane::default() };
        let features = vec![
            lane("own", 0..n, own),
            lane("next", n..n + 2, Lane::default()),
            lane("odd", n + 2..n + 5, Lane::default()),
        ];
        let mut map = Map { points, features };
        let mut notes = Vec::new();
        derive_center_lines(&mut map, &[0, 2], &mut notes);
        let line = map.points_of(&map.features[0]);
        assert_eq!((line[0], line[line.len() - 1]), ([20.0, -1.75, 0.0], [0.0, -1.75, 0.0]));
        assert_eq!(map.features[0].lane.as_deref().unwrap().width.len(), line.len());
        assert_eq!(map.points_of(&map.features[1]), [[0.0, -1.75, 0.0], [-20.0, -1.75, 0.0]]);
        assert_eq!(map.points_of(&map.features[2]), [[51.0, 1.0 / 3.0, 0.0]]);
        assert!(
            notes.len() == 2 && notes[0].text().contains("`own`") && notes[1].text().contains("`odd`"),
            "{notes:?}"
        );
    }
}
