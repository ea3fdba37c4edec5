//! The registries of all parts that attack, drive and train.

use sage_backbones::{Backbone, backbones};
use sage_core::{
    Error,
    objective::{self, Feasibility, Reward},
    registry::Registry,
};
use sage_generators::{GeneratorKind, generators};
use sage_learn::{SceneSampler, curricula::curricula, scene_sampler::scene_samplers};
use sage_merging::{Merger, mergers};
use sage_sim::{
    avoidable::LatestStart,
    curriculum::Curriculum,
    environment::{DrivingReward, reward::driving_rewards},
    policy::{EgoPolicy, policies},
};

/// Registries of the parts that are accepted by name.
///
/// ```
/// use advsage::Registries;
///
/// let registries = Registries::of_attacks()?;
/// // A program that attacks and drives needs no part that trains drivers.
/// assert!(registries.policies.get("idm").is_ok() && registries.curricula.entries().is_empty());
/// let error = registries.policies.get("idn").err().map(|error| error.to_string()).unwrap_or_default();
/// assert!(error.starts_with("unknown policy `idn`; known: replay, idm, "));
/// # Ok::<(), advsage::Error>(())
/// ```
pub struct Registries {
    /// Rewards and penalties.
    pub rewards: Registry<dyn Reward>,
    /// Feasibility rules.
    pub feasibilities: Registry<dyn Feasibility>,
    /// Motion prediction networks.
    pub backbones: Registry<dyn Backbone>,
    /// Methods of merging experts.
    pub mergers: Registry<dyn Merger>,
    /// Generators of adversarial scenes.
    pub generators: Registry<dyn GeneratorKind>,
    /// Driving policies.
    pub policies: Registry<dyn EgoPolicy>,
    /// Curricula of closed-loop training.
    pub curricula: Registry<dyn Curriculum>,
    /// Scene samplers of closed-loop training.
    pub scene_samplers: Registry<dyn SceneSampler>,
    /// Rewards of a driver in training.
    pub driving_rewards: Registry<dyn DrivingReward>,
}

impl Registries {
    /// All parts that `sage` ships.
    ///
    /// *Errors*: [`Error::Duplicate`] if two parts of a kind have the same name.
    pub fn shipped() -> Result<Self, Error> {
        Ok(Self {
            curricula: curricula()?,
            scene_samplers: scene_samplers()?,
            driving_rewards: driving_rewards()?,
            ..Self::of_attacks()?
        })
    }

    /// The parts that attack and drive, without what trains drivers. A program that needs no others is smaller.
    ///
    /// *Errors*: as [`Registries::shipped`].
    pub fn of_attacks() -> Result<Self, Error> {
        let (rewards, generators) = (objective::rewards()?.with::<LatestStart>()?, generators()?);
        #[cfg(feature = "baselines")]
        let (rewards, generators) =
            (rewards.with::<crate::LearnedCriticality>()?, sage_baselines::with_baselines(generators)?);
        Ok(Self {
            rewards,
            feasibilities: objective::feasibilities()?,
            backbones: backbones()?,
            mergers: mergers()?,
            generators,
            policies: policies()?,
            curricula: Registry::new("curriculum"),
            scene_samplers: Registry::new("scene sampler"),
            driving_rewards: Registry::new("driving reward"),
        })
    }
}
