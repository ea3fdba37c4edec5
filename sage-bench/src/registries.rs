//! The registries of all parts that commands and studies name.

use sage_backbones::{
    metrics::{PolicyMeasures, policy_metrics, prediction_metrics},
    prediction::Distances,
};
use sage_core::{
    Error,
    metric::{MeasuredTrajectory, Metrics, trajectory_metrics},
    registry::Registry,
};
use sage_sim::{
    avoidable::Avoidable,
    evaluation::EpisodeRow,
    metrics::{MeasuredAttack, attack_metrics, avoidable_metrics, drive_metrics, episode_metrics},
    rate::{MeasuredRate, rate_metrics},
    search::{
        MeasuredSearch, MeasuredThreshold, MeasuredTransfer, search_metrics, threshold_metrics,
        transfer_metrics,
    },
    unattacked::UnattackedDrive,
};
use theory_checks::{Check, claims};

use crate::study::SHIPPED;

/// Parts that attack, drive and train, and what studies and the theory add.
///
/// A metric of your own becomes a column of studies:
///
/// ```
/// use sage_bench::Registries;
/// use sage_core::metric::Metric;
///
/// let mut registries = Registries::shipped()?;
/// let stands = Metric::share("stands", |drive: &sage_sim::unattacked::UnattackedDrive| Some(drive.steps == 0));
/// registries.metrics.drive = registries.metrics.drive.with(stands.less_is_better())?;
/// assert!(registries.metrics.drive.by_names(&["stands".to_owned()]).is_ok());
/// # Ok::<(), sage_core::Error>(())
/// ```
pub struct Registries {
    /// Parts that attack, drive and train.
    pub parts: advsage::Registries,
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
            parts: advsage::Registries::shipped()?,
            claims: claims()?,
            metrics: MetricRegistries::shipped()?,
            studies: SHIPPED.to_vec(),
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
    /// Of how likely a driver fails.
    pub rate: Metrics<MeasuredRate>,
    /// Of the λ from which a driver fails.
    pub threshold: Metrics<MeasuredThreshold>,
    /// Of a plan that was made against one driver, driven by another.
    pub transfer: Metrics<MeasuredTransfer>,
}

impl MetricRegistries {
    fn shipped() -> Result<Self, Error> {
        Ok(Self {
            trajectory: trajectory_metrics([
                #[cfg(feature = "baselines")]
                sage_baselines::goose::queries_metric(),
            ])?,
            avoidable: avoidable_metrics()?,
            policy: policy_metrics()?,
            drive: drive_metrics()?,
            attack: attack_metrics()?,
            episode: episode_metrics()?,
            prediction: prediction_metrics()?,
            search: search_metrics()?,
            rate: rate_metrics()?,
            threshold: threshold_metrics()?,
            transfer: transfer_metrics()?,
        })
    }
}
