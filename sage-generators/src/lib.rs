//! Generators of adversarial scenes: what the adversary should do to get the ego into trouble.
//!
//! Each is a [`sage_core::generator::Generator`], built by name from [`generators`] and
//! [`GeneratorInputs`]. Most are a [`Pair`]: a proposer ([`proposers`]), which sees what can be seen *now*, and a
//! selector ([`select`]), which may know the ego's path. [`Rule`] and [`Log`] are generators by themselves. An
//! [`Aggression`] makes one even dial of λ and μ.

mod aggression;
mod apply;
mod dial;
mod drivable;
mod error;
mod kind;
mod log;
mod mixtures;
mod pair;
pub mod proposers;
mod rule;
pub mod select;
mod timing;

pub use aggression::Aggression;
pub use apply::attacked;
pub use dial::{DIAL_FILE, Dials, FittedDial, hashes};
pub use drivable::{drivable, is_drivable};
pub use error::Error;
pub use kind::{Facts, GeneratorInputs, GeneratorKind};
pub use log::{Log, logged_future};
pub use mixtures::Mixtures;
pub use pair::{Pair, ProposerKind};
pub use rule::{Rule, bezier};

use proposers::{AllGoals, CatGoals, MixedExperts, MostLikely, Prior, RandomGoals};
use sage_core::registry::Registry;
use select::{Best, CatSelector, First};

/// The generators this crate ships. Add a line here to make a new one known everywhere.
///
/// *Errors*: [`sage_core::Error::Duplicate`] if two bear one name.
pub fn generators() -> Result<Registry<dyn GeneratorKind>, sage_core::Error> {
    Registry::new("generator")
        .with::<Pair<MixedExperts, Best>>()?
        .with::<Pair<Prior, Best>>()?
        .with::<Pair<MostLikely, First>>()?
        .with::<Pair<RandomGoals, Best>>()?
        .with::<Pair<AllGoals, Best>>()?
        .with::<Pair<CatGoals, CatSelector>>()?
        .with::<Rule>()?
        .with::<Log>()
}
