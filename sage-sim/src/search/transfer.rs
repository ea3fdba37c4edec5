//! Plans that were made against one driver, driven by another.

use sage_core::{
    Error,
    metric::{Metric, Metrics},
};

use super::{Clause, Evaluated};

/// What a driver does against a plan that was made against another driver, or against itself.
pub struct MeasuredTransfer {
    /// The attacked drive; `None` if the plan is not feasible.
    pub evaluated: Option<Evaluated>,
}

impl MeasuredTransfer {
    /// Whether the drive meets a clause and the ones before it.
    fn meets(&self, clause: Clause) -> bool {
        self.evaluated.as_ref().is_some_and(|evaluated| evaluated.clauses.reach(clause))
    }

    /// The drive, if the plan is an attack on the driver.
    fn attack(&self) -> Option<&Evaluated> {
        self.evaluated.as_ref().filter(|evaluated| evaluated.clauses.attack)
    }
}

/// Metrics of a transfer.
///
/// *Errors*: two have the same name.
pub fn transfer_metrics() -> Result<Metrics<MeasuredTransfer>, Error> {
    type T = MeasuredTransfer;
    let share =
        |name: &'static str, clause| Metric::share(name, move |t: &T| Some(t.meets(clause))).more_is_better();
    Metrics::default().with_all([
        share("attack", Clause::Attack).about("the plan is an attack on the driver"),
        share("believable", Clause::Believable).about("the plan is a believable attack"),
        share("at fault", Clause::AtFault).about("a believable attack in which the driver is at fault"),
        share("failure", Clause::Preventable).about("the same, and a reference driver prevents the contact"),
        Metric::share("unavoidable", |t: &T| Some(!t.attack()?.clauses.holds(Clause::Avoidable)))
            .about("no evasive manoeuvre was found, of the attacks")
            .less_is_better(),
        Metric::share("unavoidable, R157", |t: &T| Some(t.attack()?.latest_start_r157.is_none()))
            .about("none within the limits of UN R157's driver, of the attacks")
            .less_is_better(),
        Metric::mean("impact", |t: &T| Some(t.attack()?.contact.as_ref()?.impact_speed))
            .unit("m/s")
            .about("relative speed at the contact, of the attacks"),
    ])
}
