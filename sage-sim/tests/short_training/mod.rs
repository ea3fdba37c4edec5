//! A training run of a second, on procedural scenes.

use std::sync::Arc;

use sage_core::scene::SceneIndex;
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    rl::{Td3Options, TrainingOptions},
};

/// Procedural scenes with an adversary.
pub fn scenes(count: u64, seed: u64) -> Vec<Arc<SimScene>> {
    let made = (0..count).filter_map(|number| {
        let scene = generate(Kind::ALL[number as usize % Kind::ALL.len()], seed, number)?;
        SimScene::new(Arc::new(scene.clone()), SceneIndex::new(scene.map.clone())).ok()
    });
    made.filter(|scene| scene.scene().adversary.is_some()).collect()
}

/// Options of a short run.
pub fn small() -> TrainingOptions {
    TrainingOptions {
        td3: Td3Options {
            hidden: [16, 16],
            batch: 32,
            random_steps: 200,
            buffer: 500,
            ..Td3Options::default()
        },
        updates: 600,
        ratio: 0.5,
        evaluations: 3,
        drives: 2,
        refresh_after: Some(200),
        seed: 7,
        ..TrainingOptions::default()
    }
}
