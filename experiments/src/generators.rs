//! Generators as the user asks for them: built, with the operating points that tell them apart.

use std::sync::Arc;

use anyhow::Result;
use sage_core::generator::{Generator, OperatingPoint};
use sage_generators::{Facts, GeneratorInputs};
use sage_merging::{ExpertSet, Merger};

use crate::{
    Registries,
    operating_point::{Place, RowKey},
    part::Part,
    selection::Selection,
};

/// A generator with its operating points.
pub(crate) struct BuiltGenerator {
    pub(crate) facts: Facts,
    pub(crate) generator: Box<dyn Generator>,
    /// What its results are of; one without a place if it has no dial.
    pub(crate) keys: Vec<RowKey>,
    /// The operating point of each.
    pub(crate) points: Vec<OperatingPoint>,
}

impl BuiltGenerator {
    /// Builds a generator for some places of the dials.
    ///
    /// *Errors*: a name that is not registered, options or inputs that do not suit it.
    pub(crate) fn new(
        part: &Part,
        registries: &Registries,
        inputs: &GeneratorInputs,
        places: &[Place],
    ) -> Result<Self> {
        let kind = part.build(&registries.generators)?;
        let (facts, method) = (kind.facts(), part.to_string());
        let (keys, points) = if facts.has_dial() {
            let key = |place: &Place| RowKey { method: method.clone(), place: Some(place.clone()) };
            let points = places.iter().map(|place| place.point(inputs.experts.as_ref()));
            (places.iter().map(key).collect(), points.collect::<Result<_>>()?)
        } else {
            (vec![RowKey { method, place: None }], vec![OperatingPoint::at(1.0, 1.0)])
        };
        Ok(Self { facts, generator: kind.build(inputs)?, keys, points })
    }
}

/// What generators are built from.
pub(crate) fn inputs(
    experts: Option<&ExpertSet>,
    merger: &Arc<dyn Merger>,
    selection: &Selection,
    seed: u64,
) -> GeneratorInputs {
    GeneratorInputs {
        experts: experts.cloned(),
        merger: merger.clone(),
        seed,
        selection: Arc::new(selection.objective.clone()),
    }
}
