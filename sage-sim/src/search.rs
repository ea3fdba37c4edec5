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
pub mod features;
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
};

pub use circumstances::Circumstances;
pub use clauses::{Clause, Clauses, Reason, Requirement};
pub use evaluation::{AttackedPath, Evaluated, PlanDrives};
pub use features::Features;
pub use met::Met;
pub use metrics::{MeasuredSearch, MeasuredThreshold, search_metrics, threshold_metrics};
pub use pool::{MOST_PLANS, Pool, PoolCounts, PoolPlan};
pub use transfer::{MeasuredTransfer, transfer_metrics};

use evaluation::Evaluator;
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

    /// The failure that is likeliest under the prior, then the one with the least kinematic penalty, then the first.
    pub fn mildest(&self, pool: &Pool) -> Option<&Failure> {
        let strain = |failure: &Failure| {
            let plan = &pool.plans[self.driven[failure.drive].plan];
            // A plan of unknown likelihood comes after all others.
            let nll = plan.proposal.nll.unwrap_or(f64::INFINITY);
            (nll, kinematic_penalty(plan.candidate.profile()))
        };
        let is_milder = |a: (f64, f64), b: (f64, f64)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)).is_lt();
        self.failures
            .iter()
            .reduce(|best, other| if is_milder(strain(other), strain(best)) { other } else { best })
    }
}

/// Plans anew against the newest drive, for generators whose plans depend on it. Each plan has the number of its source.
pub type Replan<'r> = dyn FnMut(&Context) -> Result<Vec<(usize, Proposal)>, CoreError> + 'r;

/// Searches a scene. `ctx` is that of the unattacked drive ([`AttackTest::context`]); the pool is filled up by `replan`,
/// whenever it has no plan left.
///
/// *Errors*: those of `replan`, and options of the search for evasive manoeuvres that are out of range. An error of the
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
/// use sage_sim::{attack_test::AttackTest, search::{Pool, SearchOptions, search}};
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
/// let found = search(&test, &ctx, &*rule, &mut pool, &options, 0, None)?;
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
    mut replan: Option<&mut Replan>,
) -> Result<SearchResult, Error> {
    options.check()?;
    let evaluator = Evaluator::new(test, ctx, options.require, options.avoidable);
    let mut surrogate = Surrogate::new(ctx, options.require);
    let mut refiner = Refiner::new(ctx, options, seed)?;
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
            result.failures.push(Failure { drive, path, avoidable, circumstances });
        }
        result.driven.push(evaluated);
        newest = Some(path);
        if options.first && !result.failures.is_empty() {
            break;
        }
    }
    result.left = is_driven.iter().filter(|is| !**is).count();
    // A generator that plans anew could have gone on.
    let is_cut = result.left > 0 || replan.is_some() && result.driven.len() >= options.budget;
    result.explain(options.require, is_cut);
    Ok(result)
}

impl SearchResult {
    /// Says why there is no failure.
    fn explain(&mut self, requirement: Requirement, is_cut: bool) {
        if !self.failures.is_empty() {
            return;
        }
        let without_error = || self.driven.iter().filter(|evaluated| evaluated.error.is_none());
        let best = without_error().map(|evaluated| {
            let met = evaluated.contact.is_some();
            let missing = evaluated.clauses.first_missing(requirement).unwrap_or(Clause::Preventable);
            if missing == Clause::Attack && !met { Reason::NeverHit } else { Reason::missing(missing) }
        });
        self.reached = best.max();
        self.reason = Some(match self.reached {
            None if self.driven.is_empty() => Reason::NoFeasiblePlan,
            None => Reason::Error,
            Some(_) if is_cut => Reason::Budget,
            Some(reached) => reached,
        });
    }
}
