//! The theorems of preference-mixed experts, checked numerically.
//!
//! Each claim is a [`Check`]: seeded instances with the formula on one side and a direct computation on the other. Its
//! [`Report`] supports a [`Verdict`]. A check also runs with each of its *injected faults*, wrong versions of the formula
//! that it must notice; one that misses any is broken. [`claims`] lists all claims.
//!
//! Conventions: rewards are maximised. `R_μ = μ R_adv + (1 − μ) R_real` with maximum `θ̂_μ`. Expert 1 maximises `R_β`,
//! expert 2 `R_{1−β}`, with β in (0.5, 1]. `θ(λ) = (1 − λ) θ_2 + λ θ_1`, and `gap(μ) = R_μ(θ̂_μ) − max_λ R_μ(θ(λ))` over λ in [0, 1].
//!
//! ```
//! use theory_checks::{Setup, Verdict, caught, claims};
//!
//! let t1 = claims()?.build_default("T1")?;
//! let setup = Setup { instances: 20, ..Setup::default() };
//! assert_eq!(Verdict::of(&t1.run(&setup, None)), Verdict::Holds);
//! // Without the factor ½, and with other errors, the formula is wrong, and the check notices.
//! assert!(caught(&*t1, &setup).iter().all(|is_caught| *is_caught));
//! # Ok::<(), sage_core::Error>(())
//! ```

mod bounds;
mod check;
mod claims;
mod experts;
mod figure;
mod json;
pub mod mixing;
mod preference;
mod quadrature;
pub mod random;
mod report;
pub mod reward;
mod setup;
mod table;
mod tally;
pub mod tanh_net;

pub use bounds::Bounds;
pub use check::{Check, caught};
pub use experts::{Experts, Loss, Mixed, optimum, root};
pub use figure::{Figure, Series};
pub use preference::Preference;
pub use report::{Report, Verdict};
pub use setup::Setup;
pub use table::{Agreement, Number, Table};
pub use tally::Tally;

use sage_core::{Error, registry::Registry};

/// All claims of this crate. Add a line here to make a new one known to `sage theory`.
///
/// *Errors*: two have the same id.
pub fn claims() -> Result<Registry<dyn Check>, Error> {
    Registry::new("claim")
        .with::<claims::TwoExpertsAreAnyPreference>()?
        .with::<claims::EqualCurvature>()?
        .with::<claims::LambdaEqualsMu>()?
        .with::<claims::UnequalCurvature>()?
        .with::<claims::GeneralHessians>()?
        .with::<claims::BoundAtEveryLambda>()?
        .with::<claims::SharperBounds>()?
        .with::<claims::SignRule>()?
        .with::<claims::PrintedBound>()?
        .with::<claims::LocalConcavity>()?
        .with::<claims::VectorForm>()?
        .with::<claims::NormAndCosine>()?
        .with::<claims::ConcavityAlongPath>()?
        .with::<claims::WidthOfOptimality>()?
        .with::<claims::FirstOrder>()?
        .with::<claims::Extrapolation>()?
        .with::<claims::FourSteps>()?
        .with::<claims::ExactComparison>()?
        .with::<claims::WhatDecides>()?
        .with::<claims::RayleighCondition>()?
        .with::<claims::PreferenceLearning>()?
        .with::<claims::Smoothness>()?
        .with::<claims::ManyExperts>()
}
