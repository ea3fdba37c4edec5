//! The theorems of preference-mixed experts, checked numerically.
//!
//! Each claim is a [`Check`]: seeded instances with the formula on one side and a direct computation on the other. A check
//! also runs with each of its *planted errors*, wrong versions of the formula that it must notice; one that misses any is
//! broken. [`claims`] lists all claims.
//!
//! Conventions: rewards are maximised. `R_μ = μ R_adv + (1 − μ) R_real` with maximum `θ̂_μ`. Expert 1 maximises `R_β`,
//! expert 2 `R_{1−β}`, with β in (0.5, 1]. `θ(λ) = (1 − λ) θ_2 + λ θ_1`, and `gap(μ) = R_μ(θ̂_μ) − max_λ R_μ(θ(λ))` over λ in [0, 1].
//!
//! ```
//! use theory_checks::{Setup, Verdict, claims, evaluate};
//!
//! let claims = claims()?;
//! let t1 = claims.build_default("T1")?;
//! let setup = Setup { instances: 20, ..Setup::default() };
//! assert_eq!(evaluate(&*t1, &t1.run(&setup, None)), Verdict::Holds);
//! // Without the factor ½ the formula is wrong, and the check says so.
//! assert_eq!(evaluate(&*t1, &t1.run(&setup, Some(0))), Verdict::Violated);
//! # Ok::<(), sage_core::Error>(())
//! ```

mod check;
mod claims;
mod preference;

pub use check::{Check, Outcome, Setup, Tally, Verdict, evaluate};
pub use preference::Preference;

use sage_core::{Error, registry::Registry};

/// All claims of this crate. Add a line here to make a new one known to `sage theory`.
///
/// *Errors*: two have the same id.
pub fn claims() -> Result<Registry<dyn Check>, Error> {
    Registry::new("claim")
        .with::<claims::TwoExpertsAreAnyPreference>()?
        .with::<claims::EqualCurvature>()?
        .with::<claims::UnequalCurvature>()?
        .with::<claims::GeneralHessians>()?
        .with::<claims::PrintedBound>()?
        .with::<claims::VectorForm>()?
        .with::<claims::NormAndCosine>()
}
