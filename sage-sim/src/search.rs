//! Search with the driver in the loop: which plans of the adversary a driver fails at.
//!
//! A driver that reacts is elsewhere when the adversary comes, so a plan that is best against its unattacked drive need not
//! be an attack at all. The search drives against one plan of a [`Pool`] after the other. What it has seen decides which is
//! next (`search/surrogate.rs`), and four [`Clause`]s, each on the attacked drive, say whether a plan is a failure of the driver.
//!
//! It knows plans and drives, not generators. Where plans come from is a matter of `advsage`, so other programs can search
//! their own plans.
//!
//! Everything is deterministic: the same driver, pool and options give the same drives in the same order.

pub mod circumstances;
pub mod clauses;
pub mod evaluation;
pub mod explanation;
pub mod features;
mod holds;
pub mod manoeuvre;
mod met;
pub mod metrics;
pub mod onset;
pub mod passing;
pub mod pool;
mod refine;
pub mod suite;
mod surrogate;
pub mod threshold;
pub mod transfer;

use std::{cmp::Ordering, ops::ControlFlow};

use sage_core::{
    Error as CoreError,
    generator::Proposal,
    objective::{Context, Feasibility, kinematic_penalty},
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use crate::{
    Error,
    attack_test::AttackTest,
    avoidable::{Avoidable, AvoidanceOptions},
    policy::Shown,
};

pub use circumstances::Circumstances;
pub use clauses::{Clause, Clauses, Reason, Requirement};
pub use evaluation::{AttackedPath, Evaluated, PlanDrives};
pub use explanation::{Deviation, Explained, Explanation};
pub use features::Features;
pub use holds::Variation;
pub use met::Met;
pub use metrics::{MeasuredSearch, MeasuredThreshold, search_metrics, threshold_metrics};
pub use pool::{MOST_PLANS, Pool, PoolCounts, PoolPlan};
pub use transfer::{MeasuredTransfer, transfer_metrics};

use evaluation::Evaluator;
use explanation::Explainer;
use refine::Refiner;
use surrogate::Surrogate;

/// Share of the budget for refined plans by default.
pub const REFINE: f64 = 0.25;

/// Order in which plans are driven.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// What earlier drives make likely to fail comes first.
    #[default]
    Surrogate,
    /// Random, which shows what the surrogate is worth.
    Random,
    /// That of the pool.
    Pool,
}

/// How to search.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SearchOptions {
    /// Largest number of attacked drives; the unattacked one is not counted.
    pub budget: usize,
    /// What makes a plan a failure.
    pub require: Requirement,
    /// Whether the search ends at the first failure.
    pub first: bool,
    /// Order of the plans.
    pub order: Order,
    /// Share of the budget, at its end, for plans that are refined against what the driver did, 0 to 1: until the first failure, and
    /// earlier if the pool has no plan left. Only an order that learns from drives has them.
    pub refine: f64,
    /// Which failures are explained, by drives beyond the budget; none by default, as measurements need.
    pub explain: Explained,
    /// The search for an evasive manoeuvre.
    pub avoidable: AvoidanceOptions,
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self {
            budget: 64,
            require: Requirement::default(),
            first: false,
            order: Order::Surrogate,
            refine: REFINE,
            explain: Explained::None,
            avoidable: AvoidanceOptions::default(),
        }
    }
}

impl SearchOptions {
    /// *Errors*: [`CoreError::Options`] for a share that is none, or options of the search for manoeuvres out of range.
    fn check(&self) -> Result<(), CoreError> {
        if !(0.0..=1.0).contains(&self.refine) {
            let problem = format!("it is {}; expected a share of the budget, 0 to 1", self.refine);
            return Err(CoreError::Options { kind: "search", name: "refine", problem });
        }
        self.avoidable.check()
    }

    /// Number of drives from which on plans are refined; none if they never are.
    fn refined_from(&self) -> Option<usize> {
        let refined = (self.refine * self.budget as f64) as usize;
        (self.order == Order::Surrogate && refined > 0).then(|| self.budget - refined)
    }
}

/// A failure of the driver with what it takes to see it.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// Number of its drive among [`SearchResult::driven`].
    pub drive: usize,
    /// The ego's path in the attacked drive.
    pub path: AttackedPath,
    /// The last evasive manoeuvre of that drive.
    pub avoidable: Avoidable,
    /// Where the adversary comes from, lights, lines and the right of way.
    pub circumstances: Option<Circumstances>,
    /// How its plan differs from the recording; `None` if the adversary is not recorded up to the contact.
    pub deviation: Option<Deviation>,
    /// Probability that the adversary moves so up to the contact, under a nominal density; `None` without one.
    pub probability: Option<f64>,
    /// What explains it, if that was asked.
    pub explanation: Option<Explanation>,
    /// What the driver showed of its steps.
    pub shown: Vec<Shown>,
}

/// What a search found in a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchResult {
    /// All attacked drives, in their order.
    pub driven: Vec<Evaluated>,
    /// The failures, in the order in which they were found.
    pub failures: Vec<Failure>,
    /// Why there is no failure; `None` if there is one.
    pub reason: Option<Reason>,
    /// The clause that the best attack misses, whatever ended the search; `None` if there is a failure or no drive.
    pub reached: Option<Reason>,
    /// Number of plans that were not driven against.
    pub left: usize,
}

impl SearchResult {
    /// Number of drives that meet a clause and the ones before it.
    pub fn count(&self, clause: Clause) -> usize {
        self.driven.iter().filter(|evaluated| evaluated.clauses.reach(clause)).count()
    }

    /// The drive that meets the most clauses, each with the ones before it, then the one with the largest reward; the first
    /// of equals. `None` without a drive in which the driver gave no error.
    pub fn strongest(&self) -> Option<&Evaluated> {
        let rank = |evaluated: &Evaluated| {
            let met = Clause::ALL.into_iter().filter(|clause| evaluated.clauses.reach(*clause));
            (met.count(), evaluated.reward)
        };
        let is_stronger = |a: (usize, f64), b: (usize, f64)| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).is_gt();
        let driven = self.driven.iter().filter(|evaluated| evaluated.error.is_none());
        driven.reduce(|best, other| if is_stronger(rank(other), rank(best)) { other } else { best })
    }

    /// The failure with the largest reward; the first of equals.
    pub fn worst(&self) -> Option<&Failure> {
        let reward = |failure: &Failure| self.driven[failure.drive].reward;
        self.failures.iter().reduce(|best, other| if reward(other) > reward(best) { other } else { best })
    }

    /// The failure whose adversary is driven least differently from the recording ([`Deviation::acceleration`]), then the likeliest,
    /// then the first.
    pub fn mildest(&self, pool: &Pool) -> Option<&Failure> {
        let difference = |failure: &Failure| failure.deviation.map_or(f64::INFINITY, |d| d.acceleration);
        self.least(|failure| {
            let [nll, strain] = self.strain(failure, pool);
            [difference(failure), nll, strain]
        })
    }

    /// The failure with the largest probability, then the one whose goal is likeliest under the prior, then the one with the least
    /// kinematic penalty, then the first.
    pub fn likeliest(&self, pool: &Pool) -> Option<&Failure> {
        self.least(|failure| {
            let [nll, strain] = self.strain(failure, pool);
            [-failure.probability.unwrap_or(0.0), nll, strain]
        })
    }

    /// Negative log-likelihood and kinematic penalty. A plan of unknown likelihood comes after all others.
    fn strain(&self, failure: &Failure, pool: &Pool) -> [f64; 2] {
        let plan = &pool.plans[self.driven[failure.drive].plan];
        [plan.proposal.nll.unwrap_or(f64::INFINITY), kinematic_penalty(plan.candidate.profile())]
    }

    /// The failure with the least key, by its numbers in turn; the first of equals.
    fn least<const N: usize>(&self, key: impl Fn(&Failure) -> [f64; N]) -> Option<&Failure> {
        let is_less = |a: &Failure, b: &Failure| {
            let pairs = key(a).into_iter().zip(key(b));
            pairs.fold(Ordering::Equal, |order, (a, b)| order.then(a.total_cmp(&b))).is_lt()
        };
        self.failures.iter().reduce(|best, other| if is_less(other, best) { other } else { best })
    }
}

/// Plans anew against the newest drive, for generators whose plans depend on it. Each plan has the number of its source.
pub type Replan<'r> = Box<dyn FnMut(&Context) -> Result<Vec<(usize, Proposal)>, CoreError> + 'r>;

/// Sees what a search has found after each drive. A search that it breaks ends there, as if its budget were used up.
pub type Watch<'w> = Box<dyn FnMut(&Pool, &SearchResult) -> ControlFlow<()> + 'w>;

/// What takes part in a search while it goes on; nothing by default.
#[derive(Default)]
pub struct Hooks<'h> {
    /// Fills up the pool whenever it has no plan left.
    pub replan: Option<Replan<'h>>,
    /// Watches the search.
    pub watch: Option<Watch<'h>>,
}

/// Searches a scene. `ctx` is that of the unattacked drive ([`AttackTest::context`]).
///
/// *Errors*: those of [`Hooks::replan`], and options of the search for evasive manoeuvres that are out of range. An error of the
/// driver is no error of the search: the drive is noted and counts.
///
/// From plans to what a driver fails at in a `scene`, of which `simulated` is the [`SimScene`](crate::SimScene):
///
/// ```
/// # use std::sync::Arc;
/// # use sage_core::scene::SceneIndex;
/// # use sage_data::procedural::{Kind, attacks, generate};
/// # use sage_sim::{SimScene, policy::policies};
/// use sage_core::{generator::Proposal, objective::feasibilities};
/// use sage_sim::{attack_test::AttackTest, search::{Hooks, Pool, SearchOptions, search}};
///
/// # let scene = Arc::new(generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?);
/// # let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
/// let driver = policies()?.build_default("constant-speed")?;
/// let test = AttackTest::new(&*driver, &simulated, 0)?;
/// let (ctx, rule) = (test.context()?, feasibilities()?.build_default("paper")?);
///
/// // A pool holds the feasible ones of the plans; at most eight are driven against.
/// let plans = attacks(&scene).into_iter().map(|(_, plan)| Proposal::of(plan)).collect();
/// let mut pool = Pool::new(&ctx, &*rule, vec![plans], 256);
/// let options = SearchOptions { budget: 8, require: "attack,at-fault".parse()?, ..SearchOptions::default() };
/// let found = search(&test, &ctx, &*rule, &mut pool, &options, 0, Hooks::default())?;
/// assert!(found.driven.len() <= 8 && found.failures.is_empty() == found.reason.is_some());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn search(
    test: &AttackTest,
    ctx: &Context,
    rule: &dyn Feasibility,
    pool: &mut Pool,
    options: &SearchOptions,
    seed: u64,
    Hooks { mut replan, mut watch }: Hooks,
) -> Result<SearchResult, Error> {
    options.check()?;
    let evaluator = Evaluator::new(test, ctx, options.require, options.avoidable);
    let mut surrogate = Surrogate::new(ctx, options.require);
    // Its deformations and limits are those of cars.
    let refine = if ctx.adversary().kind.is_person() { 0.0 } else { options.refine };
    let mut refiner = Refiner::new(ctx, &SearchOptions { refine, ..*options }, seed)?;
    let mut random: Vec<usize> = (0..pool.plans.len()).collect();
    Rng::new(seed, &ctx.scene().id, "search").shuffle(&mut random);
    let mut result =
        SearchResult { driven: Vec::new(), failures: Vec::new(), reason: None, reached: None, left: 0 };
    let mut is_driven = vec![false; pool.plans.len()];
    let mut newest: Option<AttackedPath> = None;
    while result.driven.len() < options.budget {
        surrogate.see_plans(&pool.plans);
        let is_open = |k: &usize| !is_driven[*k];
        let mut next = match options.order {
            Order::Surrogate => surrogate.next(&is_driven),
            Order::Random => random.iter().copied().find(is_open),
            Order::Pool => (0..pool.plans.len()).find(is_open),
        };
        let is_empty = next.is_none() && replan.is_none();
        if let Some(refiner) = &mut refiner
            && result.failures.is_empty()
            && refiner.is_due(result.driven.len(), is_empty)
        {
            next = refiner.refine(pool, rule, ctx);
            if next.is_none() {
                continue;
            }
            surrogate.see_plans(&pool.plans);
            is_driven.push(false);
        }
        let Some(number) = next else {
            let Some(replan) = replan.as_mut() else { break };
            let against = match &newest {
                Some(path) => path.context(ctx)?,
                None => ctx.clone(),
            };
            let before = pool.plans.len();
            for (source, proposal) in replan(&against)? {
                pool.counts.proposed += 1;
                pool.add(ctx, rule, proposal, source);
            }
            is_driven.resize(pool.plans.len(), false);
            random.extend(before..pool.plans.len());
            if pool.plans.len() == before {
                break;
            }
            continue;
        };
        is_driven[number] = true;
        let plan = &pool.plans[number];
        let (outcome, path) = match evaluator.drive(plan) {
            Ok(driven) => driven,
            Err(error) => {
                result.driven.push(Evaluated::failed(number, error.to_string()));
                if watch.as_mut().is_some_and(|watch| watch(pool, &result).is_break()) {
                    break;
                }
                continue;
            }
        };
        let evaluated = evaluator.evaluate(number, plan, &outcome, &path)?;
        surrogate.see_drive(number, &path);
        if let Some(refiner) = &mut refiner {
            refiner.see_drive(plan, &evaluated, &path);
        }
        if evaluated.clauses.meet(options.require) {
            let (avoidable, circumstances) = evaluator.describe(plan, evaluated.contact.as_ref(), &path)?;
            let (drive, path) = (result.driven.len(), path.clone());
            let contact = evaluated.contact.as_ref().and_then(|met| usize::try_from(met.step).ok());
            let deviation = contact.and_then(|step| Deviation::of(ctx, &plan.candidate, step));
            let explanation = None;
            let shown = outcome.episode.drive.shown.iter().map(Shown::rounded).collect();
            let failure = Failure {
                drive,
                path,
                avoidable,
                circumstances,
                deviation,
                probability: None,
                explanation,
                shown,
            };
            result.failures.push(failure);
        }
        result.driven.push(evaluated);
        newest = Some(path);
        let is_stopped = watch.as_mut().is_some_and(|watch| watch(pool, &result).is_break());
        if is_stopped || options.first && !result.failures.is_empty() {
            break;
        }
    }
    result.left = is_driven.iter().filter(|is| !**is).count();
    // A generator that plans anew could have gone on.
    let is_cut = result.left > 0 || replan.is_some() && result.driven.len() >= options.budget;
    result.say_why(options.require, is_cut);
    let explainer = Explainer { test, ctx, rule, evaluator: &evaluator, options };
    for number in result.to_explain(options.explain, pool) {
        let failure = &result.failures[number];
        let evaluated = &result.driven[failure.drive];
        let explanation = explainer.explain(&pool.plans[evaluated.plan], evaluated, failure)?;
        result.failures[number].explanation = Some(explanation);
    }
    Ok(result)
}

impl SearchResult {
    /// Numbers of the failures that are explained.
    fn to_explain(&self, explained: Explained, pool: &Pool) -> Vec<usize> {
        match explained {
            Explained::None => Vec::new(),
            Explained::All => (0..self.failures.len()).collect(),
            Explained::Mildest => {
                let mildest = self.mildest(pool).map(|failure| failure.drive);
                self.failures.iter().position(|failure| Some(failure.drive) == mildest).into_iter().collect()
            }
        }
    }

    /// Says why there is no failure.
    fn say_why(&mut self, requirement: Requirement, is_cut: bool) {
        if !self.failures.is_empty() {
            return;
        }
        let without_error = self.driven.iter().filter(|evaluated| evaluated.error.is_none());
        let best = without_error.map(|evaluated| evaluated.missing(requirement).unwrap_or(Reason::Budget));
        self.reached = best.max();
        self.reason = Some(match self.reached {
            None if self.driven.is_empty() => Reason::NoFeasiblePlan,
            None => Reason::Error,
            Some(_) if is_cut => Reason::Budget,
            Some(reached) => reached,
        });
    }
}
