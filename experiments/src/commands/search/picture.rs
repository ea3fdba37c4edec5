//! The picture of a scene's search: all plans by outcome, the failures in front.

use sage_core::{objective::Context, scene::Scene};
use sage_sim::search::{Pool, SearchResult};

use crate::drawing::{self, DrawnPath, Picture};

/// Draws the failures as candidates.
pub(super) fn draw(title: &str, scene: &Scene, ctx: &Context, pool: &Pool, result: &SearchResult) -> String {
    let drawn = result.failures.iter().map(|failure| {
        let judged = &result.driven[failure.drive];
        let plan = &pool.plans[judged.plan];
        DrawnPath {
            name: format!("drive {}", failure.drive + 1),
            points: std::iter::once(plan.candidate.start().position)
                .chain(plan.candidate.points().iter().copied())
                .collect(),
            contact: None,
        }
    });
    let _ = ctx;
    drawing::draw(scene, &Picture { title: title.to_owned(), candidates: drawn.collect(), ..Picture::default() })
}
