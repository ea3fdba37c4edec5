//! Published baselines that stand aside from the method: KING, AdvTrajOpt, SEAL and GOOSE, with their networks, trainings and
//! roll-outs.
//!
//! [`with_baselines`] adds them to a registry of generators. KING ([`King`]) and AdvTrajOpt ([`AdvTrajOpt`]) optimise a path; SEAL
//! ([`Seal`]) and GOOSE ([`Goose`]) read learned parts from files beside the prior, which `sage train-adversary` trains.

mod adv_traj_opt;
pub mod goose;
mod king;
mod network_optimiser;
mod optimisers;
pub mod rollout;
pub mod seal;

use sage_core::{Error, registry::Registry};
use sage_generators::GeneratorKind;

pub use adv_traj_opt::AdvTrajOpt;
pub use goose::Goose;
pub use king::King;
pub use optimisers::StartFrom;
pub use seal::{Seal, SealScore, learned_scores, relative_paths, seal_reaction};

/// Adds the generators of this crate.
///
/// *Errors*: [`Error::Duplicate`] if the registry has one of their names.
///
/// ```
/// use sage_baselines::with_baselines;
/// use sage_generators::generators;
///
/// let all = with_baselines(generators()?)?;
/// // KING searches from the recorded motion; SEAL reads learned parts from a file beside the prior.
/// assert!(!all.build_default("king")?.facts().depends_on_lambda);
/// assert_eq!(all.build_default("seal")?.files(), ["seal.safetensors"]);
/// # Ok::<(), sage_core::Error>(())
/// ```
pub fn with_baselines(generators: Registry<dyn GeneratorKind>) -> Result<Registry<dyn GeneratorKind>, Error> {
    generators
        .with::<SealScore>()?
        .with::<Seal>()?
        .with::<Goose>()?
        .with::<King>()?
        .with_preset::<King>(
            "king-published",
            "gradient ascent on the controls of a bicycle, blind to the map",
            "Hanselmann et al. (2022), as the SAGE paper configures it",
            &King::published(),
        )?
        .with::<AdvTrajOpt>()?
        .with_preset::<AdvTrajOpt>(
            "adv-traj-opt-published",
            "projected gradient ascent on positions, by the plain gradient",
            "Zhang et al. (2022), with the steps of the SAGE paper; start and bounds are not published",
            &AdvTrajOpt::published(),
        )
}
