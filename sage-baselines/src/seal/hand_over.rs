//! When the learned driver takes over: some steps before the plan hits the ego's path.

use sage_core::{
    geometry::{Point, distance},
    motion::NOW,
    objective::Context,
};
use sage_generators::selector::{STRIDE, boxes, edges_cross};

/// Step, from 0, at which a plan hits the ego's path among every fifth one: the first at which edges of the boxes cross, else
/// that of the least distance of the centres. The first path of the ego counts.
pub(super) fn planned_hit(plan: &[Point], ctx: &Context) -> usize {
    let adversary = boxes(plan, ctx.size());
    let ego = boxes(ctx.ego().positions(), ctx.ego_size());
    let crossing = adversary.iter().zip(&ego).position(|(a, b)| edges_cross(a, b));
    let gaps = adversary.iter().zip(&ego).map(|(a, b)| distance(a.center, b.center)).enumerate();
    let nearest = || gaps.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k);
    STRIDE * crossing.or_else(nearest).unwrap_or(0)
}

/// Frame at which the driver takes over for a hit at a step: its first action comes `before_hit` + 1 steps before the frame
/// of the hit, and never before *now*.
pub(super) fn frame(hit: usize, before_hit: Option<usize>) -> usize {
    let of_hit = NOW + 1 + hit;
    before_hit.map_or(NOW, |steps| of_hit.saturating_sub(steps + 1).max(NOW))
}

#[cfg(test)]
mod tests {
    use super::frame;

    #[test]
    fn the_driver_takes_over_eleven_frames_before_the_hit_and_never_before_now() {
        // Frame 11 + 25 of the hit, less 10 + 1.
        assert_eq!(frame(25, Some(10)), 25);
        assert_eq!(frame(0, Some(10)), 10);
        assert_eq!(frame(40, Some(0)), 50);
        assert_eq!(frame(40, None), 10);
    }
}
