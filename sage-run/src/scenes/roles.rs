//! Scenes under other role assignments, for trainings.

use std::sync::Arc;

use rayon::prelude::*;
use sage_backbones::training::role_assignments;
use sage_core::scene::SceneData;

/// Adds to the scenes the same scenes under other role assignments, at most `most` for each. They share map and index.
pub fn with_other_roles(scenes: Vec<SceneData>, most: usize) -> Vec<SceneData> {
    let reassigned = |data: &SceneData| -> Vec<SceneData> {
        let roles = role_assignments(&data.scene, most).into_iter().enumerate();
        let named = roles.map(|(k, scene)| SceneData {
            name: format!("{} roles {}", data.name, k + 1),
            scene: Arc::new(scene),
            index: data.index.clone(),
        });
        named.collect()
    };
    let others: Vec<Vec<SceneData>> = scenes.par_iter().map(reassigned).collect();
    scenes.into_iter().chain(others.into_iter().flatten()).collect()
}
