//! What can go wrong with networks, weights and training, by what a caller can do about it.

use std::path::PathBuf;

/// An error of `sage-backbones`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A scene or an agent that a network cannot work with, a name that no registry holds.
    #[error(transparent)]
    Core(#[from] sage_core::Error),
    /// A layer that was given tensors that do not fit.
    #[error("network: {0}")]
    Tensor(#[from] candle_core::Error),
    /// Weights that do not fit the network.
    #[error("{what}: {}", problems.join("; "))]
    Weights {
        /// The file, or where the weights come from.
        what: String,
        /// Each tensor at fault, and why.
        problems: Vec<String>,
    },
    /// A file that cannot be read or written.
    #[error("cannot {verb} `{}`: {source}", path.display())]
    Io {
        /// "read" or "write".
        verb: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file whose content is not what it should be.
    #[error("`{}`: {problem}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// Training that cannot go on.
    #[error("{0}")]
    Training(String),
}
