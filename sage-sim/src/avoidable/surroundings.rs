//! What the ego must not touch: the others as recorded, the adversary on its plan, edges and medians.

use std::sync::Arc;

use sage_core::{
    geometry::{Aabb, OrientedBox, Point, SweptBox, boxes_meet_between, sub},
    motion::NOW,
    objective::Context,
    scene::{Hitch, LEVEL_GAP, SceneIndex, is_one_level},
};

use crate::fault::is_behind;

/// The ego's box is grown by this on each side, metres, so that other simulators agree that nothing touches.
pub(super) const MARGIN: f64 = 1e-3;

/// A road user's boxes at two steps in a row.
pub(super) struct Moving {
    /// Index of its track.
    pub(super) track: usize,
    from: OrientedBox,
    to: OrientedBox,
    bounds: Aabb,
}

impl Moving {
    fn new(track: usize, from: OrientedBox, to: OrientedBox) -> Self {
        let bounds = from.aabb().union(&to.aabb());
        Self { track, from, to, bounds }
    }

    /// Whether it meets a moving box.
    fn meets(&self, pair: [&OrientedBox; 2], bounds: &Aabb) -> bool {
        self.bounds.meets(bounds) && boxes_meet_between(pair, [&self.from, &self.to])
    }
}

/// Everything but the adversary, prepared once for all its plans.
pub(super) struct Surroundings {
    index: Arc<SceneIndex>,
    /// Those that move, or stand, between step k − 1 and step k, at k − 1.
    others: Vec<Vec<Moving>>,
    /// Height of the ground under the ego, by step; `None` on a map with one level.
    ground: Option<Vec<f64>>,
}

/// What an ego touches first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Obstacle {
    Adversary,
    /// The index of a track.
    Other(usize),
    Edge,
}

/// What a rollout remembers of its way.
#[derive(Clone, Default)]
pub(super) struct Passed {
    /// Segments of edges that the box touched at the start and has not left yet.
    leaving: Vec<usize>,
    /// Tracks that ran into the ego from behind.
    pub(super) from_behind: Vec<usize>,
}

impl Surroundings {
    pub(super) fn new(ctx: &Context) -> Self {
        let (scene, index) = (ctx.scene(), ctx.index());
        let ego = scene.ego();
        let last = (0..=NOW + ctx.horizon()).rev().find(|&f| ego.is_valid(f)).unwrap_or(NOW);
        let level = |step: usize| {
            let frame = (NOW..=(NOW + step).min(last)).rev().find(|&f| ego.is_valid(f)).unwrap_or(NOW);
            ego.ground(frame)
        };
        let ground: Vec<f64> = (0..=ctx.horizon()).map(level).collect();
        let mut others: Vec<Vec<Moving>> = (0..ctx.horizon()).map(|_| Vec::new()).collect();
        let trailer = Hitch::of(scene, scene.ego).map(|hitch| hitch.trailer);
        for other in ctx.others().iter().filter(|other| Some(other.track) != trailer) {
            let track = &scene.tracks[other.track];
            for (k, list) in others.iter_mut().enumerate() {
                let Some(to) = other.at(k + 1) else { continue };
                if !is_one_level(track.ground(NOW + k + 1), ground[k + 1]) {
                    continue;
                }
                list.push(Moving::new(other.track, *other.at(k).unwrap_or(to), *to));
            }
        }
        let ground = index.has_levels(LEVEL_GAP).then_some(ground);
        Self { index: index.clone(), others, ground }
    }

    /// The memory of a rollout that starts with a box, after some ran into the ego from behind.
    pub(super) fn passed(&self, start: &OrientedBox, from_behind: Vec<usize>) -> Passed {
        let edges = self.index.edges();
        let bounds = start.aabb();
        let touched = edges.near(&bounds).flatten().filter(|&k| {
            let segment = &edges.segments()[k];
            start.intersects_segment(segment.a, segment.b)
        });
        Passed { leaving: touched.collect(), from_behind }
    }

    /// What the ego touches on its way to a step, if anything. Contacts from behind with others than the adversary
    /// are noted in `passed` instead. `rear` is the distance of the rear axle behind the centre.
    pub(super) fn touched(
        &self,
        step: usize,
        pair: [&OrientedBox; 2],
        adversary: &[Moving],
        rear: f64,
        passed: &mut Passed,
    ) -> Option<Obstacle> {
        let bounds = pair[0].aabb().union(&pair[1].aabb());
        let user = self.met(step, pair, &bounds, adversary, rear, passed);
        user.or_else(|| self.touches_edge(step, pair, &bounds, passed).then_some(Obstacle::Edge))
    }

    /// The same for road users alone.
    pub(super) fn met(
        &self,
        step: usize,
        pair: [&OrientedBox; 2],
        bounds: &Aabb,
        adversary: &[Moving],
        rear: f64,
        passed: &mut Passed,
    ) -> Option<Obstacle> {
        if adversary[step - 1].meets(pair, bounds) {
            return Some(Obstacle::Adversary);
        }
        for other in &self.others[step - 1] {
            if other.meets(pair, bounds) && !passed.from_behind.contains(&other.track) {
                if is_behind(pair[1], rear, other.to.center) {
                    passed.from_behind.push(other.track);
                } else {
                    return Some(Obstacle::Other(other.track));
                }
            }
        }
        None
    }

    fn touches_edge(&self, step: usize, pair: [&OrientedBox; 2], bounds: &Aabb, passed: &mut Passed) -> bool {
        let edges = self.index.edges();
        if !passed.leaving.is_empty() {
            let touches = |k: &usize| {
                let segment = &edges.segments()[*k];
                pair[0].intersects_segment(segment.a, segment.b)
            };
            passed.leaving.retain(touches);
        }
        let mut sweep = None;
        edges.near(bounds).flatten().any(|k| {
            let segment = &edges.segments()[k];
            segment.aabb().meets(bounds)
                && !passed.leaving.contains(&k)
                && self.is_level(step, pair[1].center, segment)
                && sweep
                    .get_or_insert_with(|| SweptBox::between(pair[0], pair[1]))
                    .intersects_segment(segment.a, segment.b)
        })
    }

    fn is_level(&self, step: usize, p: Point, segment: &sage_core::geometry::Segment) -> bool {
        self.ground
            .as_ref()
            .is_none_or(|ground| is_one_level(segment.height(segment.nearest_share(p)), ground[step]))
    }

    /// Whether a straight full brake after the last step stays free for two seconds, if all others keep their
    /// velocities.
    pub(super) fn recovers(
        &self,
        [before, last]: [&OrientedBox; 2],
        speed: f64,
        brake: f64,
        adversary: &[Moving],
        passed: &Passed,
    ) -> bool {
        const STEPS: usize = 20;
        let mut own = (*before, *last, speed);
        let final_step = adversary.len() - 1;
        let mut others: Vec<(OrientedBox, OrientedBox)> = self.others[final_step]
            .iter()
            .filter(|other| !passed.from_behind.contains(&other.track))
            .chain([&adversary[final_step]])
            .filter(|other| !other.bounds.is_empty())
            .map(|other| (other.from, other.to))
            .collect();
        let moved = |area: &OrientedBox, by: Point| OrientedBox {
            center: [area.center[0] + by[0], area.center[1] + by[1]],
            ..*area
        };
        for _ in 0..STEPS {
            let next_speed = (own.2 - 0.1 * brake).max(0.0);
            let length = 0.05 * (own.2 + next_speed);
            let next = moved(&own.1, own.1.axis.map(|x| x * length));
            own = (own.1, next, next_speed);
            for (from, to) in &mut others {
                let velocity = sub(to.center, from.center);
                (*from, *to) = (*to, moved(to, velocity));
                if boxes_meet_between([&own.0, &own.1], [from, to]) {
                    return false;
                }
            }
        }
        true
    }
}

/// The adversary's boxes between all steps; the first begins where it is *now*. At a step at which it is on another level it
/// meets nobody.
pub(super) fn plan(
    track: usize,
    now: OrientedBox,
    boxes: &[OrientedBox],
    is_level: impl Fn(usize) -> bool,
) -> Vec<Moving> {
    let from = std::iter::once(&now).chain(boxes);
    let moving = from.zip(boxes).map(|(from, to)| Moving::new(track, *from, *to)).zip(1..);
    let met = |(moving, step)| if is_level(step) { moving } else { Moving { bounds: Aabb::EMPTY, ..moving } };
    moving.map(met).collect()
}
