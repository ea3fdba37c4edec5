//! T3: with general Hessians the optima leave the segment; the best λ and the gap are known.

use nalgebra::{DMatrix, DVector};
use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::{preference, root};
use crate::{Check, Outcome, Preference, Setup, Tally};

/// Dimensions and condition numbers, in turn.
const DIMENSIONS: [usize; 4] = [2, 3, 10, 40];
const CONDITIONS: [f64; 3] = [1.5, 10.0, 100.0];
const TOLERANCE: f64 = 1e-9;

/// The claim T3.
pub struct GeneralHessians;

impl Entry<dyn Check> for GeneralHessians {
    const NAME: &'static str = "T3";
    const SUMMARY: &'static str =
        "general Hessians: the best λ and the gap of the segment, which misses the optimum";
    const SOURCE: &'static str = "this project, after SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// Two quadratic rewards.
struct Quadratics {
    hessians: [DMatrix<f64>; 2],
    optima: [DVector<f64>; 2],
}

impl Quadratics {
    fn hessian(&self, weight: f64) -> DMatrix<f64> {
        weight * &self.hessians[0] + (1.0 - weight) * &self.hessians[1]
    }

    /// The optimum of a preference; `None` if the Hessian cannot be inverted.
    fn optimum(&self, weight: f64) -> Option<DVector<f64>> {
        let pull = weight * &self.hessians[0] * &self.optima[0]
            + (1.0 - weight) * &self.hessians[1] * &self.optima[1];
        Some(self.hessian(weight).cholesky()?.solve(&pull))
    }

    /// λ and gap by the formulas, then by search.
    fn both(&self, at: Preference, planted: Option<usize>) -> Option<[[f64; 2]; 2]> {
        let [c1, c2] = at.coefficients();
        let (first, second) = (self.optimum(at.beta)?, self.optimum(1.0 - at.beta)?);
        let (hat, own) = (self.optimum(at.mu)?, self.hessian(at.mu));
        let d = &first - &second;
        let [of_first, of_second] = [at.beta, 1.0 - at.beta].map(|weight| self.hessian(weight) * &d);
        let [mut h1, mut h2] = [&of_first, &of_second].map(|h| d.dot(h));
        if planted == Some(0) {
            (h1, h2) = (h2, h1);
        }
        let free = if planted == Some(1) { c1 } else { c1 * h1 / (c1 * h1 + c2 * h2) };
        let lambda = free.clamp(0.0, 1.0);
        let gradient = c1 * (1.0 - lambda) * &of_first - c2 * lambda * &of_second;
        let gap = 0.5 * gradient.dot(&own.clone().cholesky()?.solve(&gradient));
        let point = |lambda: f64| &second + lambda * &d;
        let best = root(|lambda| (&own * (&hat - point(lambda))).dot(&d));
        let missed = point(best) - &hat;
        Some([[lambda, gap], [best, 0.5 * missed.dot(&(&own * &missed))]])
    }
}

/// A symmetric matrix with a spectrum log-uniform in [1, κ] in random directions.
fn hessian(rng: &mut Rng, dimension: usize, condition: f64) -> DMatrix<f64> {
    let directions = DMatrix::from_fn(dimension, dimension, |_, _| rng.normal()).qr().q();
    let spectrum = DVector::from_fn(dimension, |_, _| condition.powf(rng.unit()));
    let matrix = &directions * DMatrix::from_diagonal(&spectrum) * directions.transpose();
    0.5 * (&matrix + matrix.transpose())
}

impl Check for GeneralHessians {
    fn formula(&self) -> &'static str {
        "λ = c₁ h₁/(c₁ h₁ + c₂ h₂) with h_i = dᵀ H_i d; gap = ½ gᵀ H_μ⁻¹ g, g = [c₁ (1 − λ) H₁ − c₂ λ H₂] d"
    }

    fn caveat(&self) -> &'static str {
        "\"exactly optimal inside [1 − β, β]\" is a property of scalar curvature: here the gap inside is above 0"
    }

    fn planted(&self) -> &'static [&'static str] {
        &["h₁ and h₂ exchanged", "λ = c₁"]
    }

    fn run(&self, setup: &Setup, planted: Option<usize>) -> Outcome {
        let mut rng = Rng::new(setup.seed, "T3", "instances");
        let mut tally = Tally::default();
        for instance in 0..setup.instances {
            let dimension = DIMENSIONS[instance % DIMENSIONS.len()];
            let condition = CONDITIONS[instance % CONDITIONS.len()];
            let at = preference(&mut rng, instance);
            let hessians = [(); 2].map(|()| hessian(&mut rng, dimension, condition));
            let optima = [(); 2].map(|()| DVector::from_fn(dimension, |_, _| rng.normal()));
            let Some([[lambda, gap], [best, direct]]) = (Quadratics { hessians, optima }).both(at, planted)
            else {
                tally.equal(f64::NAN, 0.0, 1.0);
                continue;
            };
            tally.equal(lambda, best, TOLERANCE);
            tally.equal(gap, direct, TOLERANCE * (1.0 + direct));
        }
        let stored = Quadratics {
            hessians: [
                DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, 10.0]),
                DMatrix::from_row_slice(2, 2, &[5.5, 4.5, 4.5, 5.5]),
            ],
            optima: [DVector::from_row_slice(&[1.0, 0.0]), DVector::from_row_slice(&[0.0, 1.0])],
        };
        for (mu, lambda, gap) in [
            (0.0, 0.0, 0.14578296089),
            (0.3, 0.5372340426, 0.0036015005707),
            (0.5, 0.7769230769, 0.0042569511138),
            (1.0, 1.0, 0.0036549467126),
        ] {
            if let Some([found, _]) = stored.both(Preference { mu, beta: 0.9 }, planted) {
                tally.stored(found[0], lambda, 1e-9);
                tally.stored(found[1], gap, 1e-11);
            }
        }
        tally.outcome()
    }
}
