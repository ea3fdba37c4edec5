//! How often a plan is driven beside its probability: plans that would meet the driver's unattacked drive more often.
//!
//! Any positive weights leave the estimate without bias; these make it vary less, because most failures are among the plans that touch
//! the drive that the driver would make without them, or pass near it.

use sage_core::objective::{Candidate, Context, Encounter};

/// Least weight: what counts more than ten times its drives makes an estimate vary.
pub(super) const LEAST: f64 = 0.1;
/// Distance of the centres up to which a plan counts in full, metres.
const NEAR: f64 = 4.0;
/// Further distance at which it counts e times less, metres.
const DECAY: f64 = 3.0;
/// Factor of a plan that does not meet the headline's condition: the other condition is estimated too.
pub(super) const BESIDE: f64 = 0.3;

/// The weight of a plan. `ctx` is that of the unattacked drive.
pub(super) fn importance(plan: &Candidate, ctx: &Context) -> f64 {
    let Encounter { contact, least_distance, .. } = Encounter::of(plan, ctx.ego());
    match contact {
        Some(_) => 1.0,
        None => (-(least_distance - NEAR).max(0.0) / DECAY).exp(),
    }
}
