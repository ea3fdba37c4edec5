//! Errors of a simulation, grouped by how a caller can react.

/// An error of `sage-sim`.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Scenes, trajectories and plans with bad numbers, unknown names, or options that a part refuses.
    #[error(transparent)]
    Core(#[from] sage_core::Error),
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
}
