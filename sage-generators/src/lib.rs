//! Generators of adversarial scenes: trajectories of the adversary that endanger the ego.
//!
//! Each is a [`sage_core::generator::Generator`], built by name from [`generators`] and
//! [`GeneratorInputs`]. Most are a [`ProposeAndSelect`]: a proposer ([`proposers`]), whose input is the observation up
//! to *now*, and a selector ([`selector`]), which may use the ego's path. [`Rule`] and [`Log`] work as a whole.
//! An [`Aggression`] combines λ and μ into one dial.
//!
//! From a scene to an attack, with the embedded weights ([`Weights::at`] loads a folder):
//!
//! ```
//! use std::sync::Arc;
//!
//! use sage_backbones::{backbones, weights::Weights};
//! use sage_core::{
//!     generator::OperatingPoint,
//!     objective::{Context, ContextOptions, Objective, ObjectiveSpec, feasibilities, rewards},
//!     scene::SceneIndex,
//! };
//! use sage_data::procedural::{Kind, generate};
//! use sage_generators::{GeneratorInputs, generators};
//! use sage_merging::{ExpertSet, mergers};
//!
//! let weights = Weights::Carried { name: "procedural", files: &sage_weights::PROCEDURAL };
//! let (experts, _) = ExpertSet::load(&weights, &backbones()?)?;
//! let natural = ObjectiveSpec::preset("natural").ok_or("no such preset")?;
//! let inputs = GeneratorInputs {
//!     experts: Some(experts),
//!     merger: mergers()?.build_default("linear")?.into(),
//!     seed: 0,
//!     selection: Arc::new(Objective::new(&natural, &rewards()?, &feasibilities()?)?),
//! };
//! let sage = generators()?.build_default("sage")?.build(&inputs)?;
//!
//! let scene = Arc::new(generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?);
//! let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
//! let attacks = sage.attacks(&ctx, &[0.0, 1.0].map(|lambda| OperatingPoint::at(lambda, lambda)), 0)?;
//! // At λ = 1 the selected one of 48 candidates is refined: a further candidate.
//! assert_eq!((attacks[0].candidates.len(), attacks[1].candidates.len()), (48, 49));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`Weights::at`]: sage_backbones::weights::Weights::at

mod aggression;
mod apply;
mod dial;
mod drivable;
mod error;
mod generator_inputs;
mod generator_kind;
mod log;
mod mixtures;
mod nominal_goals;
mod nominal_timing;
pub mod person;
mod propose_and_select;
pub mod proposers;
mod refinement;
mod rule;
pub mod selector;
mod speed_profile;

pub use aggression::Aggression;
pub use apply::attacked;
pub use dial::{DIAL_FILE, Dials, FittedDial, Rate, hashes};
pub use drivable::{drivable, is_drivable};
pub use error::Error;
pub use generator_inputs::GeneratorInputs;
pub use generator_kind::{Facts, GeneratorKind};
pub use log::{Log, logged_future};
pub use mixtures::Mixtures;
pub use nominal_goals::{GoalDensity, goal_density, nominal_plans, trajectory_to};
pub use nominal_timing::{TimedPath, shift_share};
pub use person::{Person, Placement};
pub use propose_and_select::ProposeAndSelect;
pub use refinement::{Refinement, Rounds};
pub use rule::{Rule, bezier};

use proposers::{AllGoals, CatGoals, MixedExperts, MostLikely, Prior, ProposalOptions, RandomGoals};
use sage_core::registry::Registry;

/// The generators of this crate. Add a line here to register a new one.
///
/// *Errors*: [`sage_core::Error::Duplicate`] if two generators have the same name.
pub fn generators() -> Result<Registry<dyn GeneratorKind>, sage_core::Error> {
    Registry::new("generator")
        .with::<MixedExperts>()?
        .with_preset::<MixedExperts>(
            "sage-published",
            "experts mixed at lambda, the best of their 32 most likely goals",
            "SAGE (ICLR 2026), candidates as in the published code",
            &ProposalOptions::published(),
        )?
        .with_preset::<MixedExperts>(
            "sage-drawn",
            "experts mixed at lambda, the best of 4 candidates drawn by their probability: lambda decides",
            "this project: the effect of the experts beside that of the selection",
            &ProposalOptions::few_drawn(),
        )?
        .with::<Prior>()?
        .with::<MostLikely>()?
        .with::<RandomGoals>()?
        .with::<AllGoals>()?
        .with::<CatGoals>()?
        .with::<Rule>()?
        .with::<Person>()?
        .with::<Log>()
}
