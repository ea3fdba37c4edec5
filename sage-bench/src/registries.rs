//! The registries of all parts that commands and studies name.

use sage_backbones::{
    Backbone, backbones,
    metrics::{PolicyMeasures, policy_metrics, prediction_metrics},
    prediction::Distances,
};
use sage_core::{
    Error,
    metric::{MeasuredTrajectory, Metrics, trajectory_metrics},
    objective::{self, Feasibility, Reward},
    registry::Registry,
};
use sage_generators::{GeneratorKind, generators};
use sage_merging::{Merger, mergers};
use sage_sim::{
    avoidable::{Avoidable, LatestStart},
    environment::{DrivingReward, reward::driving_rewards},
    metrics::{MeasuredAttack, attack_metrics, avoidable_metrics, drive_metrics, episode_metrics},
    policy::{EgoPolicy, policies},
    rl::{Curriculum, EpisodeRow, SceneSampler, curriculum::curricula, scene_sampler::scene_samplers},
    search::{
        MeasuredSearch, MeasuredThreshold, MeasuredTransfer, search_metrics, threshold_metrics,
        transfer_metrics,
    },
    unattacked::UnattackedDrive,
};
use theory_checks::{Check, claims};

use crate::{LearnedCriticality, study::SHIPPED};

/// Registries of the parts that commands accept by name.
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
    /// Claims of the theory.
    pub claims: Registry<dyn Check>,
    /// Metrics of all kinds of results.
    pub metrics: MetricRegistries,
    /// Studies: name and file (YAML).
    pub studies: Vec<(&'static str, &'static str)>,
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
            claims: claims()?,
            metrics: MetricRegistries::shipped()?,
            studies: SHIPPED.to_vec(),
            ..Self::of_attacks()?
        })
    }

    /// The parts that attack and drive: without studies and their metrics, claims, and what trains drivers. A program that
    /// needs no others is a seventh smaller.
    ///
    /// *Errors*: as [`Registries::shipped`].
    pub fn of_attacks() -> Result<Self, Error> {
        Ok(Self {
            rewards: objective::rewards()?.with::<LatestStart>()?.with::<LearnedCriticality>()?,
            feasibilities: objective::feasibilities()?,
            backbones: backbones()?,
            mergers: mergers()?,
            generators: generators()?,
            policies: policies()?,
            curricula: Registry::new("curriculum"),
            scene_samplers: Registry::new("scene sampler"),
            driving_rewards: Registry::new("driving reward"),
            claims: Registry::new("claim"),
            metrics: MetricRegistries::default(),
            studies: Vec::new(),
        })
    }
}

/// Metrics by what they are of.
#[derive(Default)]
pub struct MetricRegistries {
    /// Of the adversary's trajectory against one path of the ego.
    pub trajectory: Metrics<MeasuredTrajectory>,
    /// Of the evasive manoeuvres from that path, over the attacks.
    pub avoidable: Metrics<Avoidable>,
    /// Of a policy without selection: expectations over its candidates.
    pub policy: Metrics<PolicyMeasures>,
    /// Of a driver in the unchanged scene.
    pub drive: Metrics<UnattackedDrive>,
    /// Of an attack on a driver.
    pub attack: Metrics<MeasuredAttack>,
    /// Of an episode of the published evaluation.
    pub episode: Metrics<EpisodeRow>,
    /// Of the predictions of a vehicle.
    pub prediction: Metrics<Distances>,
    /// Of a search for what a driver fails at.
    pub search: Metrics<MeasuredSearch>,
    /// Of the λ from which a driver fails.
    pub threshold: Metrics<MeasuredThreshold>,
    /// Of a plan that was made against one driver, driven by another.
    pub transfer: Metrics<MeasuredTransfer>,
}

impl MetricRegistries {
    fn shipped() -> Result<Self, Error> {
        Ok(Self {
            trajectory: trajectory_metrics()?,
            avoidable: avoidable_metrics()?,
            policy: policy_metrics()?,
            drive: drive_metrics()?,
            attack: attack_metrics()?,
            episode: episode_metrics()?,
            prediction: prediction_metrics()?,
            search: search_metrics()?,
            threshold: threshold_metrics()?,
            transfer: transfer_metrics()?,
        })
    }
}
