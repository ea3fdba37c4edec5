//! Generators of adversarial scenes: what the adversary should do to get the ego into trouble.
//!
//! Each is a [`sage_core::generator::Generator`]: [`Steered`] is SAGE (and, over a prior, the row that
//! tells what choice alone does), [`Cat`], [`Rule`], and the floors and ceilings of a table:
//! [`Log`], [`MostLikely`], [`RandomGoals`], [`Oracle`]. [`methods`] builds them by name; an
//! [`Aggression`] makes one even dial of the two weights.

mod aggression;
mod apply;
mod cat;
pub mod choice;
mod log;
mod method;
mod most_likely;
mod oracle;
mod random_goals;
mod rule;
mod steered;
mod timing;

pub use aggression::Aggression;
pub use apply::attacked;
pub use cat::{Cat, CatChoice, EgoPaths, cat_plan, cat_select};
pub use choice::{Choice, Judge, Judged};
pub use log::{Log, logged_future};
pub use method::{Method, Setting, methods};
pub use most_likely::MostLikely;
pub use oracle::Oracle;
pub use random_goals::RandomGoals;
pub use rule::{Rule, bezier};
pub use steered::{Steered, SteeredOptions};
