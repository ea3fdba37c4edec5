//! Whether a learner could have avoided a contact with the adversary: only then does the contact count as its failure.

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

/// Whether the driver could have evaded a contact with the adversary.
pub(super) fn is_shown_avoidable(scene: &SimScene, plan: &Plan, motions: &[Motion], step: usize) -> bool {
    let drive = Drive { motions: motions.to_vec(), ..Drive::default() };
    let search = || -> Option<bool> {
        let recorded = Arc::new(drive.recorded(scene.scene()));
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
