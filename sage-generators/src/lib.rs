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
pub use kind::{Facts, GeneratorInputs, GeneratorKind, generators};
pub use log::{Log, logged_future};
pub use mixtures::Mixtures;
pub use pair::{Pair, ProposerKind};
pub use rule::{Rule, bezier};
