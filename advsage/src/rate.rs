//! Rates: how likely a driver fails in a scene, if the adversary moves as an untuned motion prior says.
//!
//! The density is that of the prior at the temperature at which its sets hold as many recorded ends as they should
//! ([`NOMINAL_FILE`]). Tuned experts are no density of traffic (the sets of the realistic one hold a
//! fifth of the recorded ends), and refused as a prior everywhere.

mod calibration;

use std::sync::Arc;

pub use calibration::{Coverage, LEVELS, NominalCard, RecordedEnd, TEMPERATURES, fitted_temperature};
use sage_core::{
    generator::Observation,
    objective::{Context, ContextOptions},
    scene::{Scene, SceneIndex},
};
use sage_generators::nominal_goals;
use sage_sim::{
    rate::{Driven, Nominal},
    search::{Explained, Requirement, SearchOptions},
};

use crate::{
    Error, Registries, Result, WithContext as _,
    part::Part,
    prepared::DriverInScene,
    search,
    selection::Selection,
    weights::{self, NamedNetwork},
};

/// File beside a prior: the temperature of its nominal density.
pub const NOMINAL_FILE: &str = "nominal.json";
/// Size limit of that file, bytes.
const LIMIT: u64 = 1 << 20;

/// What a user says of a rate.
#[derive(Clone, Debug)]
pub struct RateSpec {
    /// The prior, by the name of its weights; [`weights::DEFAULT`] if none.
    pub weights: Option<String>,
    /// Temperature of the density; that of the weights if none.
    pub temperature: Option<f64>,
    /// What feasible means; `drivable` if none.
    pub feasibility: Option<Part>,
    /// Number of drives in a scene; none for all plans.
    pub budget: Option<usize>,
    /// What makes a failure.
    pub require: Requirement,
    /// Seed of the sample.
    pub seed: u64,
}

/// What measures rates, apart from the driver.
pub struct NamedRate {
    /// What the user said.
    pub spec: RateSpec,
    /// The prior.
    pub prior: NamedNetwork,
    /// Temperature of the density.
    pub temperature: f64,
    /// Its rule decides which plans are feasible.
    pub rule: Selection,
    /// What the user should know.
    pub notes: Vec<String>,
}

impl Default for RateSpec {
    fn default() -> Self {
        Self {
            weights: None,
            temperature: None,
            feasibility: None,
            budget: Some(64),
            require: Requirement::default(),
            seed: 0,
        }
    }
}

impl RateSpec {
    /// Checks everything and loads the prior.
    ///
    /// *Errors*: a temperature out of range; weights or a rule that there are not.
    pub fn build(self, registries: &Registries) -> Result<NamedRate> {
        let [least, most] = TEMPERATURES;
        if let Some(temperature) = self.temperature.filter(|t| !(*t >= least && *t <= most)) {
            return Err(Error::Value(format!(
                "the temperature is {temperature}; expected {least} to {most}"
            )));
        }
        let name = self.weights.as_deref().unwrap_or(weights::DEFAULT);
        let prior = NamedNetwork::load(&registries.backbones, name)?;
        let rule = search::rule(registries, self.feasibility.as_ref())?;
        let mut notes = Vec::new();
        let mut unknown = |why: &str| {
            notes.push(format!(
                "{why}, so whether the density of weights `{name}` is calibrated is not known; its temperature is taken as 1 (`sage calibrate --nominal` fits it)"
            ));
            1.0
        };
        let temperature = match (self.temperature, card(name)?) {
            (Some(temperature), _) => temperature,
            (None, Some(card)) if card.prior == hash(&prior)? => card.temperature,
            (None, Some(_)) => unknown(&format!("`{NOMINAL_FILE}` is of another prior")),
            (None, None) => unknown(&format!("there is no `{NOMINAL_FILE}`")),
        };
        Ok(NamedRate { spec: self, prior, temperature, rule, notes })
    }
}

/// Hash of a prior, by which its card knows it.
///
/// *Errors*: none on a CPU.
pub fn hash(prior: &NamedNetwork) -> Result<String> {
    Ok(prior.network.parameters().hash()?)
}

/// The card of some weights; `None` without.
fn card(name: &str) -> Result<Option<NominalCard>> {
    let Ok(found) = weights::find(name) else { return Ok(None) };
    if !found.has(NOMINAL_FILE) {
        return Ok(None);
    }
    let text = found.text(NOMINAL_FILE, LIMIT)?;
    let card = serde_json::from_str(&text);
    card.map(Some).with_context(|| format!("`{}`", found.path(NOMINAL_FILE).display()))
}

impl NamedRate {
    /// The nominal density in a scene, the same for all drivers.
    ///
    /// *Errors*: a scene that is too short, or has no adversary that is valid *now*.
    pub fn nominal(&self, scene: &Arc<Scene>, index: &Arc<SceneIndex>) -> Result<Nominal> {
        let recorded = Context::new(scene, index, &ContextOptions::default())?;
        let goals = nominal_goals(&*self.prior.network, &Observation::of(scene, index)?)?;
        Ok(Nominal::new(&recorded, self.rule.objective.rule(), goals, self.temperature))
    }

    /// Drives a driver against plans of the density.
    ///
    /// *Errors*: an error of the driver.
    pub fn drive(&self, driver: &DriverInScene, nominal: &Nominal) -> Result<Vec<Driven>> {
        let rule = self.rule.objective.rule();
        Ok(nominal.drive(&driver.test, &driver.ctx, rule, &self.options(), self.spec.seed)?)
    }

    /// How its drives are made: the budget is that of the rate.
    pub fn options(&self) -> SearchOptions {
        let budget = self.spec.budget.unwrap_or(usize::MAX);
        SearchOptions {
            budget,
            require: self.spec.require,
            explain: Explained::None,
            ..SearchOptions::default()
        }
    }
}
