//! A generator as a user names it, with all that it is built from: options, selection, merger, weights and operating points.

use anyhow::{Context as _, Result};
use sage_generators::{Aggression, Facts};

use crate::{
    Error, Registries,
    generators::{BuiltGenerator, Generators},
    operating_point::{OperatingPointSpec, OperatingPoints},
    part::Part,
    selection::Selection,
    weights::{NamedExperts, find_dial, note_on_merger},
};

/// What a user says of a generator.
#[derive(Clone, Debug)]
pub struct GeneratorSpec {
    /// The generator with its options.
    pub method: Part,
    /// Objective that selects one of the candidates: name of a preset, or a JSON file.
    pub selection: String,
    /// Feasibility rule in place of the selection's.
    pub feasibility: Option<Part>,
    /// Merger of the experts.
    pub merger: Part,
    /// Weights by name; `None` for [`crate::weights::DEFAULT`].
    pub weights: Option<String>,
    /// Operating points; at least one.
    pub points: OperatingPoints,
    /// Seed of candidates that are drawn.
    pub seed: u64,
}

/// A generator at its operating points.
pub struct NamedGenerator {
    /// What it depends on and knows.
    pub facts: Facts,
    /// The objective that selects.
    pub selection: Selection,
    /// Name of each operating point, as part of file names.
    pub variants: Vec<String>,
    /// `None` for a generator without experts.
    pub weights: Option<NamedExperts>,
    /// The generator.
    pub built: BuiltGenerator,
    /// Operating points as rows record them, even if the generator does not depend on λ or μ.
    pub points: Vec<OperatingPointSpec>,
    /// What the user should know, besides the notes of the weights.
    pub notes: Vec<String>,
}

/// A generator whose parts are checked, before its weights are loaded.
pub struct CheckedGenerator<'r> {
    registries: &'r Registries,
    spec: GeneratorSpec,
    selection: Selection,
    generators: Generators<'r>,
    /// What it depends on and knows.
    pub facts: Facts,
    variants: Vec<String>,
}

impl GeneratorSpec {
    /// Checks everything but the weights.
    ///
    /// *Errors*: an option is out of range, names an unknown part, or is given twice.
    pub fn checked(self, registries: &Registries) -> Result<CheckedGenerator<'_>> {
        let selection = Selection::of(registries, &self.selection, self.feasibility.as_ref())?;
        let generators = Generators::new(registries, &self.merger, &selection, self.seed)?;
        let facts = generators.facts(&self.method)?;
        let variants = self.points.variants(generators.merger().range())?;
        let variants = if facts.uses_operating_point() { variants } else { vec![self.method.name.clone()] };
        if let Some(twice) = (1..variants.len()).find(|k| variants[..*k].contains(&variants[*k])) {
            return Err(
                Error::Value(format!("the operating point `{}` is given twice", variants[twice])).into()
            );
        }
        Ok(CheckedGenerator { registries, spec: self, selection, generators, facts, variants })
    }
}

impl CheckedGenerator<'_> {
    /// Loads the weights, if it needs any, and builds the generator. `loaded` is told of them before they are used.
    ///
    /// *Errors*: weights cannot be used, or have no dial.
    pub fn build(mut self, loaded: impl FnOnce(&NamedExperts)) -> Result<NamedGenerator> {
        let Self { registries, spec, selection, facts, variants, .. } = self;
        let range = self.generators.merger().range();
        let weights = if facts.needs_experts {
            let name = spec.weights.as_deref();
            let weights = NamedExperts::load_for(&registries.backbones, name, facts.depends_on_lambda)?;
            loaded(&weights);
            self.generators = self.generators.with_experts(&weights.experts);
            Some(weights)
        } else {
            None
        };
        let mut notes = Vec::new();
        let points = if facts.uses_operating_point() {
            let dial = || dial(weights.as_ref(), &selection, &spec.merger, &mut notes);
            spec.points.specs(range, dial)?
        } else {
            vec![OperatingPointSpec::at(1.0, None, range)?]
        };
        let built = self.generators.build(&spec.method, &points)?;
        Ok(NamedGenerator { facts, selection, variants, weights, built, points, notes })
    }
}

/// The dial of some weights.
///
/// *Errors*: there are no weights, or no dial was fitted for them.
pub(crate) fn dial(
    weights: Option<&NamedExperts>,
    selection: &Selection,
    merger: &Part,
    notes: &mut Vec<String>,
) -> Result<Aggression> {
    let weights = weights.context("a dial needs experts; name weights that hold some")?;
    let dial = find_dial(&weights.name, &weights.experts, selection)?;
    notes.extend(note_on_merger(&dial, &merger.to_string()));
    Ok(dial.mu)
}
