//! Which attack an episode of a training meets.

use std::sync::Arc;

use sage_core::seed::Rng;
use sage_sim::{Error, attacker::Attacker, evaluation::drive_episode, traffic::Plan};

use super::{EpisodeRecord, Training};
use crate::{running_episode::Attack, training_state::KeptAttack};

impl Training<'_> {
    /// The attack of the next episode of a scene, and its plan: the scene's newest one until enough episodes have met it,
    /// then a new one.
    pub(super) fn attack(
        &mut self,
        attacker: &dyn Attacker,
        scene: usize,
        lambda: f64,
        coin: &mut Rng,
        world: u64,
    ) -> Result<(Attack, Arc<Plan>), Error> {
        let on = &self.setting.scenes[scene];
        let most = self.options.renew_attack_after;
        if let Some(kept) = self.state.attacks.get_mut(&scene).filter(|kept| kept.episodes < most) {
            kept.episodes += 1;
            let plan = match &kept.plan {
                Some(plan) => plan.clone(),
                None => kept.plan.insert(kept.attack.plan(on, attacker)?).clone(),
            };
            return Ok((kept.attack.clone(), plan));
        }
        let attack = self.new_attack(attacker, scene, lambda, coin, world)?;
        let plan = attack.plan(on, attacker)?;
        if most > 1 {
            let kept = KeptAttack { attack: attack.clone(), episodes: 1, plan: Some(plan.clone()) };
            self.state.attacks.insert(scene, kept);
        }
        Ok((attack, plan))
    }

    /// The plan of a recorded episode, if it is attacked.
    pub(super) fn plan_of(&self, record: &EpisodeRecord) -> Result<Option<Arc<Plan>>, Error> {
        let attacked = record.attack.as_ref().zip(self.setting.attacker);
        attacked
            .map(|(attack, attacker)| attack.plan(&self.setting.scenes[record.scene], attacker))
            .transpose()
    }

    /// The attack on the newest drives, or the one that a search with the policy of this moment finds.
    fn new_attack(
        &mut self,
        attacker: &dyn Attacker,
        scene: usize,
        lambda: f64,
        coin: &mut Rng,
        world: u64,
    ) -> Result<Attack, Error> {
        if let Some(attack) = self.searched(attacker, scene, lambda, world)? {
            return Ok(attack);
        }
        self.refresh(scene, world)?;
        let stored = &self.state.drives[scene];
        let drawn = stored.get(coin.below(stored.len()));
        let driven_at = drawn.map(|stored| stored.step);
        let drive = drawn.map(|stored| stored.motions.clone());
        Ok(Attack { lambda, seed: coin.bits(), drive, driven_at, found: None })
    }

    /// The attack that a search with the policy of this moment finds, if the attacker searches.
    fn searched(
        &self,
        attacker: &dyn Attacker,
        scene: usize,
        lambda: f64,
        seed: u64,
    ) -> Result<Option<Attack>, Error> {
        if !self.state.learner.has_learnt(self.state.counters.steps) {
            return Ok(None);
        }
        let attack = Attack { lambda, seed, drive: None, driven_at: None, found: None };
        let found = attacker.searched(&self.policy(), &self.setting.scenes[scene], &attack.point(), seed);
        Ok(found.transpose()?.map(|found| Attack { found: Some(found), ..attack }))
    }

    /// Lets the present policy drive a scene whose newest drive is too old, and stores its drive.
    fn refresh(&mut self, scene: usize, world: u64) -> Result<(), Error> {
        let Some(limit) = self.options.refresh_after else { return Ok(()) };
        let steps = self.state.counters.steps;
        let is_fresh = self.state.drives[scene].front().is_some_and(|drive| steps - drive.step <= limit);
        if is_fresh || !self.state.learner.has_learnt(steps) {
            return Ok(());
        }
        let (_, drive) =
            drive_episode(&self.policy(), &self.setting.scenes[scene], None, &self.rules, world)?;
        self.store(scene, drive.motions);
        Ok(())
    }

    /// Counts an attack of an episode that has begun.
    pub(super) fn count_attack(&mut self, attack: &Attack) {
        let counters = &mut self.state.counters;
        counters.attacked += 1;
        if attack.found.is_some() {
            return;
        }
        match attack.driven_at {
            Some(step) => {
                let age = counters.steps.saturating_sub(step);
                counters.drive_age = counters.drive_age.saturating_add(age);
            }
            None => counters.without_drive += 1,
        }
    }
}
