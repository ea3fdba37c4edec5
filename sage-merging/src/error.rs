//! Errors of loading and mixing experts.

/// An error of `sage-merging`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Weights that do not fit together, or files that cannot be read.
    #[error(transparent)]
    Network(#[from] sage_backbones::Error),
    /// Another number of weights than of experts.
    #[error("a mixture of {weights} weights for {experts} experts")]
    WeightCount {
        /// Number of weights.
        weights: usize,
        /// Number of experts.
        experts: usize,
    },
    /// A λ beyond the experts, for a merger that does not go there.
    #[error(
        "lambda is {0:?}; expected 0 (realistic) to 1 (adversarial): this merger does not go beyond the experts"
    )]
    BeyondExperts(f64),
    /// Weights that a merger refuses.
    #[error("the mixture is {weights:?}; {expected}")]
    Weights {
        /// The weights.
        weights: Vec<f64>,
        /// What the merger takes.
        expected: &'static str,
    },
    /// A mixture at which a weight of the network would not be finite.
    #[error("tensor `{tensor}` would hold {value} at the mixture {weights:?}")]
    NotFinite {
        /// The tensor.
        tensor: String,
        /// The value.
        value: f32,
        /// The weights of the experts.
        weights: Vec<f64>,
    },
    /// An option that names no tuned tensor.
    #[error("`powers` names `{start}`, and no tuned tensor begins so; there are {}", known.join(", "))]
    NoTensor {
        /// The beginning of names that was given.
        start: String,
        /// Names of the tuned tensors.
        known: Vec<String>,
    },
    /// Two experts of one name.
    #[error("there are two experts `{0}`")]
    SameName(String),
    /// A set without experts.
    #[error("there is no expert to mix")]
    NoExperts,
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
