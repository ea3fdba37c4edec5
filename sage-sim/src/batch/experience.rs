//! What an adversary knows of the driver: its drives, its successes, and how far its training is.

use std::sync::Arc;

use super::Recent;
use crate::{
    curriculum::{Progress, SuccessRates},
    evaluation::SHORTEST_DRIVE,
    vehicle::Motion,
};

/// Scenes whose newest drive is kept.
const DRIVES: usize = 1024;

/// What an adversary knows of the driver.
pub(super) struct Experience {
    /// The newest drive in each scene, by the number of the scene.
    pub(super) drives: Recent<usize, Arc<[Motion]>>,
    success: SuccessRates,
    steps: u64,
}

impl Default for Experience {
    fn default() -> Self {
        Self { drives: Recent::new(DRIVES), success: SuccessRates::default(), steps: 0 }
    }
}

/// An episode that is over, as the adversary learns of it.
pub(super) struct Lesson {
    pub(super) scene: usize,
    pub(super) motions: Vec<Motion>,
    pub(super) intensity: Option<f64>,
    /// `None` if it shows neither success nor failure.
    pub(super) success: Option<bool>,
}

impl Experience {
    /// Counts a step.
    pub(super) fn count_step(&mut self) {
        self.steps += 1;
    }

    /// Learns of an episode that is over.
    pub(super) fn learn(&mut self, lesson: Lesson) {
        if lesson.motions.len() > SHORTEST_DRIVE {
            self.drives.put(lesson.scene, lesson.motions.into());
        }
        if let Some(success) = lesson.success {
            self.success.count(lesson.intensity, success);
        }
    }

    /// How far a training of so many steps is.
    pub(super) fn progress(&self, steps: f64) -> Progress<'_> {
        Progress { share: (self.steps as f64 / steps.max(1.0)).min(1.0), success: &self.success }
    }
}
