//! T10: concavity along the path, and the barrier.

use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::instances::Pair;
use crate::{
    Check, Report, Setup, Tally,
    random::{log_uniform, normals},
    reward::{Concave, Separable},
};

/// Dimensions, in turn, and steps of λ.
const DIMENSIONS: [usize; 3] = [1, 2, 10];
const STEPS: usize = 6;
/// Rounding of a value, relative.
const ROUNDING: f64 = 1e-11;

/// The claim T10.
pub struct ConcavityAlongPath;

impl Entry<dyn Check> for ConcavityAlongPath {
    const NAME: &'static str = "T10";
    const SUMMARY: &'static str =
        "a concave reward is above its chord by between m and L; a loss then has no barrier";
    const SOURCE: &'static str = "linear mode connectivity; SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// A reward between two random points.
fn between(reward: &dyn Concave, rng: &mut Rng, tally: &mut Tally, injected: Option<usize>) {
    let scale = log_uniform(rng, [-1.0, 0.5]);
    let [real, adversarial] = [(); 2].map(|()| scale * normals(rng, reward.dimension()));
    let ends = [&real, &adversarial].map(|theta| reward.value(theta));
    let rounding = ROUNDING * (1.0 + ends[0].abs() + ends[1].abs());
    let squared = (&adversarial - &real).norm_squared();
    let constants = reward.curvature();
    let mut barriers = Vec::new();
    for step in 0..=STEPS {
        let lambda = step as f64 / STEPS as f64;
        let share = if injected == Some(1) { 1.0 - lambda } else { lambda };
        let chord = (1.0 - share) * ends[0] + share * ends[1];
        let above = reward.value(&((1.0 - lambda) * &real + lambda * &adversarial)) - chord;
        // Half of λ(1 − λ) D², which q multiplies.
        let unit = 0.5 * lambda * (1.0 - lambda) * squared;
        tally.at_most(constants.m * unit, above, rounding);
        tally.at_most(above, constants.l * unit, rounding);
        if unit * constants.m > 1e3 * rounding {
            tally.ratio(constants.l * unit / above);
        }
        barriers.push(-above);
    }
    // The loss −R has its largest height above the chord at the ends.
    let barrier = if injected == Some(0) {
        barriers.iter().sum::<f64>() / barriers.len() as f64
    } else {
        barriers.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    };
    tally.equal(barrier, 0.0, rounding);
}

/// Above its chord everywhere, but not concave: `λ (1 − λ) + 0.05 sin 6πλ`.
fn above_but_not_concave(tally: &mut Tally) {
    let reward = |l: f64| l * (1.0 - l) + 0.05 * (6.0 * std::f64::consts::PI * l).sin();
    let inner = (1..1000).map(|k| f64::from(k) / 1000.0);
    tally.holds(inner.clone().all(|lambda| reward(lambda) > 0.0));
    let step = 1e-4;
    let bend = |l: f64| (reward(l - step) - 2.0 * reward(l) + reward(l + step)) / (step * step);
    tally.compare_stored(inner.map(bend).fold(f64::NEG_INFINITY, f64::max), 15.8, 0.05);
}

impl Check for ConcavityAlongPath {
    fn formula(&self) -> &'static str {
        "q(λ) = 2 (R(θ(λ)) − chord)/(λ (1 − λ) D²) is in [m, L]; the barrier of −R, its largest height above the chord, is 0"
    }

    fn experiment(&self) -> &'static str {
        "300 rewards in dimensions 1, 2 and 10 (five families, m in 10^[-1, 0.5], L/m in 10^[0, 1.5]) between two normal points with a scale in 10^[-1, 0.5], λ in steps of 1/6. Tight: 100 isotropic quadratics, where q = m = L"
    }

    fn caveat(&self) -> &'static str {
        "q below 0 refutes strong concavity; above the chord does not imply concave: λ (1 − λ) + 0.05 sin 6πλ has second derivatives up to 15.8"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["the mean height in place of the largest", "λ reversed in the chord"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let random = setup.each("T10", 300, |instance, rng, tally| {
            let pair = Pair::draw(rng, instance, DIMENSIONS[instance / 5 % DIMENSIONS.len()]);
            between(pair.rewards()[0], rng, tally, injected);
        });
        let tight = setup.whole().each("T10 tight", 100, |instance, rng, tally| {
            let center = normals(rng, DIMENSIONS[instance % DIMENSIONS.len()]);
            let curvature = log_uniform(rng, [-1.0, 1.0]);
            between(&Separable::isotropic(curvature, center), rng, tally, injected);
        });
        let mut tally = random.and(tight);
        above_but_not_concave(&mut tally);
        tally.report(vec![], vec![])
    }
}
