//! Scenes of a training, and others on which its result is measured.

use std::collections::HashSet;

use anyhow::Result;
use sage_core::scene::SceneData;
use sage_run::{Outcome, scenes, scenes::Scenes};

use crate::cli::TrainingScenesArgs;

/// Scenes of a training, with those on which its result is measured.
pub(super) struct TrainingScenes {
    /// Lists of both, for what fails.
    pub training: Scenes,
    pub validation: Scenes,
    pub train: Vec<SceneData>,
    /// Without the scenes of the training.
    pub dev: Vec<SceneData>,
}

impl TrainingScenes {
    /// Reads the scenes.
    ///
    /// *Errors*: as [`Scenes::of`] and [`Scenes::read_all`].
    pub(super) fn read(args: &TrainingScenesArgs, seed: u64) -> Result<Self> {
        let training = Scenes::of(&args.paths, &args.split.filter(), args.procedural, seed)?.attackable()?;
        let validation =
            if args.dev.is_empty() { Scenes::default() } else { Scenes::under(&args.dev)?.attackable()? };
        let train = training.read_all()?;
        let known: HashSet<[u8; 16]> = train.iter().map(|data| data.scene.content_hash()).collect();
        let mut dev = if args.dev.is_empty() { Vec::new() } else { validation.read_all()? };
        dev.retain(|data| !known.contains(&data.scene.content_hash()));
        Ok(Self { training, validation, train, dev })
    }

    /// Whether scenes were left out.
    pub(super) fn outcome(&self) -> Outcome {
        scenes::outcome_without(self.training.failure_count() + self.validation.failure_count())
    }
}
