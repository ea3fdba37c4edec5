//! Errors before a scene is attacked. Errors within a scene are a [`sage_core::Error`].

/// An error of `sage-generators`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Invalid scenes, unknown names, or options that a part refuses.
    #[error(transparent)]
    Core(#[from] sage_core::Error),
    /// Networks and their weights.
    #[error(transparent)]
    Network(#[from] sage_backbones::Error),
    /// Experts and their mixtures.
    #[error(transparent)]
    Merging(#[from] sage_merging::Error),
    /// A generator without an input that it needs.
    #[error("generator `{generator}` needs {needs}")]
    Inputs {
        /// Name of the generator.
        generator: &'static str,
        /// The missing input.
        needs: &'static str,
    },
    /// A dial or an aggression out of range.
    #[error("{problem}")]
    Dial {
        /// The value and what was expected.
        problem: String,
    },
}
