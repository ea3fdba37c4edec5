//! An attacker for trainings: the policy of the moment drives against several plans of a generator, and the attack is one at which the
//! policy is at fault. [`crate::searched_attacker`] searches once for all failures of a driver that stays the same.

use std::sync::Arc;

use sage_core::{generator::OperatingPoint, motion::Trajectory};
use sage_sim::{
    Error, SimScene,
    attack_test::AttackTest,
    attacker::Attacker,
    drive::Drive,
    policy::EgoPolicy,
    search::{Clause, Hooks, MOST_PLANS, Pool, Requirement, SearchOptions, search},
    traffic::Plan,
};

use crate::{generators::BuiltGenerator, selection::Selection};

/// A generator whose plans are searched with the driver in the loop.
pub struct DriverSearch {
    generator: BuiltGenerator,
    rule: Selection,
    options: SearchOptions,
}

impl DriverSearch {
    /// A search of at most `drives` attacked drives a scene, up to the first plan at which the driver is at fault. `rule` says
    /// which plans are feasible. A drive is that of `sage search`: not mirrored, with the default car and parked cars, and it does
    /// not end at arrival. Plans are not refined, so training costs what its drives cost.
    pub fn new(generator: BuiltGenerator, rule: Selection, drives: usize) -> Self {
        // What a driver is at fault at is worth learning, avoidable or not.
        let require = Requirement::of(&[Clause::Believable, Clause::AtFault]);
        let options =
            SearchOptions { budget: drives, first: true, require, refine: 0.0, ..SearchOptions::default() };
        Self { generator, rule, options }
    }

    /// The plan that the search found; else the strongest; of a scene without a feasible plan the one that the generator selects.
    fn found(
        &self,
        policy: &dyn EgoPolicy,
        scene: &Arc<SimScene>,
        at: &OperatingPoint,
        seed: u64,
    ) -> Result<Trajectory, Error> {
        scene.scene().attackable_horizon()?;
        let test = AttackTest::new(policy, scene, seed)?;
        let ctx = test.context()?;
        let attack = self.generator.attack_at(&ctx, at, seed)?;
        if attack.reaction.is_some() {
            // What it does is known only when it is driven; that is then its plan.
            return Ok(test.path_of(&attack)?.trajectory);
        }
        let rule = self.rule.objective.rule();
        let chosen = attack.candidates[attack.chosen].trajectory.clone();
        let mut pool = Pool::new(&ctx, rule, vec![attack.candidates], MOST_PLANS);
        let result = search(&test, &ctx, rule, &mut pool, &self.options, seed, Hooks::default())?;
        let worst = result.worst().map(|failure| &result.driven[failure.drive]);
        let best = worst.or_else(|| result.strongest()).map(|evaluated| evaluated.plan);
        Ok(best.map_or(chosen, |plan| pool.plans[plan].candidate.trajectory().clone()))
    }
}

impl Attacker for DriverSearch {
    /// What the generator selects: before the driver has learnt anything there is nothing to search.
    fn plan(
        &self,
        scene: &SimScene,
        drive: Option<&Drive>,
        at: &OperatingPoint,
        seed: u64,
    ) -> Result<Arc<Plan>, Error> {
        self.generator.plan(scene, drive, at, seed)
    }

    fn searched(
        &self,
        policy: &dyn EgoPolicy,
        scene: &Arc<SimScene>,
        at: &OperatingPoint,
        seed: u64,
    ) -> Option<Result<Trajectory, Error>> {
        Some(self.found(policy, scene, at, seed))
    }
}
