//! Adversarial traffic scenes: what a Rust program needs to attack a scene, drive it and search for failures. It is the one dependency
//! of such a program; the crates below are [`core`](sage_core), [`data`](sage_data), [`sim`](sage_sim) and [`view`](sage_view), and what
//! is needed of them stands at the root.
//!
//! ```
//! use std::{path::Path, sync::Arc};
//!
//! use advsage::{
//!     Against, DriverInScene, Ego, GeneratorSpec, Prepared, Recording, Registries, SearchOptions, SearchSpec,
//! };
//!
//! # fn main() -> advsage::Result<()> {
//! # let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl");
//! # let file = Path::new(file);
//! // Names become parts: a scene, a generator, a driver.
//! let registries = Registries::shipped()?;
//! let scene = Arc::new(Recording::read(file)?.scene);
//! let sage = GeneratorSpec::named("sage")?.at(1.0, None).build(&registries)?;
//! let idm = Ego::named("idm", &registries)?;
//!
//! // An attack on the recorded ego.
//! let recorded = Prepared::recorded(&scene)?;
//! let attack = sage.attacks(&recorded.ctx, Against::Recording)?.remove(0);
//! let scores = recorded.scores(&attack);
//! println!("contact after {:?} steps, believable: {:?}", scores.collision_step, scores.believable);
//!
//! // An attack on a driver, who drives the scene first without it and then against it.
//! let driven = DriverInScene::of(&scene, &idm, 0)?;
//! let attack = sage.attacks(&driven.ctx, Against::Driver(&driven.test))?.remove(0);
//! let outcome = driven.drive(&attack)?;
//! println!("attack: {}, contacts: {}", outcome.verdict.attack, outcome.episode.contacts.len());
//!
//! // Many plans, to find one that the driver fails at.
//! let search = SearchSpec::default().build(&registries)?;
//! let options = SearchOptions { budget: 8, ..SearchOptions::default() };
//! let (_, found) = search.search(&driven, &options, 0)?;
//! println!("{} failures in {} drives", found.failures.len(), found.driven.len());
//! # Ok(())
//! # }
//! ```
//!
//! - [`Registries`] hold all parts, whose names `sage list` prints; a part of your own is added with `with`. [`part`] reads names with options, [`weights`] finds experts,
//!   [`operating_point`] says how aggressive, [`selection`] what is preferred.
//! - [`prepared`] makes a scene ready to be attacked. [`named_generator`] builds a generator from names, [`generators`] from parts;
//!   [`latest_start`] chooses by the time that is left to evade.
//! - [`adversary`] says who attacks: the road user that a scene chooses, a named one, or a person who is placed there.
//! - [`ego`] builds drivers, with [`references`] that say whether a contact is preventable. [`named_search`] and [`search`] find what they
//!   fail at.
//! - [`rate`] weighs failures by how likely the adversary's plans are.
//! - [`rows`] are results as files hold them, [`attacked_files`] and [`scenario_files`] the scenes of attacks.

pub mod adversary;
mod adversary_plans;
pub mod attacked_files;
pub mod dial;
pub mod driver_search;
pub mod driver_spec;
pub mod ego;
mod error;
pub mod generators;
pub mod latest_start;
#[cfg(feature = "baselines")]
mod learned_criticality;
pub mod named_generator;
pub mod named_search;
pub mod operating_point;
pub mod part;
pub mod planned_attack;
pub mod prepared;
pub mod rate;
pub mod references;
mod registries;
pub mod rows;
pub mod scenario_files;
pub mod search;
pub mod searched_attacker;
pub mod selection;
pub mod weights;

pub use adversary::{AdversarySpec, PersonKind};
pub use driver_spec::DriverSpec;
pub use ego::Ego;
pub use error::{Error, Result, WithContext, as_cause, in_one_line, leaves_out};
pub use generators::Against;
#[cfg(feature = "baselines")]
pub use learned_criticality::{LearnedCriticality, LearnedCriticalityOptions};
pub use named_generator::{GeneratorSpec, NamedGenerator};
pub use named_search::{NamedSearch, SearchSpec};
pub use operating_point::OperatingPoints;
pub use part::Part;
pub use prepared::{DriverInScene, Prepared};
pub use registries::Registries;

pub use sage_core::{
    self,
    generator::Attack,
    motion::{DT, Trajectory},
    objective::{Context, Scorer, Scores},
    scene::Scene,
};
pub use sage_data::{self, ReadOptions, Recording};
pub use sage_sim::{
    self,
    attack_test::AttackOutcome,
    avoidable::AvoidanceOptions,
    search::{Clause, Requirement, SearchOptions},
};
pub use sage_view::{
    self,
    drawing::{Picture, draw, drawn_path},
};
