//! The claims, one file each.

mod t0;
mod t1;
mod t2;
mod t3;
mod t6;
mod t8;
mod t9;

use sage_core::seed::Rng;

pub use t0::TwoExpertsAreAnyPreference;
pub use t1::EqualCurvature;
pub use t2::UnequalCurvature;
pub use t3::GeneralHessians;
pub use t6::PrintedBound;
pub use t8::VectorForm;
pub use t9::NormAndCosine;

use crate::Preference;

/// Values of β, in turn.
const BETAS: [f64; 5] = [0.51, 0.6, 0.75, 0.9, 1.0];

/// A preference inside, outside or at a border of what the experts enclose.
fn preference(rng: &mut Rng, instance: usize) -> Preference {
    let beta = BETAS[instance % BETAS.len()];
    let mu = match rng.below(8) {
        0 => 0.0,
        1 => 1.0,
        2 => 1.0 - beta,
        3 => beta,
        _ => rng.unit(),
    };
    Preference { mu, beta }
}

/// Normal numbers.
fn normals(rng: &mut Rng, count: usize) -> Vec<f64> {
    (0..count).map(|_| rng.normal()).collect()
}

/// Where a decreasing function on [0, 1] is 0; an end where it has one sign.
fn root(f: impl Fn(f64) -> f64) -> f64 {
    if f(0.0) <= 0.0 {
        return 0.0;
    }
    if f(1.0) >= 0.0 {
        return 1.0;
    }
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..52 {
        let middle = 0.5 * (low + high);
        if f(middle) > 0.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}
