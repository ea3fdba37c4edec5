//! What is measured of a plan, and of a driver's drive against it, with their metrics.

use std::sync::Arc;

use advsage::latest_start::WITHIN;
use sage_core::{
    metric::{MeasuredTrajectory, Metric, Metrics},
    objective::FurtherMeasures,
};
use sage_sim::{avoidable::Avoidable, metrics::MeasuredAttack};

use crate::{Registries, Result, study::Study};

/// What was measured of a plan.
#[derive(Default)]
pub struct MeasuredPlan {
    pub(super) trajectory: Option<Arc<MeasuredTrajectory>>,
    pub(super) avoidable: Option<Avoidable>,
    /// Share of the ego's predictions that it touches.
    pub(in crate::measure) samples_hit: Option<f64>,
    pub(super) choice: Option<Choice>,
}

/// A choice by the latest start of an evasive manoeuvre.
pub struct Choice {
    /// Time that is aimed at, s.
    pub target: f64,
    /// Time of the chosen candidate; `None` if no candidate is an avoidable attack.
    pub time: Option<f64>,
}

impl MeasuredPlan {
    /// Whether it is an attack on the ego's path.
    pub(in crate::measure) fn is_attack(&self) -> bool {
        self.trajectory.as_deref().is_none_or(MeasuredTrajectory::is_attack)
    }

    fn avoidable_attack(&self) -> Option<&Avoidable> {
        self.avoidable.as_ref().filter(|_| self.is_attack())
    }
}

/// An attacked drive, and the plan against the path that it was made for.
pub(super) struct PlanAndDrive {
    pub attack: MeasuredAttack,
    pub plan: Option<Arc<MeasuredTrajectory>>,
}

/// Prefix of metrics of the plan among those of attacked drives.
pub(super) const OF_PLAN: &str = "plan: ";

/// Metrics of attacked drives, and those of their plans that are listed.
pub(super) fn attacked_metrics(registries: &Registries, listed: &[String]) -> Result<Metrics<PlanAndDrive>> {
    let of_drive =
        registries.metrics.attack.all().iter().map(|m| m.of_part(|a: &PlanAndDrive| Some(&a.attack)));
    let names: Vec<String> =
        listed.iter().filter_map(|name| Some(name.strip_prefix(OF_PLAN)?.to_owned())).collect();
    let of_plan = registries.metrics.trajectory.by_names(&names)?.into_iter().map(|metric| {
        let mut metric = metric.of_part(|a: &PlanAndDrive| a.plan.as_deref());
        metric.info.name = format!("{OF_PLAN}{}", metric.info.name).into();
        metric
    });
    Ok(Metrics::default().with_all(of_drive.chain(of_plan))?)
}

/// Metrics of a choice by the latest start.
fn choice_metrics() -> [Metric<Choice>; 4] {
    let is_within = |c: &Choice| c.time.is_some_and(|time| (time - c.target).abs() <= WITHIN + 1e-9);
    [
        Metric::share("within", move |c: &Choice| Some(is_within(c)))
            .about("the chosen latest start is within 0.25 s of the target")
            .more_is_better(),
        Metric::median("time within", move |c: &Choice| c.time.filter(|_| is_within(c)))
            .unit("s")
            .about("median of the latest starts within 0.25 s of the target"),
        Metric::median("time chosen", |c: &Choice| c.time)
            .unit("s")
            .about("median of all chosen latest starts"),
        Metric::share("choice", |c: &Choice| Some(c.time.is_some()))
            .about("a candidate is an avoidable attack")
            .more_is_better(),
    ]
}

/// All metrics of plans: of the trajectory with registered rewards and rules, of the search, of the choice.
pub(super) fn plan_metrics(
    registries: &Registries,
    further: &FurtherMeasures,
    study: &Study,
) -> Result<Metrics<MeasuredPlan>> {
    let own = registries.metrics.trajectory.clone().with_parts(further.rewards(), further.rules())?;
    let own = own.all().iter().map(|m| m.of_part(|p: &MeasuredPlan| p.trajectory.as_deref()));
    let of_search =
        registries.metrics.avoidable.all().iter().map(|m| m.of_part(MeasuredPlan::avoidable_attack));
    let of_choice = choice_metrics();
    let of_choice = of_choice.iter().filter(|_| !study.latest_start.is_empty());
    let of_choice = of_choice.map(|m| m.of_part(|p: &MeasuredPlan| p.choice.as_ref()));
    let of_samples = sample_metrics();
    Ok(Metrics::default()
        .with_all(own.chain(of_search).chain(of_samples).chain(of_choice).collect::<Vec<_>>())?)
}

/// Metrics of the predictions of the ego.
pub(super) fn sample_metrics() -> [Metric<MeasuredPlan>; 3] {
    type P = MeasuredPlan;
    let hits_all = |plan: &P| Some(plan.samples_hit? >= 1.0);
    [
        Metric::mean("predictions hit", |plan: &P| plan.samples_hit)
            .about("share of 32 predictions of the ego that the trajectory touches")
            .costly(),
        Metric::share("hits all predictions", hits_all).about("it touches all of them").costly(),
        Metric::share("hits all predictions, of the attacks", move |plan: &P| {
            hits_all(plan).filter(|_| plan.is_attack())
        })
        .about("the same, of the attacks")
        .costly(),
    ]
}
