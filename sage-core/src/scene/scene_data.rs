//! A scene as commands work on it: with its name in its data set and its spatial index.

use std::sync::Arc;

use super::{Scene, SceneIndex};
use crate::{Error, generator::Observation};

/// A scene with its name and its spatial index.
pub struct SceneData {
    /// Name in its data set, for messages and results.
    pub name: String,
    /// The scene.
    pub scene: Arc<Scene>,
    /// Its index.
    pub index: Arc<SceneIndex>,
}

impl SceneData {
    /// Indexes a scene.
    pub fn new(name: impl Into<String>, scene: Scene) -> Self {
        Self { name: name.into(), index: SceneIndex::new(scene.map.clone()), scene: Arc::new(scene) }
    }

    /// Observation of the scene *now*.
    ///
    /// *Errors*: as [`Observation::of`].
    pub fn observe(&self) -> Result<Observation, Error> {
        Observation::of(&self.scene, &self.index)
    }
}
