//! Closed-loop simulation of recorded scenes on rapier2d, and the driving policies under test.

pub mod body;
pub mod drive;
pub mod environment;
pub mod fault;
pub mod following;
pub mod grid;
pub mod lines;
pub mod navigation;
pub mod observation;
pub mod physics;
pub mod policy;
pub mod rays;
pub mod route;
mod scene;
pub mod traffic;
pub mod vehicle;
pub mod world;

pub use scene::SimScene;
