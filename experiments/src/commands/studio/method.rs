//! A generator that the page offers, with its dials.

use advsage::{
    Registries,
    named_generator::{GeneratorSpec, NamedGenerator},
    operating_point::{OperatingPoints, Values},
    part::Part,
};
use anyhow::Result;
use sage_run::networks;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Places of the slider, from 0 to 1.
pub(super) const STEPS: usize = 21;

/// What the slider holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Dial {
    Lambda,
    Aggression,
}

impl Dial {
    pub(super) fn option(self) -> &'static str {
        match self {
            Self::Lambda => "--lambda",
            Self::Aggression => "--aggression",
        }
    }
}

/// Value of a place of the slider, as a user would type it.
pub(super) fn value(step: usize) -> f64 {
    (step as f64 * 100.0 / (STEPS - 1) as f64).round() / 100.0
}

/// A generator with its dials.
pub(super) struct Method {
    pub(super) part: Part,
    pub(super) weights: Option<String>,
    /// Number of the search with these weights.
    pub(super) search: usize,
    /// Its attacks at all places of each dial; one without places if it depends on none.
    dials: Vec<(Option<Dial>, NamedGenerator)>,
}

impl Method {
    /// Builds a generator; `search` is the number of the search with its weights.
    ///
    /// *Errors*: the name or the options are wrong; weights cannot be used.
    pub(super) fn of(
        part: &Part,
        weights: Option<&str>,
        search: usize,
        seed: u64,
        registries: &Registries,
    ) -> Result<Self> {
        let places = || Some(Values((0..STEPS).map(value).collect()));
        let spec = |points| GeneratorSpec {
            method: Some(part.clone()),
            weights: weights.map(str::to_owned),
            points,
            seed,
            ..GeneratorSpec::default()
        };
        let lambda = OperatingPoints { lambda: places(), ..OperatingPoints::default() };
        let first = spec(lambda).checked(registries)?.build(networks::announce_experts)?;
        let uses_point = first.built.facts.uses_operating_point();
        let mut dials = vec![(uses_point.then_some(Dial::Lambda), first)];
        if uses_point {
            let aggression = OperatingPoints { aggression: places(), ..OperatingPoints::default() };
            // Weights without a dial have no aggression.
            if let Ok(built) = spec(aggression).build(registries) {
                dials.push((Some(Dial::Aggression), built));
            }
        }
        Ok(Self { part: part.clone(), weights: weights.map(str::to_owned), search, dials })
    }

    /// Whether a slider changes it.
    pub(super) fn has_dial(&self) -> bool {
        self.dials[0].0.is_some()
    }

    /// What the page is told of it.
    pub(super) fn offered(&self) -> Value {
        let dials: Vec<Dial> = self.dials.iter().filter_map(|(dial, _)| *dial).collect();
        // A goal is a selection, on which some generators do not depend.
        let aims = self.dials[0].1.built.facts.depends_on_mu;
        let weights = self.weights.as_ref().map_or(String::new(), |weights| format!(", {weights}"));
        json!({"name": format!("{}{weights}", self.part), "dials": dials, "aims": aims})
    }

    /// The generator at all places of a dial; `None` if it has no such dial.
    pub(super) fn at(&self, dial: Dial) -> Option<&NamedGenerator> {
        let is_it = |known: Option<Dial>| known.is_none_or(|known| known == dial);
        self.dials.iter().find(|(known, _)| is_it(*known)).map(|(_, generator)| generator)
    }
}
