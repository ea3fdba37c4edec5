//! Whether an episode counts as a success of the learner.

use std::sync::Arc;

use sage_core::{
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions},
};

use crate::{
    avoidable::{Avoidance, AvoidanceOptions},
    drive::Drive,
    scene::SimScene,
    traffic::Plan,
    vehicle::Motion,
};

/// Completion of a success.
const COMPLETED: f64 = 0.8;

/// Whether an episode is a success: no contact with the adversary, and 80 % of the route. `touched` is the step of the first contact
/// with the adversary. `None` for a contact that is not shown avoidable, which counts as neither.
pub fn success(
    scene: &SimScene,
    plan: Option<&Plan>,
    motions: &[Motion],
    touched: Option<usize>,
    completion: f64,
) -> Option<bool> {
    match (plan, touched) {
        (Some(plan), Some(step)) if !is_shown_avoidable(scene, plan, motions, step) => None,
        _ => Some(touched.is_none() && completion >= COMPLETED),
    }
}

/// Whether the driver could have evaded a contact with the adversary.
fn is_shown_avoidable(scene: &SimScene, plan: &Plan, motions: &[Motion], step: usize) -> bool {
    let drive = Drive::of_motions(motions.to_vec());
    let search = || -> Option<bool> {
        let recorded = Arc::new(drive.scene_as_driven(scene));
        let ctx = Context::new(&recorded, scene.index(), &ContextOptions::default()).ok()?;
        // Beyond the recording nothing is scored.
        let last = plan.motion.valid.len() - 1;
        let points = (NOW + 1..=NOW + HORIZON).map(|frame| plan.motion.point(frame.min(last))).collect();
        let trajectory = Trajectory::new("plan", points).ok()?;
        let avoidance = Avoidance::new(&ctx, AvoidanceOptions::default()).ok()?;
        avoidance.of_contact(&ctx.candidate(trajectory), step.checked_sub(NOW)).avoidable
    };
    search() == Some(true)
}
