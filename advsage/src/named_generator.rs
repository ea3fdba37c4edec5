//! A generator as a user names it: its options for commands, Python and programs, and what is built from them.

use sage_core::{
    generator::Attack,
    objective::{Context, FurtherMeasures, ObjectiveSpec},
};
use sage_generators::Facts;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::{
    Error, Registries, Result, dial,
    generators::{Against, BuiltGenerator, Generators, weight_hashes},
    operating_point::{OperatingPointSpec, OperatingPoints, Values},
    part::{Part, PartOptions},
    rows::GeneratedBy,
    search::SAGE,
    selection::Selection,
    weights::NamedExperts,
};

/// What identifies the attacks of a generator in the record of a run.
#[derive(Clone, Debug, Serialize)]
pub struct GeneratorIdentity<'a> {
    method: String,
    /// Hashes of networks and files by the name of the weights.
    weights: Map<String, Value>,
    /// Dials by the name of the weights.
    dials: Map<String, Value>,
    selection: &'a ObjectiveSpec,
    variants: &'a [String],
    seed: u64,
    merger: String,
    /// Hashes of files that the objective reads.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    contents: Vec<String>,
}

/// What a user says of a generator. `generate`, `search` and `simulate` take these as options, with these texts, and programs set the
/// fields. The keywords of Python have the same names and are written out in its signatures and `_advsage.pyi`, which tests compare with
/// this; a study has lists of them.
///
/// ```
/// use advsage::{GeneratorSpec, OperatingPoints, Registries};
///
/// let points = OperatingPoints::of_lambda([0.0, 0.5, 1.0]);
/// let sage = GeneratorSpec { points, ..GeneratorSpec::named(r#"sage{"candidates": 16}"#)? };
/// let sage = sage.build(&Registries::of_attacks()?)?;
/// // One attack a scene for each operating point, with its name in file names.
/// assert_eq!(sage.variants, ["lambda0.00", "lambda0.50", "lambda1.00"]);
/// assert_eq!(sage.weights_name(), Some("procedural"));
/// # Ok::<(), advsage::Error>(())
/// ```
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::Args), command(next_help_heading = "Attack"))]
#[serde(default)]
pub struct GeneratorSpec {
    /// The generator; `None` for `sage`, and in a search for the default pool.
    #[cfg_attr(feature = "clap", arg(skip))]
    pub method: Option<Part>,
    /// Options of the generator as JSON, such as '{"candidates": 64}'; `sage list` shows them. The same as
    /// --method 'sage{"candidates": 64}'.
    #[cfg_attr(feature = "clap", arg(long, value_name = "JSON"))]
    pub options: Option<PartOptions>,
    /// Operating points; none for λ = 1, and in a search for the default ones.
    #[cfg_attr(feature = "clap", command(flatten))]
    #[serde(flatten)]
    pub points: OperatingPoints,
    /// Merger of the experts, by its name in `sage list`; with options as NAME{"option": value}.
    #[cfg_attr(feature = "clap", arg(long, value_name = "NAME", default_value = "linear"))]
    pub merger: Part,
    /// Objective that selects one of the candidates: its name in `sage list`, or a JSON file.
    #[cfg_attr(
        feature = "clap",
        arg(long, help_heading = "Selection", value_name = "NAME", default_value = "natural")
    )]
    pub selection: String,
    /// Weights of the experts: procedural, waymo, waymo-paper, waymo-literal or a folder (default: procedural).
    #[cfg_attr(feature = "clap", arg(long, value_name = "NAME"))]
    pub weights: Option<String>,
    /// Seed of random numbers.
    #[cfg_attr(feature = "clap", arg(long, help_heading = "Run", value_name = "S", default_value_t = 0))]
    pub seed: u64,
    /// Feasibility rule, by its name in `sage list`, instead of the rule of the selection; with options as
    /// NAME{"option": value}.
    #[cfg_attr(feature = "clap", arg(long, help_heading = "Selection", value_name = "NAME"))]
    pub feasibility: Option<Part>,
}

/// A generator at its operating points.
pub struct NamedGenerator {
    /// What the user said of it.
    pub spec: GeneratorSpec,
    /// The generator with its options.
    pub method: Part,
    /// The objective that selects.
    pub selection: Selection,
    /// Measures that rows hold besides the scores of the paper.
    pub further: FurtherMeasures,
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
    method: Part,
    selection: Selection,
    generators: Generators<'r>,
    facts: Facts,
    variants: Vec<String>,
    /// Fields of the specification that the generator does not depend on.
    pub unused: Vec<&'static str>,
    /// What the user should know of the dial.
    pub note: Option<&'static str>,
}

impl Default for GeneratorSpec {
    /// `sage` at λ = 1 with the default weights.
    fn default() -> Self {
        Self {
            method: None,
            options: None,
            selection: "natural".to_owned(),
            feasibility: None,
            merger: Part::named("linear"),
            weights: None,
            points: OperatingPoints::default(),
            seed: 0,
        }
    }
}

impl GeneratorSpec {
    /// A generator by its name in `sage list` (also [`Registries::generators`]), such as `king` or `sage{"candidates": 64}`.
    ///
    /// *Errors*: a text that is no name.
    pub fn named(name: &str) -> Result<Self> {
        Ok(Self { method: Some(name.parse().map_err(Error::Value)?), ..Self::default() })
    }

    /// The generator with all its options.
    pub fn part(&self) -> Part {
        let mut part = self.method.clone().unwrap_or_else(|| Part::named(SAGE));
        if let Some(PartOptions(options)) = &self.options {
            part.options.extend(options.clone());
        }
        part
    }

    /// The same at a λ, 0 realistic and 1 adversarial, and at a weight μ of the selection; λ if `None`.
    #[must_use]
    pub fn at(self, lambda: f64, mu: Option<f64>) -> Self {
        Self { points: OperatingPoints { mu, ..OperatingPoints::of_lambda([lambda]) }, ..self }
    }

    /// Checks everything, loads weights and builds the generator.
    ///
    /// *Errors*: as [`GeneratorSpec::checked`] and [`CheckedGenerator::build`].
    pub fn build(self, registries: &Registries) -> Result<NamedGenerator> {
        self.checked(registries)?.build(|_| {})
    }

    /// Checks everything but the weights.
    ///
    /// *Errors*: an option is out of range, names an unknown part, or is given twice.
    pub fn checked(mut self, registries: &Registries) -> Result<CheckedGenerator<'_>> {
        self.points.check().map_err(Error::Value)?;
        let method = self.part();
        let selection = Selection::of(registries, &self.selection, self.feasibility.as_ref())?;
        let generators = Generators::new(registries, &self.merger, &selection, self.seed)?;
        let facts = generators.facts(&method)?;
        let unused = self.unused(&facts);
        let is_paper = self.feasibility.as_ref().is_none_or(|rule| *rule == Part::paper());
        let is_fitted = method.name == SAGE && is_paper;
        let uses_dial = self.points.aggression.is_some() && facts.uses_operating_point();
        let note = (uses_dial && !is_fitted).then_some(
            "the dial was fitted for `sage` under the paper's feasibility rule; here the attack rate may not rise linearly",
        );
        if self.points.is_empty() {
            self.points.lambda = Some(Values(vec![1.0]));
        }
        let variants = self.points.variants(generators.merger().range())?;
        let variants = if facts.uses_operating_point() { variants } else { vec![method.name.clone()] };
        if let Some(twice) = (1..variants.len()).find(|k| variants[..*k].contains(&variants[*k])) {
            return Err(Error::Value(format!("the operating point `{}` is given twice", variants[twice])));
        }
        Ok(CheckedGenerator {
            registries,
            spec: self,
            method,
            selection,
            generators,
            facts,
            variants,
            unused,
            note,
        })
    }

    /// Fields that are given and that a generator does not depend on.
    fn unused(&self, facts: &Facts) -> Vec<&'static str> {
        let points = &self.points;
        let follows_mixture = facts.depends_on_lambda || facts.depends_on_mu;
        let given = [
            ("lambda", points.lambda.is_some() && !follows_mixture),
            ("mix", !points.mix.is_empty() && !follows_mixture),
            ("aggression", points.aggression.is_some() && !follows_mixture),
            ("mu", points.mu.is_some() && !facts.depends_on_mu),
            ("merger", self.merger.name != "linear" && !facts.depends_on_lambda),
            ("selection", self.selection != "natural" && !facts.depends_on_mu),
            ("weights", self.weights.is_some() && !facts.needs_experts),
        ];
        given.into_iter().filter(|(_, is)| *is).map(|(name, _)| name).collect()
    }
}

impl CheckedGenerator<'_> {
    /// Loads the weights, if it needs any, and builds the generator. `loaded` is told of them before they are used.
    ///
    /// *Errors*: weights cannot be used, or have no dial.
    pub fn build(mut self, loaded: impl FnOnce(&NamedExperts)) -> Result<NamedGenerator> {
        let Self { registries, spec, method, selection, facts, variants, .. } = self;
        let objective = Some(selection.objective.spec());
        let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, objective)?;
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
            let dial = || {
                dial::of_weights(weights.as_ref(), &selection, &spec.merger, Some(&method.name), &mut notes)
            };
            spec.points.specs(range, dial)?
        } else {
            vec![OperatingPointSpec::at(1.0, None, range)?]
        };
        let built = self.generators.build(&method, &points)?;
        Ok(NamedGenerator { spec, method, selection, further, variants, weights, built, points, notes })
    }
}

impl NamedGenerator {
    /// Its attacks in a scene that is ready, one for each operating point.
    ///
    /// *Errors*: those of the generator and of the driver.
    pub fn attacks(&self, ctx: &Context, against: Against) -> Result<Vec<Attack>> {
        let attacks = self.built.attacks(ctx, against, self.spec.seed)?;
        attacks.iter().try_for_each(|attack| attack.check(ctx.scene()))?;
        Ok(attacks)
    }

    /// Name of the weights; `None` for a generator without experts.
    pub fn weights_name(&self) -> Option<&str> {
        self.weights.as_ref().map(|weights| &*weights.name)
    }

    /// What identifies its attacks in the record of a run.
    ///
    /// *Errors*: none on a CPU.
    pub fn identity(&self) -> Result<GeneratorIdentity<'_>> {
        let (mut weights, mut dials) = (Map::new(), Map::new());
        if let Some(NamedExperts { name, experts, .. }) = &self.weights {
            let mut hashes = weight_hashes(experts)?;
            hashes.extend(self.built.files.clone());
            weights.insert(name.clone(), hashes.into());
            if self.spec.points.aggression.is_some() && self.built.facts.uses_operating_point() {
                let dial = dial::find(name, experts, &self.selection).ok();
                dials.insert(name.clone(), json!(dial.map(|dial| dial.mu)));
            }
        }
        Ok(GeneratorIdentity {
            method: self.method.to_string(),
            weights,
            dials,
            selection: self.selection.objective.spec(),
            variants: &self.variants,
            seed: self.spec.seed,
            merger: self.spec.merger.to_string(),
            contents: self.selection.objective.contents(),
        })
    }

    /// How an attack at an operating point is generated, for its row and for the metadata of its scene files.
    pub fn generated_by(&self, point: &OperatingPointSpec) -> GeneratedBy {
        GeneratedBy {
            selection: Some(self.selection.objective.spec().clone()),
            ..GeneratedBy::at(&self.method, &self.spec.merger, Some(point))
        }
    }
}
