//! Generators that the user names, built with their inputs and operating points.

use std::sync::Arc;

use anyhow::{Result, bail};
use sage_core::generator::{ApartNow, Generator, OperatingPoint};
use sage_generators::{Facts, GeneratorInputs};
use sage_merging::{ExpertSet, Merger};

use crate::{
    Registries,
    operating_point::{OperatingPointSpec, RowKey},
    part::Part,
    selection::Selection,
};

/// A generator with its operating points.
pub struct BuiltGenerator {
    /// What it depends on and knows.
    pub facts: Facts,
    /// The generator.
    pub generator: Box<dyn Generator>,
    /// Key of each result row; one key without an operating point if the generator depends on none.
    pub keys: Vec<RowKey>,
    /// Operating point of each key.
    pub points: Vec<OperatingPoint>,
}

impl BuiltGenerator {
    /// Builds a generator for some operating points.
    ///
    /// *Errors*: the name is not registered, or the generator refuses the options or inputs.
    pub fn new(
        part: &Part,
        registries: &Registries,
        inputs: &GeneratorInputs,
        specs: &[OperatingPointSpec],
    ) -> Result<Self> {
        let kind = part.build(&registries.generators)?;
        let facts = kind.facts();
        let key = |point: Option<OperatingPointSpec>| RowKey {
            method: part.name.clone(),
            options: part.options.clone(),
            point,
        };
        let (keys, points) = if facts.uses_operating_point() {
            let key = |spec: &OperatingPointSpec| {
                let mu = if facts.depends_on_mu { None } else { spec.lambda };
                key(Some(OperatingPointSpec { mu: mu.unwrap_or(spec.mu), ..spec.clone() }))
            };
            // Without a mixture the names of the experts do not matter.
            let experts = inputs.experts.as_ref().filter(|_| facts.depends_on_lambda);
            let points = specs.iter().map(|spec| spec.point(experts));
            let keys: Vec<RowKey> = specs.iter().map(key).collect();
            refuse_duplicates(&keys)?;
            (keys, points.collect::<Result<_>>()?)
        } else {
            (vec![key(None)], vec![OperatingPoint::at(1.0, 1.0)])
        };
        Ok(Self { facts, generator: Box::new(ApartNow(kind.build(inputs)?)), keys, points })
    }
}

/// Refuses duplicate rows.
///
/// *Errors*: the first key that occurs twice.
pub fn refuse_duplicates(keys: &[RowKey]) -> Result<()> {
    match keys.iter().enumerate().find(|(k, key)| keys[..*k].contains(key)) {
        Some((_, key)) => bail!("`{}` is given twice", key.label()),
        None => Ok(()),
    }
}

/// Inputs of all generators of a command.
pub fn inputs(
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
