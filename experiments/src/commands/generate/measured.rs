//! What is measured of a scene's attacks.

use std::sync::Arc;

use anyhow::Result;
use sage_core::{
    generator::Attack,
    objective::Context,
    registry::Entry as _,
    scene::{Scene, SceneIndex},
};
use sage_sim::{
    SimScene, attack_test,
    avoidable::Avoidable,
    policy::{EgoPolicy, R157, R157Options},
};

use super::scored::ScoredCandidates;
use crate::selection_outcome::{CandidateCounts, SelectionOutcome};

/// An attack with what came of it.
pub(super) struct MeasuredAttack<'a> {
    pub(super) attack: &'a Attack,
    /// Step of the contact.
    pub(super) contact: Option<usize>,
    pub(super) avoidable: Avoidable,
    pub(super) r157_avoids: Option<bool>,
    pub(super) outcome: SelectionOutcome,
    pub(super) counts: CandidateCounts,
}

/// Measures all attacks of a scene.
///
/// *Errors*: an attack that is not one on this scene.
pub(super) fn measured<'a>(
    attacks: &'a [Attack],
    scored: &mut ScoredCandidates,
    ctx: &Context,
    seed: u64,
) -> Result<Vec<MeasuredAttack<'a>>> {
    let mut r157 = None;
    let measure = |attack: &'a Attack| {
        attack.check(ctx.scene())?;
        scored.score(attack)?;
        let contact = scored.get(attack.trajectory())?.scores.collision_step;
        let r157_avoids = contact.and_then(|_| {
            let driver = r157.get_or_insert_with(|| R157Driver::new(ctx.scene(), ctx.index()));
            driver.avoids(attack, seed)
        });
        let (outcome, counts) = scored.outcome(attack)?;
        let avoidable = scored.avoidable(attack.trajectory())?;
        Ok(MeasuredAttack { attack, contact, avoidable, r157_avoids, outcome, counts })
    };
    attacks.iter().map(measure).collect()
}

/// The UN R157 driver in a scene; without what cannot be simulated.
struct R157Driver {
    scene: Option<Arc<SimScene>>,
    driver: Option<Box<dyn EgoPolicy>>,
}

impl R157Driver {
    fn new(scene: &Arc<Scene>, index: &Arc<SceneIndex>) -> Self {
        let scene = SimScene::new(scene.clone(), index.clone()).ok();
        Self { scene, driver: R157::build(R157Options::default()).ok() }
    }

    /// Whether it avoids an attack; `None` if it meets another road user first, or cannot drive.
    fn avoids(&self, attack: &Attack, seed: u64) -> Option<bool> {
        attack_test::avoids(self.driver.as_deref()?, self.scene.as_ref()?, attack.trajectory(), seed).ok()?
    }
}
