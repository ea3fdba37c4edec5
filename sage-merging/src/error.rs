//! What can go wrong when experts are put together.

/// An error of `sage-merging`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Weights that do not fit, files that cannot be read.
    #[error(transparent)]
    Network(#[from] sage_backbones::Error),
    /// A mixture that a merger does not take.
    #[error("{problem}")]
    Mixture {
        /// The weights, and what was expected.
        problem: String,
    },
    /// An expert that the set does not hold.
    #[error("no expert `{name}`; there are {}", known.join(", "))]
    Expert {
        /// Name asked for.
        name: String,
        /// Names that exist.
        known: Vec<String>,
    },
}

impl From<sage_backbones::candle::Error> for Error {
    fn from(error: sage_backbones::candle::Error) -> Self {
        Self::Network(error.into())
    }
}
