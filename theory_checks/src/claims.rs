//! The claims, one file each.

mod instances;
mod quadratics;
mod t0;
mod t1;
mod t10;
mod t11;
mod t12;
mod t13;
mod t1b;
mod t2;
mod t3;
mod t4;
mod t5;
mod t5s;
mod t6;
mod t7;
mod t8;
mod t9;

pub use t0::TwoExpertsAreAnyPreference;
pub use t1::EqualCurvature;
pub use t1b::LambdaEqualsMu;
pub use t2::UnequalCurvature;
pub use t3::GeneralHessians;
pub use t4::BoundAtEveryLambda;
pub use t5::SharperBounds;
pub use t5s::SignRule;
pub use t6::PrintedBound;
pub use t7::LocalConcavity;
pub use t8::VectorForm;
pub use t9::NormAndCosine;
pub use t10::ConcavityAlongPath;
pub use t11::WidthOfOptimality;
pub use t12::FirstOrder;
pub use t13::Extrapolation;
