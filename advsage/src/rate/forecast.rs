//! A density that looks out: plans that touch the ego where the prior expects it are less likely.
//!
//! The other driver expects the ego on 32 plans of the same density, and a plan that touches the share m of them keeps (1 − m)¹⁶ of its
//! probability: 0.6 if it touches one. It looks out once, *now*, and never sees what the ego does then.

use sage_backbones::Backbone;
use sage_core::{
    generator::{Observation, Proposal},
    geometry::Point,
    objective::{Candidate, Context, EgoPaths, Encounter},
    seed::Rng,
};
use sage_generators::nominal_plans;
use sage_sim::rate::{inclusions, systematic};

use crate::Result;

/// Number of plans of the ego that the other driver expects.
const FORECASTS: usize = 32;
/// How much it avoids them: contacts with recorded egos are about as frequent as recorded.
const EXPONENT: f64 = 16.0;
/// Least share that is left of what does not touch the plan: its logarithm is finite.
const LEAST: f64 = 1e-3;

/// Where a density expects the ego; nowhere without goals for it.
pub struct Forecast(Option<Context>);

impl Forecast {
    /// The ego's plans by a prior at a temperature with some shifts of their timings, drawn as those of a rate are. `recorded` is
    /// the scene's context.
    ///
    /// *Errors*: the network's output is not finite.
    pub fn of(
        prior: &dyn Backbone,
        now: &Observation,
        recorded: &Context,
        temperature: f64,
        shifts: &[f64],
    ) -> Result<Self> {
        let ego = now.scene().ego;
        let plans = nominal_plans(prior, now, ego, temperature, shifts)?;
        let log_prob = |(plan, _): &(Proposal, f64)| plan.log_prob.unwrap_or(f64::NEG_INFINITY);
        let most = plans.iter().map(log_prob).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = plans.iter().map(|plan| (log_prob(plan) - most).exp()).collect();
        let mass: f64 = weights.iter().sum();
        let probabilities: Vec<f64> = weights.iter().map(|weight| weight / mass).collect();
        let end = |(plan, _): &(Proposal, f64)| plan.trajectory.points().last().copied().unwrap_or_default();
        let ends: Vec<Point> = plans.iter().map(end).collect();
        let inclusions = inclusions(&probabilities, FORECASTS);
        let start = Rng::new(0, &now.scene().id, "forecast").unit();
        let chosen = systematic(&ends, &inclusions, start);
        let weight = |k: usize| probabilities[k] / inclusions[k];
        let add = |paths: Option<EgoPaths>, k: usize| -> Result<Option<EgoPaths>> {
            let (what, points) = ("a forecast of the ego", plans[k].0.trajectory.points().to_vec());
            Ok(Some(match paths {
                None => EgoPaths::one(what, points, None)?,
                Some(paths) => paths.and(what, weight(k) / weight(chosen[0]), points, None)?,
            }))
        };
        let paths = chosen.iter().copied().try_fold(None, add)?;
        Ok(Self(paths.map(|paths| recorded.with_ego(&paths)).transpose()?))
    }

    /// What a driver who looks out adds to the log-probability of a plan.
    pub fn log_factor(&self, plan: &Candidate) -> f64 {
        let Some(expected) = &self.0 else { return 0.0 };
        let touches = |path: &&_| Encounter::of(plan, path).contact.is_some();
        let touched: f64 = expected.egos().iter().filter(touches).map(|path| path.weight()).sum();
        // Where every plan touches all, none is less likely than another.
        EXPONENT * (1.0 - touched).max(LEAST).ln()
    }
}
