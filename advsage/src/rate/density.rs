//! The nominal density: an untuned prior at its fitted temperature, with the timings of recorded cars.
//!
//! Tuned experts are no density of traffic (the sets of the realistic one hold a fifth of the recorded ends), and refused as a prior
//! everywhere.

use std::sync::Arc;

use sage_backbones::Backbone;
use sage_core::{
    generator::{Observation, Proposal},
    geometry::distance,
    motion::Trajectory,
    objective::Context,
};
use sage_generators::nominal_plans;
use serde::{Deserialize, Serialize};

use super::{Coverage, Forecast, NominalCard, TEMPERATURES};
use crate::{Error, Result, WithContext as _, weights};

/// File beside a prior: its [`NominalCard`].
pub const NOMINAL_FILE: &str = "nominal.json";
/// Timings of a goal if no number is named.
pub const PROFILES: usize = 5;
/// Most timings of a goal.
pub const MOST_PROFILES: usize = 21;
/// Distance to a plan within which another is like it, metres.
const LIKE: f64 = 2.0;
/// Size limit of the card, bytes.
const LIMIT: u64 = 1 << 20;

/// What a user says of a nominal density.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensitySpec {
    /// Temperature; that of the weights if none.
    pub temperature: Option<f64>,
    /// Number of timings of a goal; 1 for its trajectory alone.
    pub profiles: usize,
    /// Whether the adversary looks out for where the ego is expected.
    pub aware: bool,
}

impl Default for DensitySpec {
    fn default() -> Self {
        Self { temperature: None, profiles: PROFILES, aware: false }
    }
}

/// A nominal density.
pub struct Density {
    /// Name of the weights.
    pub weights: String,
    /// Their prior.
    pub prior: Arc<dyn Backbone>,
    /// Temperature.
    pub temperature: f64,
    /// Shifts of the timings of a goal, metres.
    pub shifts: Vec<f64>,
    /// Whether the adversary looks out.
    pub is_aware: bool,
    /// How often recorded ends lie in its sets.
    pub coverage: Vec<Coverage>,
    /// What the user should know.
    pub notes: Vec<String>,
}

/// What identifies a density, besides its prior.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DensityIdentity {
    temperature: f64,
    shifts: Vec<f64>,
    aware: bool,
}

impl DensitySpec {
    /// The density of the prior of some weights.
    ///
    /// *Errors*: a temperature or a number of timings out of range; a card that cannot be read.
    pub fn build(&self, weights: &str, prior: Arc<dyn Backbone>) -> Result<Density> {
        self.temperature.map_or(Ok(()), check_temperature)?;
        if !(1..=MOST_PROFILES).contains(&self.profiles) {
            return Err(Error::Value(format!(
                "the number of profiles is {}; expected 1 to {MOST_PROFILES}",
                self.profiles
            )));
        }
        let (card, why) = match card(weights)? {
            Some(card) if card.prior == hash(&*prior)? => {
                (Some(card), format!("`{NOMINAL_FILE}` has no timing"))
            }
            Some(_) => (None, format!("`{NOMINAL_FILE}` is of another prior")),
            None => (None, format!("there is no `{NOMINAL_FILE}`")),
        };
        let mut unknown = Vec::new();
        let fitted = card.as_ref().map(|card| card.temperature);
        let temperature = self.temperature.or(fitted).unwrap_or_else(|| {
            unknown.push("whether the density is calibrated is not known, and its temperature is taken as 1");
            1.0
        });
        // Another temperature makes other sets, and so does looking out.
        let of_fit = card.as_ref().filter(|card| card.temperature == temperature);
        let of_fit = of_fit.filter(|_| !self.aware);
        let coverage = of_fit.map(|card| card.coverage.clone()).unwrap_or_default();
        let shifts = match card.and_then(|card| card.timing) {
            Some(timing) => timing.shifts(self.profiles),
            None => {
                if self.profiles > 1 {
                    unknown.push("a goal has one timing");
                }
                vec![0.0]
            }
        };
        let notes = match unknown.is_empty() {
            true => Vec::new(),
            false => vec![format!(
                "{why} of the weights `{weights}`, so {} (`sage calibrate --nominal` fits it)",
                unknown.join(", and "),
            )],
        };
        Ok(Density {
            weights: weights.to_owned(),
            prior,
            temperature,
            shifts,
            is_aware: self.aware,
            coverage,
            notes,
        })
    }
}

impl Density {
    /// What identifies it, besides the prior.
    pub fn identity(&self) -> DensityIdentity {
        let Self { temperature, shifts, is_aware, .. } = self;
        DensityIdentity { temperature: *temperature, shifts: shifts.clone(), aware: *is_aware }
    }

    /// Where it expects the ego. `recorded` is the scene's context.
    ///
    /// *Errors*: the network's output is not finite.
    pub fn forecast(&self, now: &Observation, recorded: &Context) -> Result<Forecast> {
        Forecast::of(&*self.prior, now, recorded, self.temperature, &self.shifts)
    }

    /// The plans of the adversary, each with the shift of its timing. `recorded` is the scene's context.
    ///
    /// *Errors*: a scene without an adversary that is valid *now*.
    pub fn plans(&self, now: &Observation, recorded: &Context) -> Result<Vec<(Proposal, f64)>> {
        let adversary = now.scene().adversary_index()?;
        let mut plans = nominal_plans(&*self.prior, now, adversary, self.temperature, &self.shifts)?;
        if self.is_aware {
            let forecast = self.forecast(now, recorded)?;
            for (plan, _) in &mut plans {
                let factor = forecast.log_factor(&recorded.candidate(plan.trajectory.clone()));
                plan.log_prob = plan.log_prob.map(|log_prob| log_prob + factor);
            }
        }
        Ok(plans)
    }
}

/// Probability of the plans of a density that stay within 2 m of a plan at each of its first steps.
///
/// ```
/// use advsage::rate::probability_near;
/// use sage_core::{generator::Proposal, motion::Trajectory};
///
/// // Three cars at 10 m/s in lanes 3 m apart; the one in the middle is as likely as the two others.
/// let lane = |y: f64| Trajectory::new("plan", (1..=80).map(|step| [f64::from(step), y]).collect());
/// let plan = |y, p: f64| Ok::<_, sage_core::Error>((Proposal { log_prob: Some(p.ln()), ..Proposal::of(lane(y)?) }, 0.0));
/// let density = [plan(-3.0, 1.0)?, plan(0.0, 2.0)?, plan(3.0, 1.0)?];
/// assert!((probability_near(&density, &lane(0.5)?, 80) - 0.5).abs() < 1e-12);
/// assert_eq!(probability_near(&density, &lane(9.0)?, 80), 0.0);
/// # Ok::<(), sage_core::Error>(())
/// ```
pub fn probability_near(density: &[(Proposal, f64)], plan: &Trajectory, steps: usize) -> f64 {
    let log_prob = |(plan, _): &(Proposal, f64)| plan.log_prob.unwrap_or(f64::NEG_INFINITY);
    let most = density.iter().map(log_prob).fold(f64::NEG_INFINITY, f64::max);
    let is_like = |other: &Trajectory| {
        let pairs = plan.points().iter().zip(other.points()).take(steps);
        // The last step first: it is where most plans differ most.
        pairs.rev().all(|(a, b)| distance(*a, *b) <= LIKE)
    };
    let (mut near, mut all) = (0.0, 0.0);
    for plan in density {
        let weight = (log_prob(plan) - most).exp();
        all += weight;
        if weight > 0.0 && is_like(&plan.0.trajectory) {
            near += weight;
        }
    }
    if all > 0.0 { near / all } else { 0.0 }
}

/// Hash of a prior, by which its card knows it.
///
/// *Errors*: none on a CPU.
pub fn hash(prior: &dyn Backbone) -> Result<String> {
    Ok(prior.parameters().hash()?)
}

fn check_temperature(temperature: f64) -> Result<()> {
    let [least, most] = TEMPERATURES;
    if (least..=most).contains(&temperature) {
        return Ok(());
    }
    Err(Error::Value(format!("the temperature is {temperature}; expected {least} to {most}")))
}

/// The card of some weights; `None` without.
fn card(name: &str) -> Result<Option<NominalCard>> {
    let Ok(found) = weights::find(name) else { return Ok(None) };
    if !found.has(NOMINAL_FILE) {
        return Ok(None);
    }
    let text = found.text(NOMINAL_FILE, LIMIT)?;
    let file = || format!("`{}`", found.path(NOMINAL_FILE).display());
    let card: NominalCard = serde_json::from_str(&text).with_context(file)?;
    check_temperature(card.temperature).with_context(file)?;
    Ok(Some(card))
}
