//! Errors of loading and mixing experts.

/// An error of `sage-merging`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Weights that do not fit together, or files that cannot be read.
    #[error(transparent)]
    Network(#[from] sage_backbones::Error),
    /// A mixture that a merger refuses.
    #[error("{problem}")]
    Mixture {
        /// The weights, and what was expected.
        problem: String,
    },
    /// An expert that is not in the set.
    #[error("no expert `{name}`; there are {}", known.join(", "))]
    Expert {
        /// The unknown name.
        name: String,
        /// Names of the set's experts.
        known: Vec<String>,
    },
}

impl From<sage_backbones::candle::Error> for Error {
    fn from(error: sage_backbones::candle::Error) -> Self {
        Self::Network(error.into())
    }
}
