//! Scenes, geometry, motion and objectives: the base of all other crates of `sage`.
//!
//! - [`scene::Scene`] is a recorded traffic scene: tracks, map, lights, the ego (the car under test) and
//!   the adversary (the car whose future is replaced).
//! - [`objective::Context`] holds the scene data for scoring, built once for all candidates.
//! - [`objective::Reward`] and [`objective::Feasibility`] evaluate a [`objective::Candidate`].
//!
//! Positions are metres in the scene's world frame, angles radians counter-clockwise from +x. A frame lasts
//! [`motion::DT`] = 0.1 s. History is frames 0 to 10, *now* is frame 10, and the future is frames 11 to 90.
//!
//! ```
//! use sage_core::motion::{Pose, kinematics::paper};
//!
//! // 8 m/s straight ahead: no penalty beyond the formula's floor.
//! let points: Vec<[f64; 2]> = (1..=80).map(|t| [0.8 * t as f64, 0.0]).collect();
//! let start = Pose { position: [0.0, 0.0], heading: 0.0 };
//! let profile = paper::profile(&points, &start);
//! assert!((profile.speed[40] - 8.0).abs() < 1e-9);
//! ```

pub mod content_hash;
pub mod defect;
pub mod deformation;
pub mod error;
pub mod files;
pub mod generator;
pub mod geometry;
pub mod metric;
pub mod motion;
pub mod objective;
pub mod preference_pairs;
pub mod registry;
pub mod scene;
pub mod seed;
pub mod selection_outcome;
pub mod statistics;
pub mod text;

pub use error::Error;
