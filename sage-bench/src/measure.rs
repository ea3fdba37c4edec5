//! What a study measures in a scene: each kind of measurement is a file.

mod attacks;
mod ego_samples;
mod episodes;
mod groups;
mod policies;
mod predictions;
mod rates;
mod scene;
mod searches;
mod transfers;

use std::{error::Error as StdError, iter::successors, path::Path, sync::Arc};

use advsage::{ego::Ego, prepared::DriverInScene};
use sage_backbones::Backbone;
use sage_core::{
    generator::Attack,
    metric::{Metric, MetricInfo},
    scene::SceneData,
};
use sage_sim::{SimScene, policy::StepTimes};
use serde::{Deserialize, Serialize};

pub use attacks::{Attacks, Choice, MeasuredPlan};
pub use episodes::Episodes;
pub use groups::{ExpertSource, Group};
pub use policies::Policies;
pub use predictions::Predictions;
pub use rates::Rates;
pub use scene::MeasuredScene;
pub use searches::Searches;
pub use transfers::Transfers;

use crate::{
    Error, Result,
    rows::{Cell, Key, Subject},
};

/// A kind of measurement with all its methods.
pub trait Measurement: Sync + Send {
    /// What it gives values for, in the order of the table.
    fn keys(&self) -> &[Key];

    /// The metrics of each subject.
    fn metrics(&self) -> Vec<(Subject, Vec<MetricInfo>)>;

    /// Measures a scene. The numbers of keys in cells are those of [`Measurement::keys`].
    fn measure(&self, data: &SceneData) -> SceneResult;

    /// Names the folder of a run for logs of drivers.
    fn write_logs_to(&self, _folder: &Path) {}

    /// Times of the steps of the drivers that it measured, by their names.
    fn step_times(&self) -> Vec<(&str, &StepTimes)> {
        Vec::new()
    }

    /// The attack of a key on the recorded ego, computed again for a picture; `None` if the key has none.
    ///
    /// *Errors*: those of the generator.
    fn attack(&self, key: usize, data: &SceneData) -> Result<Option<Attack>> {
        let _ = (key, data);
        Ok(None)
    }
}

/// Results of one scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneResult {
    /// One cell for each key and agent.
    pub cells: Vec<Cell>,
    /// Why nothing can be measured for some keys, which is no failure.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
}

/// The cell of a result.
fn cell<S>(key: usize, metrics: &[Metric<S>], of: &S) -> Cell {
    let notes = metrics.iter().enumerate().filter_map(|(k, metric)| Some((k, metric.note(of)?)));
    Cell {
        key,
        agent: String::new(),
        values: metrics.iter().map(|metric| metric.value(of)).collect(),
        notes: notes.collect(),
        error: String::new(),
    }
}

/// A driver in a scene, after its drive without an attack.
///
/// *Errors*: the driver cannot drive here, or touches the adversary *now*.
fn driver_in_scene<'t>(
    ego: &'t Ego,
    simulated: &Result<Arc<SimScene>, sage_sim::Error>,
    seed: u64,
) -> Result<DriverInScene<'t>> {
    let simulated = simulated.as_ref().map_err(|error| Error::Value(error.to_string()))?;
    DriverInScene::new(simulated, |scene| ego.test(scene, seed))
}

/// Whether an error says that two cars touch *now*: nothing can be measured then, which is no failure.
fn leaves_out(error: &Error) -> bool {
    successors(Some(error as &(dyn StdError + 'static)), |error| (**error).source()).any(advsage::leaves_out)
}

fn infos<S>(metrics: &[Metric<S>]) -> Vec<MetricInfo> {
    metrics.iter().map(|metric| metric.info.clone()).collect()
}

/// What is prepared once for all groups with the same prior.
struct ByPrior<'g, T>(Vec<(&'g Arc<dyn Backbone>, T)>);

impl<'g, T> ByPrior<'g, T> {
    fn get(&mut self, group: &'g Group, prepare: impl FnOnce(&'g dyn Backbone) -> T) -> &T {
        let prior = group.experts.prior();
        let known = self.0.iter().position(|(known, _)| Arc::ptr_eq(known, prior));
        let number = known.unwrap_or_else(|| {
            self.0.push((prior, prepare(&**prior)));
            self.0.len() - 1
        });
        &self.0[number].1
    }
}
