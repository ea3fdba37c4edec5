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
    Tensor(candle_core::Error),
    /// Weights that do not fit the network.
    #[error("{what}: {}", first(problems))]
    Weights {
        /// The file, or where the weights come from.
        what: String,
        /// Each tensor at fault, and why.
        problems: Vec<String>,
    },
    /// A file that cannot be read or written.
    #[error("cannot {verb} `{}`", path.display())]
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
    /// Work that cannot go on: broken weights, a value out of range, a number that is not finite.
    #[error("{0}")]
    Training(String),
    /// One of many agents that work failed for.
    #[error("scene `{scene}`, agent `{agent}`")]
    Agent {
        /// The scene's name.
        scene: String,
        /// The agent's id.
        agent: String,
        /// What failed.
        source: Box<Self>,
    },
}

impl From<candle_core::Error> for Error {
    fn from(error: candle_core::Error) -> Self {
        Self::Tensor(error)
    }
}

/// Problems named in a message; there may be one for each of hundreds of tensors.
const NAMED: usize = 6;

/// The first problems and the number of the others.
fn first(problems: &[String]) -> String {
    let named = problems[..problems.len().min(NAMED)].join("; ");
    match problems.len().saturating_sub(NAMED) {
        0 => named,
        more => format!("{named}; and {more} more like these"),
    }
}
