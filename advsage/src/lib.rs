//! Adversarial traffic scenes: what a Rust program needs to attack a scene, drive it and search for failures.
//!
//! Names become parts: [`Registries`] hold them, [`part`] reads them, [`weights`] finds experts, [`operating_point`] says how
//! aggressive, [`selection`] what is preferred. [`generators`] attack ([`named_generator`]: by name), [`ego`] drives, with
//! [`references`] that say whether a contact is preventable, and [`search`] searches ([`named_search`]: by name).

pub mod attacked_files;
pub mod dial;
pub mod driver_search;
pub mod ego;
mod error;
pub mod generators;
pub mod latest_start;
mod learned_criticality;
pub mod named_generator;
pub mod named_search;
pub mod operating_point;
pub mod part;
pub mod planned_attack;
pub mod prepared;
pub mod references;
mod registries;
pub mod rows;
pub mod scenario_files;
pub mod search;
pub mod searched_attacker;
pub mod selection;
pub mod weights;

pub use error::{Error, Result, as_cause, is_contact_now};
pub use learned_criticality::{LearnedCriticality, LearnedCriticalityOptions};
pub use registries::Registries;
