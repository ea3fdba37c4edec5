//! Errors of networks, weights and training, grouped by what a caller can do about them.

use std::path::PathBuf;

/// An error of `sage-backbones`. As a `String` it is what `Entry::build` of the registry returns.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A scene or an agent that a network cannot use, or a name that is not registered.
    #[error(transparent)]
    Core(#[from] sage_core::Error),
    /// Tensors that do not fit a layer.
    #[error("network: {0}")]
    Tensor(candle_core::Error),
    /// Weights that do not fit the network.
    #[error("{what}: {}", first(problems))]
    Weights {
        /// The file or another source of the weights.
        what: String,
        /// Every mismatch, with the name of its tensor.
        problems: Vec<String>,
    },
    /// A file that cannot be read or written.
    #[error("cannot {verb} `{}`", path.display())]
    Io {
        /// "read" or "write".
        verb: &'static str,
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file with invalid content.
    #[error("`{}`: {problem}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The problem and its remedy.
        problem: String,
    },
    /// A file of tensors that belong to no network of ours, such as a driving policy.
    #[error("`{}`: has no `sage` header, which says what network its tensors belong to", path.display())]
    NoNetwork {
        /// The file.
        path: PathBuf,
    },
    /// An option with a value that it cannot have, and why.
    #[error("{0}")]
    Option(String),
    /// A number that is not finite: of a loss, a gradient, a probability. Names what holds it.
    #[error("{0}")]
    NotFinite(String),
    /// Scenes, a network or an objective that nothing can be trained on or with.
    #[error("{0}")]
    NothingToTrain(String),
    /// Parts that do not belong together: an encoding and a network, a checkpoint and a network, an objective and what was
    /// measured.
    #[error("{0}")]
    Mismatch(String),
    /// A header or tensors that cannot be written.
    #[error("{0}")]
    Write(String),
    /// An error for one agent of a scene.
    #[error("scene `{scene}`, agent `{agent}`")]
    Agent {
        /// The scene's name.
        scene: String,
        /// The agent's id.
        agent: String,
        /// The error.
        source: Box<Self>,
    },
}

impl From<candle_core::Error> for Error {
    fn from(error: candle_core::Error) -> Self {
        Self::Tensor(error)
    }
}

impl From<Error> for String {
    fn from(error: Error) -> Self {
        error.to_string()
    }
}

/// Maximum number of problems in a message; hundreds of tensors may have one each.
const NAMED: usize = 6;

/// The first problems and the number of the others, as text.
fn first(problems: &[String]) -> String {
    let named = problems[..problems.len().min(NAMED)].join("; ");
    match problems.len().saturating_sub(NAMED) {
        0 => named,
        more => format!("{named}; and {more} more like these"),
    }
}
