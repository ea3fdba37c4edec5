//! Drivers in one scene: each drives it unchanged, and then against the attacks of every generator.

use std::sync::Arc;

use anyhow::Result;
use sage_core::{objective::Objective, scene::SceneData};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    avoidable::{Avoidable, AvoidanceOptions},
    unattacked::UnattackedDrive,
};

use super::closed_loop::Driven;
use crate::{ego::Ego, generators::BuiltGenerator};

/// A driver in one scene.
pub(crate) struct TestedDriver {
    pub(crate) scene: String,
    pub(crate) unattacked: UnattackedDrive,
    /// For each generator and operating point, the attack on this driver; empty in scenes without an adversary.
    pub(crate) attacks: Vec<Attacked>,
    /// Why there are no attacks, if they failed; true if the scene is left out, because nothing can be measured in it.
    pub(crate) failed: Option<(bool, String)>,
}

/// An attack on a driver.
pub(crate) struct Attacked {
    pub(crate) driven: Driven,
    /// Whether the driver had a way out; `None` if the attack does not work.
    pub(crate) avoidable: Option<Avoidable>,
    /// As in [`UnattackedDrive`], in the attacked drive.
    pub(crate) over_red: Option<Vec<usize>>,
}

/// What attacks the drivers.
pub(crate) struct Attackers<'a> {
    pub(crate) generators: &'a [BuiltGenerator],
    /// Its feasibility rule decides whether an attack counts.
    pub(crate) objective: &'a Objective,
    pub(crate) search: AvoidanceOptions,
    pub(crate) seed: u64,
}

/// A driver in a scene, unchanged and under all attacks.
///
/// *Errors*: the driver cannot drive in the scene.
pub(crate) fn test(
    data: &SceneData,
    scene: &Arc<SimScene>,
    ego: &Ego,
    attackers: Option<&Attackers>,
    seed: u64,
) -> Result<TestedDriver> {
    let test = AttackTest::new(&*ego.policy, scene, seed)?;
    let attackers = attackers.filter(|_| data.scene.adversary.is_some());
    let (attacks, failed) = match attackers.map(|attackers| attackers.attack(&test)) {
        None => (Vec::new(), None),
        Some(Ok(attacks)) => (attacks, None),
        Some(Err(error)) => {
            let is_left_out = matches!(error.downcast_ref(), Some(sage_core::Error::ContactNow { .. }));
            (Vec::new(), Some((is_left_out, format!("{error:#}"))))
        }
    };
    Ok(TestedDriver { scene: data.name.clone(), unattacked: test.unattacked_drive(), attacks, failed })
}

impl Attackers<'_> {
    /// The attacks of all generators on the drive of a driver, and what it does against each.
    fn attack(&self, test: &AttackTest) -> Result<Vec<Attacked>> {
        test.scene().check_apart_now()?;
        let ctx = test.context()?;
        let mut all = Vec::new();
        for built in self.generators {
            for attack in built.generator.attacks(&ctx, &built.points, self.seed)? {
                attack.check(ctx.scene())?;
                let trajectory = attack.trajectory();
                let candidate = ctx.candidate(trajectory.clone());
                let is_feasible = self.objective.evaluate(&candidate, &ctx).is_feasible();
                let outcome = test.attack(trajectory, is_feasible)?;
                all.push(Attacked {
                    driven: Driven::of(&outcome, &ctx),
                    avoidable: outcome.avoidable(self.search)?,
                    over_red: outcome.over_red(),
                });
            }
        }
        Ok(all)
    }
}
