//! How the plan of an adversary was made, as rows, scene files and suites say it.

use std::collections::BTreeMap;

use sage_core::objective::ObjectiveSpec;
use sage_sim::search::SearchOptions;
use serde::{Deserialize, Serialize, Serializer, ser::SerializeMap as _};
use serde_json::{Map, Value};

use crate::{adversary::AdversarySpec, operating_point::OperatingPointSpec, part::Part};

/// How a plan was made. If nothing is known of it, a row says so: `method` and `lambda` are null.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct GeneratedBy {
    /// Name of the generator.
    pub method: Option<String>,
    /// Options of the generator that differ from its defaults.
    pub options: Option<Map<String, Value>>,
    /// Interpolation weight λ; none for a mixture of experts by name.
    pub lambda: Option<f64>,
    /// Weight μ of the selection.
    pub mu: Option<f64>,
    /// Aggression, if it determines λ and μ.
    pub aggression: Option<f64>,
    /// Merger of the experts.
    pub merger: Option<String>,
    /// Weights of the experts by name, in place of λ.
    pub mix: BTreeMap<String, f64>,
    /// The objective that selected the plan.
    pub selection: Option<ObjectiveSpec>,
    /// The search that found it.
    pub search: Option<SearchOptions>,
    /// The driver that it was planned against, if that is not the recording.
    pub ego: Option<String>,
    /// Seconds before the contact at which an evasive manoeuvre should begin, if that was asked.
    pub wanted_latest_start: Option<f64>,
    /// Who was placed in the scene as the adversary; none if the adversary was recorded.
    pub placed: Option<AdversarySpec>,
}

impl GeneratedBy {
    /// A plan of a generator at an operating point.
    pub fn at(method: &Part, merger: &Part, point: Option<&OperatingPointSpec>) -> Self {
        Self {
            method: Some(method.name.clone()),
            options: Some(method.options.clone()),
            lambda: point.and_then(|point| point.lambda),
            mu: point.map(|point| point.mu),
            aggression: point.and_then(|point| point.aggression),
            merger: Some(merger.to_string()),
            mix: point.iter().flat_map(|point| point.mix.iter().cloned()).collect(),
            ..Self::default()
        }
    }

    /// The same without what a row of another command does not repeat: search, driver, and what was asked.
    #[must_use]
    pub fn of_plan(self) -> Self {
        Self { search: None, ego: None, wanted_latest_start: None, ..self }
    }

    /// Its fields.
    pub fn to_map(&self) -> Map<String, Value> {
        match serde_json::to_value(self) {
            Ok(Value::Object(map)) => map,
            // Its keys are texts.
            _ => Map::new(),
        }
    }
}

impl Serialize for GeneratedBy {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("method", &self.method)?;
        let is_known = self.method.is_some() || self.search.is_some();
        if is_known {
            map.serialize_entry("options", &self.options)?;
        }
        map.serialize_entry("lambda", &self.lambda)?;
        if is_known {
            map.serialize_entry("mu", &self.mu)?;
            map.serialize_entry("aggression", &self.aggression)?;
            map.serialize_entry("merger", &self.merger)?;
        }
        if !self.mix.is_empty() {
            map.serialize_entry("mix", &self.mix)?;
        }
        if let Some(selection) = &self.selection {
            map.serialize_entry("selection", selection)?;
        }
        if let Some(search) = &self.search {
            map.serialize_entry("search", search)?;
        }
        if let Some(ego) = &self.ego {
            map.serialize_entry("ego", ego)?;
        }
        if let Some(time) = self.wanted_latest_start {
            map.serialize_entry("wanted_latest_start", &time)?;
        }
        if let Some(placed) = &self.placed {
            map.serialize_entry("placed", placed)?;
        }
        map.end()
    }
}
