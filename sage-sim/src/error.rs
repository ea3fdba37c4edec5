//! Errors of a simulation, grouped by how a caller can react.

use std::{fmt, path::Path};

use sage_core::motion::{DT, NOW};

use crate::drive::Drive;

/// An error of `sage-sim`.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Scenes, trajectories and plans with bad numbers, unknown names, or options that a part refuses.
    #[error(transparent)]
    Core(#[from] sage_core::Error),
    /// Options, a file or numbers that cannot be used, in words.
    #[error("{0}")]
    Value(String),
    /// A scene that cannot be simulated, whatever the policy.
    #[error("scene `{scene}`: {problem}")]
    Scene {
        /// Identifier of the scene.
        scene: String,
        /// What is wrong and what to do about it.
        problem: String,
    },
    /// A policy that cannot drive in a scene, or that gave no control, or one that is not finite.
    #[error("scene `{scene}`: {problem}")]
    Policy {
        /// Identifier of the scene.
        scene: String,
        /// What is wrong and what to do about it.
        problem: String,
    },
    /// An attack that no vehicle of the scene can carry out.
    #[error("scene `{scene}`: {problem}")]
    Plan {
        /// Identifier of the scene.
        scene: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A call that the state of a simulation does not allow.
    #[error("scene `{scene}`: {problem}")]
    Call {
        /// Identifier of the scene.
        scene: String,
        /// The state, and what to call instead.
        problem: String,
    },
    /// A call of a batch of environments that its state does not allow.
    #[error("{problem}")]
    Batch {
        /// The state, and what to call instead.
        problem: String,
    },
    /// A planner's program that did not start, ended, was late, or answered nonsense. Its drive has no result; other drives
    /// are not concerned.
    #[error("scene `{scene}`{}: {problem}{log}", step.map_or(String::new(), in_time))]
    Planner {
        /// Identifier of the scene.
        scene: String,
        /// Step of the drive; `None` if the program did not start.
        step: Option<usize>,
        /// Whether an answer did not come in time, which another try may mend.
        is_late: bool,
        /// The command, and what happened.
        problem: String,
        /// What it wrote to its standard error.
        log: PlannerLog,
        /// The drive up to there, if it had begun.
        drive: Option<Box<Drive>>,
    },
    /// A driver whose state cannot be copied.
    #[error("the drive cannot be saved: {problem}")]
    Clone {
        /// Which one, and why.
        problem: String,
    },
}

/// A step as a place in time.
fn in_time(step: usize) -> String {
    let seconds = (step as f64 - NOW as f64) * DT;
    let side = if seconds < 0.0 { "before" } else { "after" };
    format!(", {:.1} s {side} now (step {step})", seconds.abs())
}

impl Error {
    /// The error as one of a scene in `sage-core`, for those that only know scenes.
    pub fn in_scene(self, scene: &sage_core::scene::Scene) -> sage_core::Error {
        match self {
            Self::Core(error) => error,
            other => sage_core::Error::Scene { scene: scene.id.clone(), problem: other.to_string() },
        }
    }

    /// Whether a planner's answer did not come in time.
    pub(crate) fn is_late(&self) -> bool {
        matches!(self, Self::Planner { is_late: true, .. })
    }

    /// The error of a drive that was begun twice.
    pub(crate) fn repeated(mut self) -> Self {
        if let Self::Planner { problem, .. } = &mut self {
            problem.push_str("; the drive was begun twice");
        }
        self
    }

    /// The error with the drive that it ended; only that of a planner holds one.
    #[must_use]
    pub(crate) fn with_drive(mut self, ended: Drive) -> Self {
        if let Self::Planner { drive, .. } = &mut self {
            *drive = Some(Box::new(ended));
        }
        self
    }
}

/// The end of what a planner wrote to its standard error in a drive.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PlannerLog {
    /// The file that holds all of it, as messages name it; empty for a temporary one.
    pub file: String,
    /// Its last lines.
    pub lines: Box<[String]>,
}

impl PlannerLog {
    /// A log of a path and its last lines.
    #[cfg(unix)]
    pub(crate) fn of(path: Option<&Path>, lines: Vec<String>) -> Self {
        Self { file: path.map(|path| path.display().to_string()).unwrap_or_default(), lines: lines.into() }
    }
}

impl fmt::Display for PlannerLog {
    /// As an addition to a message, in one line; nothing if it wrote nothing.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.lines.is_empty() {
            return Ok(());
        }
        let place = if self.file.is_empty() { String::new() } else { format!(" (`{}`)", self.file) };
        let lines: Vec<&str> = self.lines.iter().map(|line| line.trim()).collect();
        write!(f, "; the end of its standard error{place}: {}", lines.join(" | "))
    }
}
