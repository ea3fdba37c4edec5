//! `sage` with a claim of your own: which single mixture is safest for a preference that nobody knows.
//!
//! ```sh
//! cargo run --release -p experiments --example own_claim -- theory --only T1,safest --out theory/
//! ```

use std::process::ExitCode;

use experiments::Registries;
use sage_core::registry::{Entry, NoOptions};
use theory_checks::{
    Check, Experts, Number, Report, Setup, Table,
    random::{log_uniform, normals},
    reward::{Concave, Separable},
};

/// Values of μ and λ that are compared, from 0 to 1.
const STEPS: usize = 20;
const TOLERANCE: f64 = 1e-9;

/// The claim: for equal curvature the midpoint of the experts has the smallest largest loss over all preferences.
struct SafestMixture;

impl Entry<dyn Check> for SafestMixture {
    const NAME: &'static str = "safest";
    const SUMMARY: &'static str = "equal curvature: λ = ½ has the smallest loss in the worst case over μ";
    const SOURCE: &'static str = "this example";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

impl Check for SafestMixture {
    fn formula(&self) -> &'static str {
        "min over λ of max over μ of R_μ(θ̂_μ) − R_μ(θ(λ)) is η/8 ‖θ_adv* − θ_real*‖², at λ = ½, for every β"
    }

    fn experiment(&self) -> &'static str {
        "200 pairs of isotropic quadratics in 1 to 10 dimensions, normal optima, η in 10^[-1, 1], β in [0.55, 1]; 21 values of λ and of μ"
    }

    fn caveat(&self) -> &'static str {
        "with unequal curvatures the safest λ is another one"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["η/4 in place of η/8", "λ = 1"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let tally = setup.each("safest", 200, |_, rng, tally| {
            let dimension = 1 + rng.below(10);
            let (eta, beta) = (log_uniform(rng, [-1.0, 1.0]), rng.uniform(0.55, 1.0));
            let optima = [normals(rng, dimension), normals(rng, dimension)];
            let distance = (&optima[0] - &optima[1]).norm_squared();
            let rewards = optima.clone().map(|optimum| Separable::isotropic(eta, optimum));
            let Some(experts) = Experts::of([&rewards[0], &rewards[1]], beta, &optima[0]) else {
                return tally.add_unsolved();
            };
            // The largest loss of a mixture, by values of the rewards at the optimum and at the mixture.
            let worst = |lambda: f64| {
                let loss = |k: usize| {
                    let mu = k as f64 / STEPS as f64;
                    let (reward, best) = (experts.preferred(mu), mu * &optima[0] + (1.0 - mu) * &optima[1]);
                    reward.value(&best) - reward.value(&experts.at(lambda))
                };
                (0..=STEPS).map(loss).fold(0.0, f64::max)
            };
            let share = if injected == Some(0) { 0.25 } else { 0.125 };
            let lambda = if injected == Some(1) { 1.0 } else { 0.5 };
            let tolerance = TOLERANCE * (1.0 + eta * distance);
            tally.equal(share * eta * distance, worst(lambda), tolerance);
            for k in 0..=STEPS {
                tally.at_most(worst(lambda), worst(k as f64 / STEPS as f64), tolerance);
            }
            tally.sample("worst at the adversarial expert", worst(1.0) / worst(0.5));
        });
        let mut table = Table::new("Largest loss over μ, relative to that of λ = ½", &["λ", "median"]);
        table.row("1", Number::quantiles(tally.samples("worst at the adversarial expert"), [0.5]));
        tally.report(vec![table], vec![])
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = Registries::shipped()?;
        registries.claims = registries.claims.with::<SafestMixture>()?;
        Ok(registries)
    })
}
