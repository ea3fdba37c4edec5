//! What can go wrong before a scene is attacked; what goes wrong in a scene is a [`sage_core::Error`].

/// An error of `sage-generators`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A scene, a name that no registry holds, options that a part refuses.
    #[error(transparent)]
    Core(#[from] sage_core::Error),
    /// Networks and their weights.
    #[error(transparent)]
    Network(#[from] sage_backbones::Error),
    /// Experts and their mixtures.
    #[error(transparent)]
    Merging(#[from] sage_merging::Error),
    /// A generator that was not given what it needs.
    #[error("generator `{generator}` needs {needs}")]
    Inputs {
        /// Its name.
        generator: &'static str,
        /// What it was not given.
        needs: &'static str,
    },
    /// A dial, or a place on it, out of range.
    #[error("{problem}")]
    Dial {
        /// The value and what was expected.
        problem: String,
    },
}
