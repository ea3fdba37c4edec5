//! Map segments of one kind, indexed by a tree of bounds.
//!
//! A tree over single segments takes parry 10 ms to build for 20 000 of them. Each leaf therefore holds a
//! run of [`RUN`] successive segments of one polyline. This gives an eighth of the leaves, and the segments
//! of a run are contiguous in memory for the exact tests.
//!
//! The bounds of a long diagonal segment intersect many queries that are far from it. Runs longer than
//! [`LONG`] are therefore indexed by leaves of short segment parts. Thousands of parallel diagonals then
//! cost no more than those near the query.

use std::ops::Range;

use parry2d_f64::partitioning::{Bvh, BvhBuildStrategy};

use super::{Aabb, Point, cross, dot, norm, sub};

/// Segments per leaf.
const RUN: usize = 8;
/// Longest run per leaf, and longest part of a segment, metres. Runs of recorded maps reach 155 m.
const LONG: f64 = 200.0;
/// Largest number of parts; above it, parts become longer.
const MAX_PARTS: f64 = 250e3;
/// Margin of the bounds of a part, metres: larger than any rounding error.
const SLACK: f64 = 1e-6;

/// One straight segment of a polyline.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// Start, metres.
    pub a: Point,
    /// End, metres.
    pub b: Point,
    /// Heights of start and end, metres.
    pub z: [f64; 2],
    /// Index of its map feature.
    pub feature: u32,
    /// Whether the polyline continues before `a` and after `b`.
    pub joined: [bool; 2],
}

impl Segment {
    /// Bounds of the segment.
    #[inline]
    pub fn aabb(&self) -> Aabb {
        Aabb {
            min: [self.a[0].min(self.b[0]), self.a[1].min(self.b[1])],
            max: [self.a[0].max(self.b[0]), self.a[1].max(self.b[1])],
        }
    }

    /// Fraction of the segment, from `a` to `b`, at which it is nearest to `p`, in [0, 1].
    #[inline]
    pub fn nearest_share(&self, p: Point) -> f64 {
        let d = sub(self.b, self.a);
        let length2 = dot(d, d);
        if length2 > 0.0 { (dot(sub(p, self.a), d) / length2).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// The point at a fraction of the segment.
    #[inline]
    pub fn at(&self, share: f64) -> Point {
        let d = sub(self.b, self.a);
        [self.a[0] + share * d[0], self.a[1] + share * d[1]]
    }

    /// Height at a fraction of the segment, metres.
    #[inline]
    pub fn height(&self, share: f64) -> f64 {
        self.z[0] + share * (self.z[1] - self.z[0])
    }

    /// Whether a straight step shares a point with the segment, which is not parallel to it.
    pub fn meets(&self, [from, to]: [Point; 2]) -> bool {
        let are_beside = |a: Point, b: Point, p: Point, q: Point| {
            let way = sub(b, a);
            cross(way, sub(p, a)) * cross(way, sub(q, a)) <= 0.0
        };
        are_beside(from, to, self.a, self.b) && are_beside(self.a, self.b, from, to)
    }

    /// Bounds of the parts of the segment, each at most `length` long.
    fn parts(self, length: f64) -> impl Iterator<Item = Aabb> {
        let count = (norm(sub(self.b, self.a)) / length).ceil().max(1.0);
        (0..count as usize).map(move |k| {
            let [from, to] = [k, k + 1].map(|k| Aabb::around(self.at(k as f64 / count), SLACK));
            from.union(&to)
        })
    }

    /// Unit direction; zero for a segment without length.
    fn direction(&self) -> Point {
        let d = sub(self.b, self.a);
        let length = norm(d);
        if length > 0.0 { [d[0] / length, d[1] / length] } else { [0.0, 0.0] }
    }
}

/// The point of an index nearest to a query point.
#[derive(Clone, Copy, Debug)]
pub struct Nearest {
    /// Index of the segment in [`SegmentIndex::segments`].
    pub segment: usize,
    /// Fraction along that segment, in [0, 1].
    pub share: f64,
    /// Distance, metres.
    pub distance: f64,
}

/// Side of a directed polyline on which a point lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Left of it, or on it.
    Left,
    /// Right of it.
    Right,
}

/// Segments of many polylines with a tree of bounds.
pub struct SegmentIndex {
    segments: Vec<Segment>,
    runs: Vec<Range<u32>>,
    tree: Bvh,
    /// Whether a run may be indexed by several leaves.
    is_cut: bool,
}

impl SegmentIndex {
    /// Index of polylines given as (feature, points with height). Polylines of fewer than two points are
    /// skipped.
    pub fn build<'a>(polylines: impl IntoIterator<Item = (u32, &'a [[f64; 3]])>) -> Self {
        let mut segments = Vec::new();
        let mut runs = Vec::new();
        let mut bounds = Vec::new();
        let mut is_cut = false;
        for (feature, points) in polylines {
            let first = segments.len();
            let last = points.len().saturating_sub(2);
            segments.extend(points.windows(2).enumerate().map(|(k, pair)| Segment {
                a: [pair[0][0], pair[0][1]],
                b: [pair[1][0], pair[1][1]],
                z: [pair[0][2], pair[1][2]],
                feature,
                joined: [k > 0, k < last],
            }));
            for start in (first..segments.len()).step_by(RUN) {
                let end = (start + RUN).min(segments.len());
                let all = bounds_of(&segments[start..end]);
                is_cut |= is_long(&all);
                runs.push(start as u32..end as u32);
                bounds.push(all.to_parry());
            }
        }
        if is_cut {
            let leaves = leaves_of_parts(&segments, runs);
            (runs, bounds) = leaves.map(|(run, all)| (run, all.to_parry())).unzip();
        }
        let tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &bounds);
        Self { segments, runs, tree, is_cut }
    }

    /// All segments, polyline after polyline.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Runs of segments whose bounds meet `bounds`.
    pub fn near<'a>(&'a self, bounds: &Aabb) -> impl Iterator<Item = Range<usize>> + use<'a> {
        let bounds = bounds.to_parry();
        let mut leaves: Vec<u32> =
            if self.runs.is_empty() { Vec::new() } else { self.tree.intersect_aabb(&bounds).collect() };
        if self.is_cut {
            // Sorting brings the leaves of one segment together.
            leaves.sort_unstable();
            leaves.dedup_by_key(|leaf| self.runs[*leaf as usize].start);
        }
        leaves.into_iter().map(|leaf| {
            let run = &self.runs[leaf as usize];
            run.start as usize..run.end as usize
        })
    }

    /// The nearest accepted point within `reach` metres of `p`; ties go to the earlier segment.
    pub fn nearest(&self, p: Point, reach: f64, accept: impl Fn(&Segment) -> bool) -> Option<Nearest> {
        self.nearest_of(p, reach, accept, |_| true)
    }

    /// The same, as long as `may_look` says so of the number of segments that are looked at next; `None` from then on.
    pub fn nearest_of(
        &self,
        p: Point,
        reach: f64,
        accept: impl Fn(&Segment) -> bool,
        mut may_look: impl FnMut(usize) -> bool,
    ) -> Option<Nearest> {
        let mut radius = reach.min(2.0);
        loop {
            // Squared until the end: most segments in the radius are not the nearest.
            let mut least = radius * radius;
            let mut best: Option<(usize, f64)> = None;
            for run in self.near(&Aabb::around(p, radius)) {
                if !may_look(run.len()) {
                    return None;
                }
                for segment in run {
                    let candidate = &self.segments[segment];
                    let share = candidate.nearest_share(p);
                    let away = sub(p, candidate.at(share));
                    let squared = dot(away, away);
                    let is_first = || best.is_none_or(|(other, _)| segment < other);
                    if (squared < least || (squared == least && is_first())) && accept(candidate) {
                        (least, best) = (squared, Some((segment, share)));
                    }
                }
            }
            if let Some((segment, share)) = best {
                return Some(Nearest { segment, share, distance: least.sqrt() });
            }
            if radius >= reach {
                return None;
            }
            radius = (2.0 * radius).min(reach);
        }
    }

    /// Side of the polyline of `nearest` on which `p` lies. `None` at an open end of a polyline, where the
    /// side is undefined.
    pub fn side(&self, p: Point, nearest: &Nearest) -> Option<Side> {
        let segment = &self.segments[nearest.segment];
        let [before, after] = segment.joined;
        let mut direction = segment.direction();
        // At a joint the two segments may disagree; their mean direction decides.
        let neighbour = match nearest.share {
            s if s <= 0.0 => Some((before, nearest.segment.wrapping_sub(1))),
            s if s >= 1.0 => Some((after, nearest.segment + 1)),
            _ => None,
        };
        match neighbour {
            Some((false, _)) => return None,
            Some((true, other)) => {
                let d = self.segments[other].direction();
                direction = [direction[0] + d[0], direction[1] + d[1]];
            }
            None => {}
        }
        let out = cross(direction, sub(p, segment.at(nearest.share)));
        Some(if out >= 0.0 { Side::Left } else { Side::Right })
    }
}

fn bounds_of(segments: &[Segment]) -> Aabb {
    segments.iter().fold(Aabb::EMPTY, |all, segment| all.union(&segment.aabb()))
}

fn is_long(bounds: &Aabb) -> bool {
    (0..2).any(|k| bounds.max[k] - bounds.min[k] > LONG)
}

/// Leaves for runs. Long runs are cut into parts of their segments.
fn leaves_of_parts(segments: &[Segment], runs: Vec<Range<u32>>) -> impl Iterator<Item = (Range<u32>, Aabb)> {
    let total: f64 = segments.iter().map(|s| norm(sub(s.b, s.a))).sum();
    let length = LONG.max(total / MAX_PARTS);
    runs.into_iter().flat_map(move |run| {
        let all = bounds_of(&segments[run.start as usize..run.end as usize]);
        let is_long = is_long(&all);
        let parts = is_long.then(|| {
            run.clone()
                .flat_map(move |k| segments[k as usize].parts(length).map(move |bounds| (k..k + 1, bounds)))
        });
        parts.into_iter().flatten().chain((!is_long).then_some((run, all)))
    })
}

#[cfg(test)]
mod tests {
    use super::{
        super::{OrientedBox, distance},
        *,
    };
    use crate::seed::Rng;

    #[test]
    fn queries_find_what_a_scan_of_all_segments_finds() {
        let mut rng = Rng::new(3, "segments", "queries");
        let polylines: Vec<Vec<[f64; 3]>> = (0..40)
            .map(|_| {
                let mut p = [rng.uniform(-100.0, 100.0), rng.uniform(-100.0, 100.0), 0.0];
                (0..30)
                    .map(|_| {
                        p = [p[0] + rng.uniform(-2.0, 2.0), p[1] + rng.uniform(-2.0, 2.0), 0.0];
                        p
                    })
                    .collect()
            })
            .collect();
        let index = SegmentIndex::build(polylines.iter().enumerate().map(|(k, p)| (k as u32, &p[..])));
        assert_eq!(index.segments().len(), 40 * 29);
        for _ in 0..500 {
            let p = [rng.uniform(-110.0, 110.0), rng.uniform(-110.0, 110.0)];
            let scan = index
                .segments()
                .iter()
                .map(|s| distance(p, s.at(s.nearest_share(p))))
                .fold(f64::INFINITY, f64::min);
            match index.nearest(p, 30.0, |_| true) {
                Some(found) => assert_eq!(found.distance, scan),
                None => assert!(scan > 30.0),
            }
            let bounds = Aabb::around(p, 3.0);
            let mut found: Vec<usize> = index
                .near(&bounds)
                .flatten()
                .filter(|&k| index.segments()[k].aabb().meets(&bounds))
                .collect();
            found.sort_unstable();
            let all: Vec<usize> =
                (0..index.segments().len()).filter(|&k| index.segments()[k].aabb().meets(&bounds)).collect();
            assert_eq!(found, all);
        }
    }

    #[test]
    fn long_segments_are_found_once_and_only_near_them() {
        let mut rng = Rng::new(3, "segments", "long");
        let lines: Vec<[[f64; 3]; 2]> = (0..200)
            .map(|_| [0, 1].map(|_| [rng.uniform(-900.0, 900.0), rng.uniform(-900.0, 900.0), 0.0]))
            .collect();
        let index = SegmentIndex::build(lines.iter().enumerate().map(|(k, line)| (k as u32, &line[..])));
        for _ in 0..500 {
            let car =
                OrientedBox::new([rng.uniform(-900.0, 900.0), rng.uniform(-900.0, 900.0)], 0.5, 40.0, 30.0);
            let touched = |k: &usize| {
                let segment = &index.segments()[*k];
                car.intersects_segment(segment.a, segment.b)
            };
            let near: Vec<usize> = index.near(&car.aabb()).flatten().collect();
            assert!(near.len() < 100, "{} of 200", near.len());
            assert!((0..200).filter(touched).eq(near.into_iter().filter(touched)));
        }
    }

    #[test]
    fn sides_follow_the_direction_of_the_polyline_and_open_ends_have_none() {
        let points = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0]];
        let index = SegmentIndex::build([(0, &points[..])]);
        let side = |p| index.nearest(p, 50.0, |_| true).and_then(|n| index.side(p, &n));
        assert_eq!(side([5.0, 1.0]), Some(Side::Left));
        assert_eq!(side([5.0, -1.0]), Some(Side::Right));
        assert_eq!(side([11.0, -1.0]), Some(Side::Right), "outside the corner");
        assert_eq!(side([-1.0, 0.5]), None, "before the start");
        assert_eq!(side([9.0, 12.0]), None, "beyond the end");
    }

    #[test]
    fn an_index_of_nothing_finds_nothing() {
        let index = SegmentIndex::build([(0, &[[1.0, 2.0, 3.0]][..])]);
        assert!(index.nearest([0.0, 0.0], 1e6, |_| true).is_none());
        assert_eq!(index.near(&Aabb::around([0.0, 0.0], 10.0)).count(), 0);
    }
}
