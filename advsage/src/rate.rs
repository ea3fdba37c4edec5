//! Rates: how likely a driver fails in a scene, if the adversary moves as a nominal density says.

mod calibration;
mod density;
mod forecast;
mod timing;

use std::sync::Arc;

pub use calibration::{
    Coverage, LEVELS, Meetings, NominalCard, RecordedEnd, TEMPERATURES, TimingGain, fitted_temperature,
};
pub use density::{
    Density, DensityIdentity, DensitySpec, MOST_PROFILES, NOMINAL_FILE, PROFILES, hash, probability_near,
};
pub use forecast::Forecast;
use sage_core::{
    generator::Observation,
    objective::{Context, ContextOptions},
    scene::{Scene, SceneIndex},
};
use sage_sim::{
    rate::{Driven, Given, Nominal},
    search::{Explained, Requirement, SearchOptions},
};
pub use timing::{RecordedTiming, Timing, fitted_spread, gains};

use crate::{
    Registries, Result,
    part::Part,
    prepared::DriverInScene,
    search,
    selection::Selection,
    weights::{self, NamedNetwork},
};

/// What a user says of a rate.
#[derive(Clone, Debug)]
pub struct RateSpec {
    /// The prior, by the name of its weights; [`weights::DEFAULT`] if none.
    pub weights: Option<String>,
    /// The density.
    pub density: DensitySpec,
    /// What feasible means; `drivable` if none.
    pub feasibility: Option<Part>,
    /// Number of drives in a scene; none for all plans.
    pub budget: Option<usize>,
    /// What makes a failure.
    pub require: Requirement,
    /// What the headline is conditioned on, and the likeliest failure.
    pub given: Given,
    /// Seed of the sample.
    pub seed: u64,
}

/// What measures rates, apart from the driver.
pub struct NamedRate {
    /// What the user said.
    pub spec: RateSpec,
    /// The density.
    pub density: Density,
    /// Its rule decides which plans are feasible.
    pub rule: Selection,
}

impl Default for RateSpec {
    fn default() -> Self {
        Self {
            weights: None,
            density: DensitySpec::default(),
            feasibility: None,
            budget: Some(64),
            require: Requirement::default(),
            given: Given::default(),
            seed: 0,
        }
    }
}

impl RateSpec {
    /// Checks everything and loads the prior.
    ///
    /// *Errors*: those of [`DensitySpec::build`]; weights or a rule that there are not.
    pub fn build(self, registries: &Registries) -> Result<NamedRate> {
        self.build_with(registries, |_| {})
    }

    /// The same; `loaded` is told of the prior before it is used.
    ///
    /// *Errors*: as [`RateSpec::build`].
    pub fn build_with(
        self,
        registries: &Registries,
        loaded: impl FnOnce(&NamedNetwork),
    ) -> Result<NamedRate> {
        let name = self.weights.as_deref().unwrap_or(weights::DEFAULT);
        let prior = NamedNetwork::load(&registries.backbones, name)?;
        loaded(&prior);
        let density = self.density.build(name, prior.network.into())?;
        let rule = search::rule(registries, self.feasibility.as_ref())?;
        Ok(NamedRate { spec: self, density, rule })
    }
}

impl NamedRate {
    /// The nominal density in a scene, the same for all drivers.
    ///
    /// *Errors*: a scene that is too short, or has no adversary that is valid *now*.
    pub fn nominal(&self, scene: &Arc<Scene>, index: &Arc<SceneIndex>) -> Result<Nominal> {
        let recorded = Context::new(scene, index, &ContextOptions::default())?;
        let plans = self.density.plans(&Observation::of(scene, index)?, &recorded)?;
        Ok(Nominal::new(&recorded, self.rule.objective.rule(), plans))
    }

    /// Drives a driver against plans of the density, and says with which probability each plan is driven.
    ///
    /// *Errors*: an error of the driver.
    pub fn drive(&self, driver: &DriverInScene, nominal: &Nominal) -> Result<(Vec<f64>, Vec<Driven>)> {
        let (rule, options) = (self.rule.objective.rule(), self.options());
        let inclusions = nominal.inclusions(&driver.ctx, self.spec.given, options.budget);
        let driven = nominal.drive(&driver.test, &driver.ctx, rule, &options, &inclusions, self.spec.seed)?;
        Ok((inclusions, driven))
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
