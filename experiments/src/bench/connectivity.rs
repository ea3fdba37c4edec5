//! Rewards along the path between two experts: height above the chord and concavity, with intervals. The chord is
//! what probability mixing attains: expectations are linear in the probabilities.

use sage_bench::curve::{self, Curve as Sweep, Point as Measure};
use sage_core::statistics::{Estimate, mean};

/// A value of a front that is maximised.
pub(crate) type Value = fn(&Measure) -> f64;

/// The values that the paper's claims are about. The experts maximise mixtures of both with weight 0.9.
pub(crate) const VALUES: [(&str, Value); 4] = [
    ("R_adv", |m| m.reward),
    ("-P_real", |m| -m.penalty),
    ("0.9 R_adv - 0.1 P_real", |m| 0.9 * m.reward - 0.1 * m.penalty),
    ("0.1 R_adv - 0.9 P_real", |m| 0.1 * m.reward - 0.9 * m.penalty),
];

/// λ at which `mu R_adv − (1 − mu) P_real` is largest along the path, with its interval. By the theory it rises with
/// μ, from 0 to 1.
pub(crate) fn best_lambda(sweep: &Sweep, mu: f64) -> Option<Estimate> {
    sweep.estimate(|front| curve::best_lambda(front, mu))
}

/// What a value does along the path.
pub(crate) struct Path {
    /// Least height above the chord and the mean over the inner λ. A least height below 0 is a barrier of the
    /// loss, the negative value.
    pub(crate) least: Estimate,
    pub(crate) mean: Estimate,
    /// Share of the inner λ at which the second difference is not above 0, in percent.
    pub(crate) concave: Estimate,
}

impl Path {
    /// The path of a value; `None` without scenes.
    pub(crate) fn of(sweep: &Sweep, value: Value) -> Option<Self> {
        let values = |front: &[Measure]| front.iter().map(value).collect::<Vec<_>>();
        Some(Self {
            least: sweep
                .estimate(|front| curve::heights(&values(front)).into_iter().fold(f64::INFINITY, f64::min))?,
            mean: sweep.estimate(|front| mean(&curve::heights(&values(front))).unwrap_or(0.0))?,
            concave: sweep.estimate(|front| curve::concave(&values(front)))?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sweep(of: fn(f64) -> f64) -> Sweep {
        let at = |k: u32| Measure { reward: of(f64::from(k) / 4.0), ..Measure::default() };
        Sweep { scenes: vec![(0..=4).map(at).collect(); 3] }
    }

    #[test]
    fn a_parabola_lies_above_its_chord_and_a_valley_has_a_barrier() {
        let hill = Path::of(&sweep(|x| 2.0 * x + x * (1.0 - x)), VALUES[0].1).unwrap();
        // At λ = 1/4 and 3/4 the height is 3/16, at 1/2 it is 1/4.
        assert!((hill.least.value - 0.1875).abs() < 1e-12);
        assert!((hill.mean.value - (2.0 * 0.1875 + 0.25) / 3.0).abs() < 1e-12);
        assert_eq!(hill.concave.value, 100.0);
        let valley = Path::of(&sweep(|x| x - x * (1.0 - x)), VALUES[0].1).unwrap();
        assert!((valley.least.value + 0.25).abs() < 1e-12);
        assert_eq!(valley.concave.value, 0.0);
        assert!(Path::of(&Sweep::default(), VALUES[0].1).is_none());
        // The reward of the hill is largest at the end, its penalty is 0 everywhere.
        assert_eq!(best_lambda(&sweep(|x| x), 1.0).unwrap().value, 1.0);
        assert_eq!(best_lambda(&sweep(|x| -x), 1.0).unwrap().value, 0.0);
    }
}
