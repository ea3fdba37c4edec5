//! Metrics of rates.

use sage_core::{
    Error,
    metric::{Metric, Metrics},
};

use super::{Driven, Event, Given, Nominal};
use crate::{attack_test::AttackTest, search::Requirement};

/// Rates above which scenes are counted.
const ABOVE: [f64; 2] = [0.01, 0.1];

/// How likely a driver fails in a scene.
pub struct MeasuredRate {
    /// Rates by condition and event, in the orders of [`Given::ALL`] and [`Event::DEFAULT`].
    rates: [[Option<f64>; Event::DEFAULT.len()]; Given::ALL.len()],
    /// Share of the headline's condition that was not driven.
    undriven: f64,
    drives: usize,
    has_unattacked_contact: bool,
}

impl MeasuredRate {
    /// Of the drives against plans of a density.
    pub fn new(nominal: &Nominal, driven: &[Driven], require: Requirement, test: &AttackTest) -> Self {
        let rate = |given, event: Event| {
            nominal.rate(driven, given, |driven| event.happens(driven, require)).map(|rate| rate.rate)
        };
        Self {
            rates: Given::ALL.map(|given| Event::DEFAULT.map(|event| rate(given, event))),
            undriven: nominal.undriven(driven, Given::default()),
            drives: driven.len(),
            has_unattacked_contact: !test.unattacked().contacts.is_empty(),
        }
    }

    fn failure(&self) -> Option<f64> {
        *self.rates[0].last()?
    }
}

/// Metrics of a rate.
///
/// *Errors*: two have the same name.
pub fn rate_metrics() -> Result<Metrics<MeasuredRate>, Error> {
    let mut all = Metrics::default();
    for (k, given) in Given::ALL.into_iter().enumerate() {
        for (j, event) in Event::DEFAULT.into_iter().enumerate() {
            let name = match given {
                Given::ClearOfRecordedEgo => event.name().to_owned(),
                Given::Feasible => format!("{}, feasible", event.name()),
            };
            let rate = Metric::mean(name, move |of: &MeasuredRate| of.rates[k][j].map(|rate| 100.0 * rate));
            all = all.with(
                rate.unit("%")
                    .less_is_better()
                    .about(format!("probability, given that the plan is {}", given.name())),
            )?;
        }
    }
    for least in ABOVE {
        let name = format!("above {} %", 100.0 * least);
        let is_above = move |of: &MeasuredRate| of.failure().map(|rate| rate > least);
        all = all.with(
            Metric::share(name, is_above).less_is_better().about("scenes in which a failure is likelier"),
        )?;
    }
    all.with(
        Metric::mean("undriven", |of: &MeasuredRate| Some(100.0 * of.undriven))
            .unit("%")
            .about("probability of the plans that were not driven"),
    )?
    .with(Metric::mean("drives", |of: &MeasuredRate| Some(of.drives as f64)))?
    .with(
        Metric::share("contact without attack", |of: &MeasuredRate| Some(of.has_unattacked_contact))
            .less_is_better()
            .about("a contact without any attack, which is in no rate"),
    )
}
