//! Height of the ground under a path, which says on which level of a map with bridges it is.

use std::sync::{Arc, OnceLock};

use crate::{
    geometry::Point,
    scene::{LEVEL_GAP, SceneIndex},
};

/// Height of the ground under each step of a path, computed when two boxes first meet in the plane.
#[derive(Clone)]
pub(super) struct Ground {
    index: Arc<SceneIndex>,
    known: Known,
    heights: OnceLock<Vec<f64>>,
}

/// What is known of the heights, metres.
#[derive(Clone)]
enum Known {
    /// At *now*: from there the path follows the lanes of its level.
    Now(f64),
    /// As recorded, from *now* on.
    Recorded(Arc<[f64]>),
}

impl Ground {
    /// The ground under a path that is at a height *now*.
    pub(super) fn from_now(index: &Arc<SceneIndex>, now: f64) -> Self {
        Self { index: index.clone(), known: Known::Now(now), heights: OnceLock::new() }
    }

    /// The ground under a recorded path, from step 0 (*now*) on.
    pub(super) fn recorded(index: &Arc<SceneIndex>, heights: Arc<[f64]>) -> Self {
        Self { index: index.clone(), known: Known::Recorded(heights), heights: OnceLock::new() }
    }

    /// Height at a step of a path, 0 (*now*) to its end; `None` on a map with one level, and beyond the end. `path` gives the
    /// positions from step 1 on.
    pub(super) fn at<P: Iterator<Item = Point>>(&self, step: usize, path: impl FnOnce() -> P) -> Option<f64> {
        if !self.index.has_levels(LEVEL_GAP) {
            return None;
        }
        match &self.known {
            Known::Recorded(heights) => heights.get(step).copied(),
            Known::Now(now) => {
                let follow = || {
                    let followed = path().scan(*now, |level, p| {
                        *level = self.index.follow_ground(p, *level, LEVEL_GAP);
                        Some(*level)
                    });
                    std::iter::once(*now).chain(followed).collect()
                };
                self.heights.get_or_init(follow).get(step).copied()
            }
        }
    }
}
