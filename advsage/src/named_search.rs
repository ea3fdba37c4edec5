//! A search as a user names it, with all that its plans are built from.

use sage_core::{
    generator::Observation,
    objective::{Context, ContextOptions},
};
use sage_generators::Facts;
use sage_sim::search::{MOST_PLANS, Pool, SearchOptions, SearchResult, Watch};

use crate::{
    Error, Registries, Result, dial,
    generators::Generators,
    named_generator::GeneratorSpec,
    operating_point::OperatingPointSpec,
    part::Part,
    prepared::DriverInScene,
    rate::{Density, DensityIdentity, DensitySpec, probability_near},
    search::{self, POOL, PlanSources},
    selection::Selection,
    weights::NamedExperts,
};

/// What a user says of the plans of a search: those of a generator, or of the default pool if it names none.
///
/// ```
/// use std::{path::Path, sync::Arc};
///
/// use advsage::{DriverInScene, Ego, GeneratorSpec, Recording, Registries, SearchOptions, SearchSpec};
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let registries = Registries::of_attacks()?;
/// let scene = Arc::new(Recording::read(file)?.scene);
/// let driver = Ego::named("constant-speed", &registries)?;
/// let driven = DriverInScene::of(&scene, &driver, 0)?;
///
/// // The plans are 32 candidates of SAGE at λ = 1; the driver is tried against four of them.
/// let generator = GeneratorSpec::named("sage")?.at(1.0, None);
/// let search = SearchSpec { generator, plans: 32 }.build(&registries)?;
/// let options = SearchOptions { budget: 4, require: "attack".parse()?, ..SearchOptions::default() };
/// let (pool, found) = search.search(&driven, &options, 0)?;
/// assert!(pool.plans.len() <= 32 && found.driven.len() <= 4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct SearchSpec {
    /// The generator. Its rule says what feasible means (`drivable` if it names none), its selection that of a generator that plans against
    /// the ego.
    pub generator: GeneratorSpec,
    /// Largest number of plans.
    pub plans: usize,
}

/// What searches scenes, apart from the driver.
pub struct NamedSearch {
    /// Its rule decides which plans are feasible.
    pub rule: Selection,
    /// The generator that the user names, and what it depends on.
    pub method: Option<(Part, Facts)>,
    /// The selection of the user.
    pub selection: Selection,
    /// `None` if no plan needs experts.
    pub weights: Option<NamedExperts>,
    /// Operating points that the user gives; none for the default ones.
    pub points: Vec<OperatingPointSpec>,
    /// Where plans come from.
    pub plans: PlanSources,
    /// Density under which failures have a probability: that of the weights, if it is calibrated.
    density: Option<Density>,
    /// What the user should know, besides the notes of the weights.
    pub notes: Vec<String>,
}

impl Default for SearchSpec {
    /// The pool that `sage search` proposes.
    fn default() -> Self {
        Self { generator: GeneratorSpec::default(), plans: MOST_PLANS }
    }
}

impl SearchSpec {
    /// Checks everything, loads weights and builds the generators.
    ///
    /// *Errors*: an option is out of range or names an unknown part; weights cannot be used.
    pub fn build(self, registries: &Registries) -> Result<NamedSearch> {
        self.build_with(registries, |_| {})
    }

    /// The same; `loaded` is told of the weights before they are used.
    ///
    /// *Errors*: as [`SearchSpec::build`].
    pub fn build_with(
        self,
        registries: &Registries,
        loaded: impl FnOnce(&NamedExperts),
    ) -> Result<NamedSearch> {
        let Self { generator: spec, plans } = self;
        spec.points.check().map_err(Error::Value)?;
        let has_options = spec.options.as_ref().is_some_and(|options| !options.0.is_empty());
        if spec.method.is_none() && has_options {
            return Err(Error::Value("options need a generator; name it, such as sage".to_owned()));
        }
        let rule = search::rule(registries, spec.feasibility.as_ref())?;
        let of_rule = Generators::new(registries, &spec.merger, &rule, spec.seed)?;
        let method = spec.method.as_ref().map(|_| spec.part());
        let method = method.map(|method| Ok::<_, crate::Error>((of_rule.facts(&method)?, method)));
        let method = method.transpose()?.map(|(facts, method)| (method, facts));
        let selection = Selection::of(registries, &spec.selection, spec.feasibility.as_ref())?;
        // Of a generator that plans against the ego the selection is the plan; of the others every candidate is one.
        let facts = method.as_ref().map(|(_, facts)| facts);
        let mut generators = if facts.is_some_and(|facts| facts.plans_against_ego) {
            Generators::new(registries, &spec.merger, &selection, spec.seed)?
        } else {
            of_rule
        };
        let mut weights = None;
        if facts.is_none_or(|facts| facts.needs_experts) {
            let needs_experts = facts.is_none_or(|facts| facts.depends_on_lambda);
            let named =
                NamedExperts::load_for(&registries.backbones, spec.weights.as_deref(), needs_experts)?;
            loaded(&named);
            generators = generators.with_experts(&named.experts);
            weights = Some(named);
        }
        let mut notes = Vec::new();
        let range = generators.merger().range();
        let points = spec.points.specs(range, || {
            dial::of_weights(weights.as_ref(), &selection, &spec.merger, None, &mut notes)
        })?;
        let plans = match &method {
            Some((method, _)) => PlanSources::of_generator(&generators, method, &points, plans)?,
            None => PlanSources::pool(&generators, &points, plans)?,
        };
        let density = weights
            .as_ref()
            .map(|named| DensitySpec::default().build(&named.name, named.experts.prior().clone()));
        let density = density.transpose()?;
        if let Some(density) = &density {
            let unknown = density.notes.iter();
            notes.extend(unknown.map(|note| format!("{note}; failures have no probability")));
        }
        let density = density.filter(|density| density.notes.is_empty());
        Ok(NamedSearch { rule, method, selection, weights, points, plans, density, notes })
    }
}

impl NamedSearch {
    /// Searches a scene for plans that its driver fails at.
    ///
    /// *Errors*: those of the generators; an error of the driver before the first attack.
    pub fn search(
        &self,
        driver: &DriverInScene,
        options: &SearchOptions,
        seed: u64,
    ) -> Result<(Pool, SearchResult)> {
        self.search_watched(driver, options, seed, None)
    }

    /// The same; `watch` sees what it has found after each drive. Probabilities come at the end.
    ///
    /// *Errors*: as [`NamedSearch::search`].
    pub fn search_watched(
        &self,
        driver: &DriverInScene,
        options: &SearchOptions,
        seed: u64,
        watch: Option<Watch>,
    ) -> Result<(Pool, SearchResult)> {
        let (pool, mut result) =
            self.plans.search(&driver.test, &driver.ctx, &self.rule.objective, options, seed, watch)?;
        self.weigh(driver, &pool, &mut result)?;
        Ok((pool, result))
    }

    /// Gives failures their probabilities.
    fn weigh(&self, driver: &DriverInScene, pool: &Pool, result: &mut SearchResult) -> Result<()> {
        let ctx = &driver.ctx;
        let Some(density) = &self.density else { return Ok(()) };
        if result.failures.is_empty() || ctx.adversary().kind.is_person() {
            return Ok(());
        }
        // The density knows the recording, not what this driver does: it is the same for all drivers.
        let recorded = Context::new(driver.test.scene(), ctx.index(), &ContextOptions::default())?;
        let plans = density.plans(&Observation::of(recorded.scene(), recorded.index())?, &recorded)?;
        for failure in &mut result.failures {
            let driven = &result.driven[failure.drive];
            let steps = driven.contact.as_ref().map_or(0, |met| usize::try_from(met.step).unwrap_or(0));
            let plan = &pool.plans[driven.plan].proposal.trajectory;
            failure.probability = Some(probability_near(&plans, plan, steps));
        }
        Ok(())
    }

    /// What identifies the density of its failures' probabilities.
    pub fn density(&self) -> Option<DensityIdentity> {
        self.density.as_ref().map(Density::identity)
    }

    /// Name of the plans in rows and tables.
    pub fn method(&self) -> String {
        self.method.as_ref().map_or(POOL.to_owned(), |(method, _)| method.to_string())
    }
}
