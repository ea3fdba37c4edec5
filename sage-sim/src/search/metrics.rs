//! Metrics of searches and of thresholds.

use sage_core::{
    Error,
    metric::{Metric, Metrics},
    objective::{Context, kinematic_penalty},
};

use super::{Clause, Evaluated, Failure, Pool, PoolPlan, Reason, SearchResult, threshold};

/// Numbers of drives at which the any-time metrics look.
pub const BUDGETS: [usize; 8] = [1, 2, 4, 8, 16, 32, 64, 128];

/// A search of a scene.
pub struct MeasuredSearch {
    /// What it found.
    pub result: SearchResult,
    /// Number of plans of its pool.
    pub plans: usize,
    /// Largest number of drives.
    pub budget: usize,
    /// Whether the adversary is a pedestrian or cyclist.
    pub is_person: bool,
    /// Negative log-likelihood under the prior and kinematic penalty of the likeliest failure.
    pub likeliest: Option<(Option<f64>, f64)>,
}

impl MeasuredSearch {
    /// A search with its pool.
    pub fn new(result: SearchResult, pool: &Pool, budget: usize, ctx: &Context) -> Self {
        let plan = |failure: &Failure| &pool.plans[result.driven[failure.drive].plan];
        let strain = |plan: &PoolPlan| (plan.proposal.nll, kinematic_penalty(plan.candidate.profile()));
        let likeliest = result.likeliest(pool).map(|failure| strain(plan(failure)));
        let is_person = ctx.adversary().kind.is_person();
        Self { plans: pool.plans.len(), budget, is_person, likeliest, result }
    }

    /// Drives until the first that meets a clause and the ones before it; `None` without one.
    fn first(&self, clause: Clause) -> Option<usize> {
        let meets = |evaluated: &Evaluated| evaluated.clauses.reach(clause);
        self.result.driven.iter().position(meets).map(|k| k + 1)
    }

    /// Whether a drive is something, if the adversary is a person.
    fn of_person(&self, is: impl Fn(&Evaluated) -> bool) -> Option<bool> {
        self.is_person.then(|| self.result.driven.iter().any(is))
    }

    fn first_failure(&self) -> Option<usize> {
        self.result.failures.first().map(|failure| failure.drive + 1)
    }

    /// Drives that a search which stops at the first failure takes.
    fn spent(&self) -> usize {
        self.first_failure().unwrap_or(self.result.driven.len())
    }
}

/// Metrics of a search.
///
/// *Errors*: two have the same name.
pub fn search_metrics() -> Result<Metrics<MeasuredSearch>, Error> {
    type S = MeasuredSearch;
    let found = |name: &'static str, clause| {
        Metric::share(name, move |s: &S| Some(s.first(clause).is_some())).more_is_better()
    };
    let of_person = |name: &'static str, also: &'static [Clause]| {
        Metric::share(name, move |s: &S| {
            s.of_person(|evaluated| {
                evaluated.clauses.reach(Clause::Preventable)
                    && also.iter().all(|clause| evaluated.clauses.holds(*clause))
            })
        })
    };
    let by_reason = |reason: Reason| {
        let name = serde_json::to_value(reason).ok().and_then(|name| name.as_str().map(str::to_owned));
        Metric::share(format!("reason: {}", name.unwrap_or_default()), move |s: &S| {
            Some(s.result.reason == Some(reason))
        })
        .about(reason.words())
    };
    let believable_in = |budget: usize| {
        Metric::share(format!("believable in {budget}"), move |s: &S| {
            (budget <= s.budget).then(|| s.first(Clause::Believable).is_some_and(|first| first <= budget))
        })
        .about("within so many drives")
    };
    let failure_in = |budget: usize| {
        Metric::share(format!("failure in {budget}"), move |s: &S| {
            (budget <= s.budget).then(|| s.first_failure().is_some_and(|first| first <= budget))
        })
        .about("within so many drives")
    };
    Metrics::default()
        .with_all([
            found("attack", Clause::Attack).about("a plan is an attack on the driver"),
            found("believable", Clause::Believable).about("a plan is a believable attack"),
            found("at fault", Clause::AtFault).about("a plan is a believable attack in which the driver is at fault"),
            found("avoidable", Clause::Avoidable)
                .about("the same, and an evasive manoeuvre exists, knowing the plan; asked where references are"),
            of_person("human time", &[Clause::HumanTime])
                .about("the same with a preventable contact that leaves a person 0.75 s to react"),
            of_person("human time r157", &[Clause::HumanTimeR157]).about("the same with 1.15 s"),
            of_person("strict human time", &[Clause::HumanTime, Clause::Strict])
                .about("the same with 0.75 s, by a person of at most 5 km/h on foot, 15 km/h by bicycle"),
            Metric::share("failure by a witness", |s: &S| {
                let clauses = [Clause::Attack, Clause::Believable, Clause::AtFault, Clause::Avoidable, Clause::HumanTime];
                s.of_person(|evaluated| clauses.iter().all(|clause| evaluated.clauses.holds(*clause)))
            })
            .about("of people: believable, at fault, an evasive manoeuvre exists, and a person has 0.75 s to react"),
            Metric::share("failure", |s: &S| Some(!s.result.failures.is_empty()))
                .about("a plan meets all required clauses")
                .with_note(|s| s.result.reason.map(|reason| reason.words().to_owned()))
                .more_is_better(),
            Metric::mean("failures", |s: &S| Some(s.result.failures.len() as f64))
                .about("drives that meet all required clauses"),
            Metric::mean("drives", |s: &S| Some(s.result.driven.len() as f64)).about("attacked drives of a scene"),
            Metric::mean("spent", |s: &S| Some(s.spent() as f64))
                .about("drives until the first failure, or all")
                .less_is_better(),
            Metric::mean("failures a drive", |s: &S| {
                let is_found = s.first_failure().is_some();
                (s.spent() > 0).then(|| f64::from(u8::from(is_found)) / s.spent() as f64)
            })
            .about("scenes with a failure by the drives until the first, or all")
            .weighted_by("spent")
            .more_is_better(),
            Metric::mean("first failure", |s: &S| s.first_failure().map(|first| first as f64))
                .about("drives until the first failure, of the scenes with one"),
            Metric::mean("likeliest nll", |s: &S| s.likeliest?.0)
                .about("negative log-likelihood under the prior of the likeliest failure, of the scenes with one")
                .less_is_better(),
            Metric::mean("likeliest P_kin", |s: &S| Some(s.likeliest?.1))
                .about("kinematic penalty of that failure")
                .less_is_better(),
            Metric::mean("plans", |s: &S| Some(s.plans as f64)).about("plans of the pool"),
            Metric::share("error", |s: &S| Some(s.result.driven.iter().any(|evaluated| evaluated.error.is_some())))
                .about("a drive ended in an error of the driver")
                .less_is_better(),
        ])?
        .with_all(BUDGETS.map(believable_in))?
        .with_all(BUDGETS.map(failure_in))?
        .with_all(Reason::ALL.map(by_reason))
}

/// What a driver does along λ: one plan at each point.
pub struct MeasuredThreshold {
    /// λ of each point, rising.
    pub lambdas: Vec<f64>,
    /// Whether the driver fails there.
    pub fails: Vec<bool>,
    /// Whether the plan at the largest λ is a failure without the last clause: a believable attack in which the driver is at
    /// fault.
    pub at_fault_last: bool,
    /// Whether nuPlan's rule gives the first contact of the unattacked drive to the ego.
    pub at_fault_unattacked: bool,
}

impl MeasuredThreshold {
    /// λ of the threshold.
    fn lambda(&self) -> Option<f64> {
        Some(self.lambdas[threshold::threshold(&self.fails)?])
    }
}

/// Grid of the curve of thresholds.
const GRID: usize = 20;

/// Metrics of thresholds.
///
/// *Errors*: two have the same name.
pub fn threshold_metrics() -> Result<Metrics<MeasuredThreshold>, Error> {
    type T = MeasuredThreshold;
    let up_to = |k: usize| {
        let limit = k as f64 / GRID as f64;
        Metric::share(format!("threshold up to {limit}"), move |t: &T| {
            Some(t.lambda().is_some_and(|lambda| lambda <= limit + 1e-9))
        })
        .about("lambda is at most this")
    };
    Metrics::default()
        .with_all([
            Metric::mean("area", |t: &T| Some(t.lambda().map_or(0.0, |lambda| 1.0 - lambda)))
                .about("area under the share of scenes whose threshold is at most lambda, over lambda from 0 to 1")
                .less_is_better(),
            Metric::share("threshold", |t: &T| Some(t.lambda().is_some()))
                .about("there is a lambda from which the driver fails at three consecutive points, or at all up to 1")
                .less_is_better(),
            Metric::median("median threshold", T::lambda).about("of the scenes that have one"),
            Metric::share("at-fault attack", |t: &T| Some(t.at_fault_last))
                .about("at the largest lambda: a believable attack in which the driver is at fault")
                .less_is_better(),
            Metric::share("at-fault contact", |t: &T| Some(t.at_fault_unattacked))
                .about("in the unchanged scene: nuPlan's rule gives the first contact to the driver")
                .less_is_better(),
        ])?
        .with_all((0..=GRID).map(up_to))
}
