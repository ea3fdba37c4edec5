//! Scenes, policies and simulations of the tests of the world.

#![allow(dead_code, clippy::unwrap_used)] // Each test uses some of it; a failed unwrap is a failed test.

use std::sync::Arc;

use sage_core::scene::SceneIndex;
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    drive::Simulation,
    policy::{EgoPolicy, policies},
    world::WorldOptions,
};

use crate::{hand_made::prepared, reference};

pub fn policy(name: &str) -> Box<dyn EgoPolicy> {
    policies().unwrap().build_default(name).unwrap()
}

/// Procedural scenes of every kind, and the recorded scenes of `dev` and `val` if they are there.
pub fn scenes() -> Vec<Arc<SimScene>> {
    let procedural = Kind::ALL.iter().flat_map(|kind| (0..3).filter_map(|n| generate(*kind, 1, n)));
    let mut scenes: Vec<_> = procedural.map(prepared).collect();
    for scene in reference::scenes(&["dev", "val"]) {
        let index = SceneIndex::new(scene.map.clone());
        scenes.push(SimScene::new(scene, index).unwrap());
    }
    scenes
}

pub fn simulation(scene: &Arc<SimScene>, name: &str, options: WorldOptions) -> Simulation {
    Simulation::new(scene, &Arc::new(options), None, policy(name).as_ref(), 7).unwrap()
}
