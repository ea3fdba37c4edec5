//! T5s: the sign rule of the best λ.

use sage_core::registry::{Entry, NoOptions};

use super::instances::Pair;
use crate::{
    Check, Experts, Figure, Report, Series, Setup, Tally,
    random::log_uniform,
    reward::{Curvature, Family, Shape},
};

/// Values of β, in turn, and of μ.
const BETAS: [f64; 6] = [0.55, 0.6, 0.7, 0.8, 0.9, 0.99];
const PREFERENCES: [f64; 11] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0];
/// Tolerance of λ, and of μ at the borders of [1 − β, β].
const NEAR: f64 = 1e-6;
const BORDER: f64 = 1e-9;
/// Strong concavity where there is almost none.
const FLAT: f64 = 1e-5;

/// The claim T5s.
pub struct SignRule;

impl Entry<dyn Check> for SignRule {
    const NAME: &'static str = "T5s";
    const SUMMARY: &'static str =
        "the best λ is an end outside [1 − β, β], is inner inside, and rises with μ";
    const SOURCE: &'static str = "this project, after SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// The rule at every μ; the best λ of each.
fn follow(tally: &mut Tally, experts: &Experts<'_>, injected: Option<usize>) -> Vec<[f64; 2]> {
    let beta = if injected == Some(1) { 1.0 - experts.beta } else { experts.beta };
    let mut curve: Vec<[f64; 2]> = Vec::new();
    for mu in PREFERENCES {
        let best = experts.best(mu);
        let best = if injected == Some(0) { 1.0 - best } else { best };
        if (mu - beta).abs() > BORDER && (mu - (1.0 - beta)).abs() > BORDER {
            let follows = if mu < 1.0 - beta {
                best < NEAR
            } else if mu > beta {
                best > 1.0 - NEAR
            } else {
                best > 0.0 && best < 1.0
            };
            tally.holds(follows);
        }
        if let Some([_, last]) = curve.last() {
            tally.holds(best >= last - NEAR);
        }
        curve.push([mu, best]);
    }
    curve
}

impl Check for SignRule {
    fn formula(&self) -> &'static str {
        "best λ = 0 iff μ ≤ 1 − β, 1 iff μ ≥ β; non-decreasing in μ. The slope of R_μ along d is c₁ p − c₂ q with p, q ≥ 0"
    }

    fn experiment(&self) -> &'static str {
        "3000 instances in dimensions 2, 5 and 20 (25 pairs of families in turn, m in 10^[-1, 0.5], L/m in 10^[0, 1.5], optima normal with a common scale in 10^[-1, 0.5], random rotations), and 600 log-cosh pairs in 3 dimensions with m = 1e-5; β in {0.55, 0.6, 0.7, 0.8, 0.9, 0.99}, 11 values of μ, best λ by bisection"
    }

    fn caveat(&self) -> &'static str {
        "needs no constants, only strict concavity and experts at their optima: a best λ that falls on trained models refutes one of the two"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["λ reversed", "β and 1 − β exchanged"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let curved = setup.each("T5s", 3000, |instance, rng, tally| {
            let pair = Pair::draw(rng, instance, [2, 5, 20][instance / 25 % 3]);
            match pair.experts(BETAS[instance % BETAS.len()]) {
                Some(experts) => {
                    let curve = follow(tally, &experts, injected);
                    if experts.beta == 0.9 && instance < 90 {
                        for [mu, lambda] in curve {
                            tally.sample(format!("{instance} mu"), mu);
                            tally.sample(format!("{instance} lambda"), lambda);
                        }
                    }
                }
                None => tally.add_unsolved(),
            }
        });
        let flat = setup.each("T5s flat", 600, |instance, rng, tally| {
            let family = Family::Separable(Shape::LogCosh);
            let curvature = Curvature { m: FLAT, l: 1.0 };
            let scale = log_uniform(rng, [-1.0, 0.5]);
            let pair = Pair::with(rng, [family; 2], [curvature; 2], scale, 3);
            match pair.experts(BETAS[instance % BETAS.len()]) {
                Some(experts) => drop(follow(tally, &experts, injected)),
                None => tally.add_unsolved(),
            }
        });
        let tally = curved.and(flat);
        let curve = |instance: usize| {
            let [mus, lambdas] =
                ["mu", "lambda"].map(|of| tally.samples(&format!("{instance} {of}")).to_vec());
            let points = mus.into_iter().zip(lambdas).map(|(mu, lambda)| [mu, lambda]).collect();
            Series::line(format!("instance {instance}"), points)
        };
        let series = (0..90).map(curve).filter(|series| !series.points.is_empty());
        let figure = Figure::new(
            "The best λ for each μ, for random pairs of rewards with β = 0.9",
            ["μ", "best λ"],
            series.take(8).collect(),
        );
        tally.report(vec![], vec![figure])
    }
}
