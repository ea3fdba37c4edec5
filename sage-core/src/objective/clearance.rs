//! Missing distance to road edges, medians and other road users, with a gradient.
//!
//! Discs cover the adversary and the others. Of each step the disc counts that misses most. On maps with levels
//! what is on another one does not count.

use super::{Context, DifferentiableReward, PoseGradient};
use crate::{
    geometry::{Aabb, Point, norm, sub},
    motion::{NOW, Pose},
    scene::{LEVEL_GAP, is_one_level},
};

/// Places of the adversary's discs along its axis, by its length.
const OWN: [f64; 5] = [-0.38, -0.19, 0.0, 0.19, 0.38];
/// Places of another's discs along its axis, by its length.
const THEIRS: [f64; 3] = [-0.33, 0.0, 0.33];
/// Radius of the discs by the width.
const RADIUS: f64 = 0.55;

/// Metres that are missing to a distance from edges and others, summed over the steps.
#[derive(Clone, Copy, Debug)]
pub struct Clearance {
    /// Distance that is kept beyond the discs, metres.
    pub space: f64,
}

impl Default for Clearance {
    fn default() -> Self {
        Self { space: 0.3 }
    }
}

/// The place that misses most at a step: metres, place on the axis, metres, and direction away from what is near.
struct Missing {
    metres: f64,
    place: f64,
    away: Point,
}

impl DifferentiableReward for Clearance {
    fn name(&self) -> &str {
        "clearance"
    }

    fn value(&self, poses: &[Pose], ctx: &Context, gradient: &mut PoseGradient) -> f64 {
        let mut value = 0.0;
        let mut level = ctx.level_now();
        for (k, pose) in poses.iter().enumerate() {
            level = level.map(|before| ctx.index().follow_ground(pose.position, before, LEVEL_GAP));
            let (sin, cos) = pose.heading.sin_cos();
            for missing in
                [self.missing_to_edges(pose, level, ctx), self.missing_to_others(pose, k + 1, level, ctx)]
                    .into_iter()
                    .flatten()
            {
                value += missing.metres;
                let away = missing.away;
                gradient.position[k][0] -= away[0];
                gradient.position[k][1] -= away[1];
                gradient.heading[k] -= missing.place * (away[1] * cos - away[0] * sin);
            }
        }
        value
    }
}

impl Clearance {
    /// Centres of the adversary's discs with their places on the axis, and their radius.
    fn discs(pose: &Pose, [length, width]: [f64; 2]) -> ([(f64, Point); 5], f64) {
        let (sin, cos) = pose.heading.sin_cos();
        let [x, y] = pose.position;
        let disc = |share: f64| {
            let place = share * length;
            (place, [x + place * cos, y + place * sin])
        };
        (OWN.map(disc), RADIUS * width)
    }

    fn missing_to_edges(&self, pose: &Pose, level: Option<f64>, ctx: &Context) -> Option<Missing> {
        let (discs, radius) = Self::discs(pose, ctx.size());
        let (reach, edges) = (radius + self.space, ctx.index().edges());
        let all = discs.iter().fold(Aabb::EMPTY, |all, (_, p)| all.union(&Aabb::around(*p, reach)));
        let mut worst: Option<Missing> = None;
        for k in edges.near(&all).flatten() {
            let segment = &edges.segments()[k];
            let height = || segment.height(segment.nearest_share(pose.position));
            if level.is_some_and(|level| !is_one_level(level, height())) {
                continue;
            }
            for (place, p) in discs {
                let d = sub(p, segment.at(segment.nearest_share(p)));
                worst = worse(worst, reach, place, d);
            }
        }
        worst
    }

    fn missing_to_others(
        &self,
        pose: &Pose,
        step: usize,
        level: Option<f64>,
        ctx: &Context,
    ) -> Option<Missing> {
        let (size, mut worst) = (ctx.size(), None);
        let (discs, radius) = Self::discs(pose, size);
        for other in ctx.others() {
            let Some(area) = other.at(step) else { continue };
            let height = || ctx.scene().tracks[other.track].ground(NOW + step);
            if level.is_some_and(|level| !is_one_level(level, height())) {
                continue;
            }
            let reach = radius + 2.0 * RADIUS * area.half_width + self.space;
            let apart = sub(pose.position, area.center);
            let farthest = reach + 0.5 * size[0] + area.half_length;
            if apart[0].abs() > farthest || apart[1].abs() > farthest {
                continue;
            }
            for share in THEIRS {
                let there = 2.0 * share * area.half_length;
                let center = [area.center[0] + there * area.axis[0], area.center[1] + there * area.axis[1]];
                for (place, p) in discs {
                    worst = worse(worst, reach, place, sub(p, center));
                }
            }
        }
        worst
    }
}

/// The worse of two places; `d` points away from what is near.
fn worse(worst: Option<Missing>, reach: f64, place: f64, d: Point) -> Option<Missing> {
    let apart = norm(d);
    let metres = reach - apart;
    if metres <= worst.as_ref().map_or(0.0, |worst| worst.metres) {
        return worst;
    }
    let away = if apart > 1e-9 { d.map(|x| x / apart) } else { [0.0; 2] };
    Some(Missing { metres, place, away })
}
