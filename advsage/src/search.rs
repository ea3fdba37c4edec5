//! Searches with the driver in the loop: which generators propose the plans, and the search of one scene.

use sage_core::{
    generator::{Attack, Proposal},
    objective::{Context, DrivableFeasibility, Objective, ObjectiveSpec, PartSpec, TermSpec, Weight},
    registry::Entry as _,
};
use sage_merging::{ADVERSARIAL, LAWFUL};
use sage_sim::{
    attack_test::AttackTest,
    search::{Hooks, Pool, Replan, SearchOptions, SearchResult, Watch, search},
};
use serde_json::{Map, Value, json};

use crate::{
    Registries, Result,
    generators::{Against, BuiltGenerator, Generators},
    operating_point::{OperatingPointSpec, RowKey},
    part::Part,
    selection::Selection,
};

/// Generators of the default pool.
pub(crate) const SAGE: &str = "sage";
const RANDOM: &str = "random";
/// Plans that the experts propose at each operating point of the pool.
const CANDIDATES: usize = 64;
/// Random goals of the pool. Fewer than half of them are feasible.
const RANDOM_CANDIDATES: usize = 256;
/// Least distance between the ends of the plans of one source, metres.
const APART: f64 = 2.0;
/// λ at which the experts propose by default.
pub const LAMBDAS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Mixtures with the lawful expert: the adversarial expert's weight; the rest is lawful.
const LAWFUL_SHARES: [f64; 2] = [0.5, 0.75];
/// Name of the default pool in rows and tables.
pub const POOL: &str = "pool";
/// Name of the single plan that `sage generate` selects.
pub const ONE_SHOT: &str = "one-shot";

/// The generators whose plans a search drives against.
pub struct PlanSources {
    built: Vec<BuiltGenerator>,
    /// Largest number of plans of a pool.
    most: usize,
    /// Whether only the plan that a generator selects is driven against.
    only_selected: bool,
}

impl PlanSources {
    /// The default pool: SAGE at several λ, mixtures with the lawful expert if there is one, and random goals. `points`
    /// replaces the λ.
    ///
    /// *Errors*: an operating point that the merger refuses.
    pub fn pool(generators: &Generators, points: &[OperatingPointSpec], most: usize) -> Result<Self> {
        let range = generators.merger().range();
        let mut points = points.to_vec();
        if points.is_empty() {
            for lambda in LAMBDAS.iter().rev() {
                points.push(OperatingPointSpec::at(*lambda, None, range)?);
            }
            let experts = generators.inputs().experts.as_ref();
            if experts.is_some_and(|experts| experts.experts().iter().any(|(name, _)| name == LAWFUL)) {
                for share in LAWFUL_SHARES {
                    let mix = [(ADVERSARIAL.to_owned(), share), (LAWFUL.to_owned(), 1.0 - share)];
                    points.push(OperatingPointSpec::mixed(&mix, None)?);
                }
            }
        }
        let part = |name: &str, options: &[(&str, Value)]| Part {
            name: name.to_owned(),
            options: options.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect(),
        };
        let sage = part(SAGE, &[("candidates", json!(CANDIDATES)), ("apart", json!(APART))]);
        let random = part(RANDOM, &[("candidates", json!(RANDOM_CANDIDATES))]);
        let built = vec![generators.build(&sage, &points)?, generators.build(&random, &points[..1])?];
        Ok(Self { built, most, only_selected: false })
    }

    /// The plans of one generator at operating points; by default SAGE's λ.
    ///
    /// *Errors*: the generator is not registered, or refuses its options or a point.
    pub fn of_generator(
        generators: &Generators,
        part: &Part,
        points: &[OperatingPointSpec],
        most: usize,
    ) -> Result<Self> {
        let range = generators.merger().range();
        let mut points = points.to_vec();
        if points.is_empty() {
            let facts = generators.facts(part)?;
            let lambdas = if facts.depends_on_lambda { &LAMBDAS[..] } else { &LAMBDAS[4..] };
            for lambda in lambdas.iter().rev() {
                points.push(OperatingPointSpec::at(*lambda, None, range)?);
            }
        }
        Ok(Self { built: vec![generators.build(part, &points)?], most, only_selected: false })
    }

    /// The plan that SAGE selects at each operating point, as `sage generate` does without options.
    ///
    /// *Errors*: an operating point that the merger refuses.
    pub fn one_shot(generators: &Generators, points: &[OperatingPointSpec]) -> Result<Self> {
        let built = vec![generators.build(&Part::named(SAGE), points)?];
        Ok(Self { built, most: points.len(), only_selected: true })
    }

    /// Hashes of the files beside the prior that the generators were built from.
    pub fn files(&self) -> Vec<&Map<String, Value>> {
        self.built.iter().map(|built| &built.files).filter(|files| !files.is_empty()).collect()
    }

    /// Generator and operating point of a source, by its number.
    pub fn source(&self, number: usize) -> Option<&RowKey> {
        self.built.iter().flat_map(|built| &built.keys).nth(number)
    }

    /// The feasible plans against the unattacked drive of a test. An adversary that reacts is driven once; its path is a plan. A
    /// generator that queries the driver plans against the unattacked drive: the search itself drives its plans, and counts them.
    ///
    /// *Errors*: those of the generators and of the driver.
    fn plans(&self, test: &AttackTest, ctx: &Context, rule: &Objective, seed: u64) -> Result<Pool> {
        let attacks = |built: &BuiltGenerator| built.attacks(ctx, Against::Drive(test), seed);
        Ok(Pool::new(ctx, rule.rule(), self.sources(ctx, attacks)?, self.most))
    }

    /// All plans of each source, whether feasible or not.
    ///
    /// *Errors*: those of the generators.
    pub fn proposals(&self, ctx: &Context, seed: u64) -> Result<Vec<Vec<Proposal>>> {
        self.sources(ctx, |built| built.attacks(ctx, Against::Recording, seed))
    }

    fn sources(
        &self,
        ctx: &Context,
        attacks: impl Fn(&BuiltGenerator) -> Result<Vec<Attack>>,
    ) -> Result<Vec<Vec<Proposal>>> {
        let mut sources = Vec::new();
        for built in &self.built {
            for attack in attacks(built)? {
                attack.check(ctx.scene())?;
                sources.push(self.candidates(built, attack));
            }
        }
        Ok(sources)
    }

    /// All candidates of an attack; of an upper bound the selected one.
    fn candidates(&self, built: &BuiltGenerator, mut attack: Attack) -> Vec<Proposal> {
        if self.only_selected || built.facts.is_upper_bound {
            vec![attack.candidates.swap_remove(attack.chosen)]
        } else {
            attack.candidates
        }
    }

    /// Searches a scene: draws the plans, and drives against them. A generator whose plans depend on the ego's path plans
    /// anew against the newest drive.
    ///
    /// *Errors*: those of the generators.
    pub fn search(
        &self,
        test: &AttackTest,
        ctx: &Context,
        rule: &Objective,
        options: &SearchOptions,
        seed: u64,
        watch: Option<Watch>,
    ) -> Result<(Pool, SearchResult)> {
        let mut pool = self.plans(test, ctx, rule, seed)?;
        // One shot is the plan that a generator selects, and no other.
        let refine = if self.only_selected { 0.0 } else { options.refine };
        let options = &SearchOptions { refine, ..*options };
        let anew = self.built.iter().find(|built| built.facts.plans_against_ego);
        let replan = |against: &Context| -> Result<Vec<(usize, Proposal)>, sage_core::Error> {
            let Some(built) = anew else { return Ok(Vec::new()) };
            let mut plans = Vec::new();
            for (source, attack) in built.planned(against, Against::Recording, seed)?.into_iter().enumerate()
            {
                attack.check(against.scene())?;
                plans.extend(self.candidates(built, attack).into_iter().map(|plan| (source, plan)));
            }
            Ok(plans)
        };
        let replan: Option<Replan> = if anew.is_some() { Some(Box::new(replan)) } else { None };
        let result = search(test, ctx, rule.rule(), &mut pool, options, seed, Hooks { replan, watch })?;
        Ok((pool, result))
    }
}

/// What feasible means in a search: a rule by name, `drivable` by default.
///
/// *Errors*: the rule is not registered.
pub fn rule(registries: &Registries, feasibility: Option<&Part>) -> Result<Selection> {
    let drivable = Part::named(DrivableFeasibility::NAME);
    let spec = likeliest(feasibility.unwrap_or(&drivable).spec());
    let objective = Objective::new(&spec, &registries.rewards, &registries.feasibilities)?;
    debug_assert!(objective.needs_prior(), "the selection of a search asks for likelihoods");
    Ok(Selection { name: "likeliest".to_owned(), objective })
}

/// An objective that prefers likely plans. A search takes all candidates, so what a generator selects does not matter; but
/// with this objective it computes the likelihoods, and selects at once.
fn likeliest(feasibility: PartSpec) -> ObjectiveSpec {
    let term = TermSpec {
        name: "nll".to_owned(),
        weight: Weight::Constant(-1.0),
        options: Map::new(),
        only_feasible: false,
    };
    ObjectiveSpec { terms: vec![term], feasibility, violation_weight: 0.0, believable_first: false }
}
