//! Converts candidates to drawings with their first contact with the ego.

use sage_core::{
    motion::Trajectory,
    objective::{Context, Situation},
};

use super::DrawnPath;

/// The drawing of a candidate.
pub fn drawn_path(name: String, ctx: &Context, trajectory: Trajectory) -> DrawnPath {
    let candidate = ctx.candidate(trajectory);
    let contact = Situation::new(&candidate, ctx.ego(), ctx).encounter.contact.and_then(|step| {
        let ego = ctx.ego().box_at(step)?;
        Some((step, *ego, candidate.boxes()[step - 1]))
    });
    // What lies beyond the recording is not scored.
    let points = std::iter::once(candidate.start().position).chain(candidate.points().iter().copied());
    DrawnPath { name, points: points.collect(), contact }
}
