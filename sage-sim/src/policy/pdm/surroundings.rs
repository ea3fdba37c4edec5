//! Edges and lanes around all driven proposals, gathered once a step: the drives are near each other, and a search for
//! each step of each drive costs more than the tests themselves.

use sage_core::geometry::{Aabb, OrientedBox, Segment, SegmentIndex, SweptBox, distance, dot, norm, sub};

use crate::policy::View;

/// Space to edges, metres: half their width in the simulation, and what the tyres may miss.
const EDGE_SPACE: f64 = 0.2;
/// Metres against the traffic: below the first nothing happens, below the second the factor is a half, then 0.
const AGAINST: [f64; 2] = [2.0, 6.0];
/// Half the width of a lane in the test of its direction, metres: stated widths are distances to the next boundary.
const HALF_LANE: f64 = 1.85;
/// Cosine of the angle from which a lane counts as opposite (120°).
const OPPOSITE: f64 = -0.5;
/// Steps that look for edges and lanes together.
const CHUNK: usize = 8;
/// Distance by which bounds may be wrong without any effect, metres: far more than rounding.
const SLACK: f64 = 0.01;

/// Successive segments of a polyline, as the index holds them.
#[derive(Clone, Copy)]
struct Run<'a> {
    bounds: Aabb,
    segments: &'a [Segment],
}

/// Runs of an index whose bounds meet others.
fn runs<'a>(index: &'a SegmentIndex, around: &Aabb) -> Vec<Run<'a>> {
    let run = |range| {
        let segments: &[Segment] = &index.segments()[range];
        let bounds = segments.iter().fold(Aabb::EMPTY, |all, segment| all.union(&segment.aabb()));
        Run { bounds, segments }
    };
    index.near(around).map(run).collect()
}

/// Those of some runs whose bounds meet others.
fn near<'a>(runs: &[Run<'a>], around: &Aabb, found: &mut Vec<Run<'a>>) {
    found.clear();
    found.extend(runs.iter().filter(|run| run.bounds.meets(around)));
}

/// What is around the drives of a step.
pub(super) struct Surroundings<'a> {
    view: &'a View<'a>,
    edges: Vec<Run<'a>>,
    lanes: Vec<Run<'a>>,
    /// Edges (map features) that are nearer at the start than the space, and those that are touched there.
    at_start: [Vec<u32>; 2],
}

impl<'a> Surroundings<'a> {
    /// What is around drives that have common bounds and start with a box.
    pub(super) fn new(view: &'a View<'a>, start: &OrientedBox, bounds: &Aabb) -> Self {
        let (index, around) = (view.index(), bounds.grown(HALF_LANE));
        let edges = runs(index.edges(), &around);
        let features_at = |area: &OrientedBox| -> Vec<u32> {
            let bounds = area.aabb();
            let touched = edges.iter().filter(|run| run.bounds.meets(&bounds)).flat_map(|run| run.segments);
            touched.filter(|s| area.intersects_segment(s.a, s.b)).map(|s| s.feature).collect()
        };
        let at_start = [features_at(&grown(start)), features_at(start)];
        Self { view, edges, lanes: runs(index.motor_lanes(), &around), at_start }
    }

    /// Whether a drive, box by box, touches an edge or median. One that is nearer than the space at the start must only
    /// not be touched; one that is touched there does not count.
    pub(super) fn touches_edge(&self, areas: &[OrientedBox]) -> bool {
        let [at_start, touched] = &self.at_start;
        let wide: Vec<OrientedBox> = areas.iter().map(grown).collect();
        let bounds: Vec<Aabb> = wide.iter().map(OrientedBox::aabb).collect();
        let mut close = Vec::new();
        (1..areas.len()).any(|step| {
            if (step - 1) % CHUNK == 0 {
                let all = bounds[step - 1..].iter().take(CHUNK + 1);
                near(&self.edges, &all.fold(Aabb::EMPTY, |all, one| all.union(one)), &mut close);
            }
            let around = bounds[step - 1].union(&bounds[step]);
            let met = close.iter().filter(|run| run.bounds.meets(&around)).flat_map(|run| run.segments);
            // A sweep stays in the bounds of its ends.
            let within = around.grown(SLACK);
            let mut met = met.filter(|segment| segment.aabb().meets(&within)).peekable();
            if met.peek().is_none() {
                return false;
            }
            let sweep = SweptBox::between(&wide[step - 1], &wide[step]);
            let narrow = SweptBox::between(&areas[step - 1], &areas[step]);
            met.any(|segment| {
                let sweep = if at_start.contains(&segment.feature) { &narrow } else { &sweep };
                sweep.intersects_segment(segment.a, segment.b)
                    && self.view.is_level(segment.height(0.5))
                    && !touched.contains(&segment.feature)
            })
        })
    }

    /// Factor of driving against the traffic.
    pub(super) fn direction(&self, areas: &[OrientedBox]) -> f64 {
        if !self.may_be_against(areas) {
            return 1.0;
        }
        let (mut run, mut longest) = (0.0, 0.0f64);
        for pair in areas.windows(2) {
            let way = distance(pair[0].center, pair[1].center);
            // A car that stands keeps its run.
            if way > 0.0 {
                run = if self.is_against(&pair[1]) { run + way } else { 0.0 };
                longest = longest.max(run);
            }
        }
        match longest {
            l if l < AGAINST[0] => 1.0,
            l if l < AGAINST[1] => 0.5,
            _ => 0.0,
        }
    }

    /// Whether a drive may go against the traffic for long enough to count. Only the places are looked at that end a way
    /// of this length: where none of them is against the traffic, no run between them is as long.
    fn may_be_against(&self, areas: &[OrientedBox]) -> bool {
        let mut way = 0.0;
        areas.windows(2).any(|pair| {
            way += distance(pair[0].center, pair[1].center);
            if way < AGAINST[0] {
                return false;
            }
            way = 0.0;
            self.is_against(&pair[1])
        })
    }

    /// Whether the centre is in a lane of the opposite direction and in none of its own.
    fn is_against(&self, own: &OrientedBox) -> bool {
        let around = Aabb::around(own.center, HALF_LANE);
        let within = around.grown(SLACK);
        let met = self.lanes.iter().filter(|run| run.bounds.meets(&around)).flat_map(|run| run.segments);
        let mut is_opposite = false;
        for segment in met.filter(|segment| segment.aabb().meets(&within)) {
            let away = sub(own.center, segment.at(segment.nearest_share(own.center)));
            if dot(away, away) <= HALF_LANE * HALF_LANE {
                let direction = sub(segment.b, segment.a);
                let along = dot(direction, own.axis);
                if along >= 0.0 {
                    return false;
                }
                is_opposite |= along < OPPOSITE * norm(direction);
            }
        }
        is_opposite
    }
}

/// A box with the space that it keeps to edges.
fn grown(area: &OrientedBox) -> OrientedBox {
    OrientedBox {
        half_length: area.half_length + EDGE_SPACE,
        half_width: area.half_width + EDGE_SPACE,
        ..*area
    }
}
