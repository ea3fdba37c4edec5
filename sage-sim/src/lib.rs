//! Closed-loop simulation of recorded scenes, and the driving policies under test.
//!
//! - [`World`](world::World): a scene in motion. The ego is a car on tyres ([`vehicle`]), contacts are
//!   resolved by rapier2d ([`physics`]), the others replay their log, follow a plan, or react ([`traffic`]).
//! - [`Environment`](environment::Environment): reset and step with observation, reward, cost and endings, for
//!   learning drivers; [`Batch`](batch::Batch) steps many at once.
//! - [`EgoPolicy`](policy::EgoPolicy): drivers by name ([`policy::policies`]), driven by
//!   [`Simulation`](drive::Simulation); [`fault`] says who caused a contact, [`red_lights`] who ran over red, [`mod@reference`] whether another driver prevents it,
//!   [`avoidable`] whether a manoeuvre exists that does.
//! - [`AttackTest`](attack_test::AttackTest): a driver before an attack and under it.
//!
//! A policy in a scene:
//!
//! ```
//! use std::sync::Arc;
//!
//! use sage_core::scene::SceneIndex;
//! use sage_data::procedural::{Kind, generate};
//! use sage_sim::{
//!     SimScene,
//!     drive::{Simulation, drive},
//!     policy::policies,
//! };
//!
//! let scene = Arc::new(generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?);
//! let scene = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
//! let idm = policies()?.build_default("idm")?;
//! let mut simulation = Simulation::new(&scene, &Arc::default(), None, idm.as_ref(), 0)?;
//! let drive = drive(&mut simulation)?;
//! assert_eq!(drive.motions.len(), 91);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod actor;
pub mod attack_test;
pub mod attacker;
pub mod avoidable;
pub mod batch;
pub mod body;
pub mod comfort;
pub mod curriculum;
pub mod drive;
pub mod environment;
pub mod episode;
mod error;
pub mod evaluation;
pub mod fault;
pub mod following;
mod grid;
pub mod lines;
pub mod metrics;
pub mod navigation;
pub mod observation;
pub mod physics;
pub mod policy;
pub mod queried;
pub mod rate;
mod rays;
mod reacting;
pub mod red_lights;
pub mod reference;
mod repeated;
pub mod route;
pub mod route_lanes;
pub mod route_lights;
mod scene;
pub mod search;
mod smoothing;
pub mod success;
pub mod traffic;
pub mod unattacked;
pub mod vehicle;
pub mod world;
mod wrong_way;

pub use error::{Error, PlannerLog};
pub use scene::SimScene;
