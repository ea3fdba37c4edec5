//! Attacks on a driver: the driver records the unchanged scene, the attack is planned against that drive, and
//! the driver drives again.

use std::sync::Arc;

use anyhow::Result;
use sage_core::{
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Convention, Encounter, release_reward},
    scene::{Scene, SceneData},
};
use sage_sim::{
    SimScene,
    avoidable::{Avoidable, Avoidance, AvoidanceOptions},
    drive::Drive,
    episode::{Episode, EpisodeContact, Verdict},
    red_lights::over_red,
    traffic::Plan,
};
use serde::{Deserialize, Serialize};

use super::tested_drivers::{Attacked, until_contact};
use crate::{contact_row::ContactRow, ego::Ego};

/// Result of one attack on a driver.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Driven {
    /// Whether the attack works.
    pub verdict: Verdict,
    /// The ego's first contact, if any.
    pub contact: Option<ContactRow>,
    /// Progress along the logged route by its length, until the end; `None` if the route is short.
    pub completion: Option<f64>,
    /// The paper's adversarial reward with the contact of the simulation.
    pub reward: f64,
    /// The published reward: the ego's path is cut at its end, so a contact scores little.
    pub reward_cut: f64,
}

/// A driver in one scene, with its drive before the attack.
pub(crate) struct DriverUnderTest<'a> {
    ego: &'a Ego,
    scene: Arc<SimScene>,
    seed: u64,
    unattacked: Drive,
}

impl<'a> DriverUnderTest<'a> {
    /// Drives the unchanged scene.
    ///
    /// *Errors*: the policy cannot drive in this scene.
    pub(crate) fn new(ego: &'a Ego, scene: &Arc<SimScene>, seed: u64) -> Result<Self> {
        Ok(Self::after(ego, scene, seed, ego.unattacked(scene, seed)?))
    }

    /// A driver that has driven the unchanged scene.
    pub(crate) fn after(ego: &'a Ego, scene: &Arc<SimScene>, seed: u64, unattacked: Drive) -> Self {
        Self { ego, scene: scene.clone(), seed, unattacked }
    }

    /// The scene in which the ego's recording is the drive before the attack.
    pub(crate) fn data(&self, data: &SceneData) -> SceneData {
        self.ego.recorded_data(data, &self.unattacked)
    }

    /// Drives again, against an attack. `ctx` is of [`DriverUnderTest::data`].
    ///
    /// *Errors*: as [`Episode::run`].
    pub(crate) fn attack(&self, attack: &Trajectory, is_feasible: bool, ctx: &Context) -> Result<Driven> {
        self.result(&self.episode(attack)?, attack, is_feasible, ctx)
    }

    /// The same, with runs over red, and with the search for an evasive manoeuvre in the attacked drive.
    ///
    /// *Errors*: as [`Episode::run`], and [`Avoidance::new`].
    pub(crate) fn attack_and_search(
        &self,
        attack: &Trajectory,
        is_feasible: bool,
        ctx: &Context,
        search: AvoidanceOptions,
    ) -> Result<Attacked> {
        let episode = self.episode(attack)?;
        let driven = self.result(&episode, attack, is_feasible, ctx)?;
        let contact = episode.contacts.first().filter(|_| driven.verdict.attack);
        let way_out = |contact: &EpisodeContact| -> Result<Avoidable> {
            let attacked: Arc<Scene> = episode.drive.recorded(self.scene.scene()).into();
            let ctx = Context::new(&attacked, self.scene.index(), &ContextOptions::default())?;
            let step = contact.contact.step.checked_sub(NOW);
            Ok(Avoidance::new(&ctx, search)?.of_contact(&ctx.candidate(attack.clone()), step))
        };
        let avoidable = contact.map(way_out).transpose()?;
        let over_red = over_red(&self.scene, until_contact(&episode.drive));
        Ok(Attacked { driven, avoidable, over_red })
    }

    fn episode(&self, attack: &Trajectory) -> Result<Episode> {
        let plan = Arc::new(Plan::of_adversary(self.scene.scene(), attack)?);
        Ok(Episode::run(&self.scene, Some(plan), &*self.ego.policy, self.seed)?)
    }

    fn result(
        &self,
        episode: &Episode,
        attack: &Trajectory,
        is_feasible: bool,
        ctx: &Context,
    ) -> Result<Driven> {
        let scene = self.scene.scene();
        let adversary = scene.adversary_index()?;
        let first = episode.first_contacts().next();
        Ok(Driven {
            verdict: episode.verdict(adversary, is_feasible, &self.unattacked),
            completion: episode.completion,
            reward: reward(episode, adversary, attack),
            reward_cut: reward_cut(episode, attack, ctx),
            contact: first.map(|contact| ContactRow::of(contact, scene)),
        })
    }
}

/// The paper's reward: 10 (1 − t/80) at a contact with the adversary, else closeness. The horizon stays 80
/// steps, although the episode ends at the contact.
fn reward(episode: &Episode, adversary: usize, attack: &Trajectory) -> f64 {
    let hit = episode.first_contacts().find(|c| c.contact.other.track == adversary);
    let path = episode.drive.motions.iter().skip(NOW + 1);
    let distances = path.zip(attack.points()).map(|(motion, p)| {
        let [x, y] = motion.position;
        (x - p[0]).hypot(y - p[1])
    });
    let contact = hit.map(|c| c.contact.step.saturating_sub(NOW)).filter(|step| *step > 0);
    let least_distance = distances.fold(f64::INFINITY, f64::min);
    Encounter { contact, least_distance, steps: HORIZON }.reward(Convention::Paper)
}

/// The published reward of the positions up to the end of the episode.
fn reward_cut(episode: &Episode, attack: &Trajectory, ctx: &Context) -> f64 {
    let path: Vec<_> = episode.drive.motions.iter().skip(NOW + 1).map(|motion| motion.position).collect();
    release_reward(attack.points(), ctx.size(), &path, ctx.ego_size()).0
}
