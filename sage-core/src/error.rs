//! What can go wrong with scenes, candidates and options, by what a caller can do about it.

use crate::geometry::MAX_COORDINATE;

/// An error of `sage-core`.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A position that is NaN, infinite or farther out than [`crate::motion::MAX_COORDINATE`].
    #[error(
        "{what}: point {index} is [{:?}, {:?}]; expected finite coordinates within ±{MAX_COORDINATE:e} m",
        .point[0], .point[1]
    )]
    NotFinite {
        /// The candidate or path at fault.
        what: String,
        /// Index of the point, from 0.
        index: usize,
        /// The point as given.
        point: [f64; 2],
    },
    /// A path of another length than the horizon.
    #[error("{what}: {found} points, expected {expected}")]
    Length {
        /// The candidate or path at fault.
        what: String,
        /// Points found.
        found: usize,
        /// Points needed.
        expected: usize,
    },
    /// A scene that lacks what the call needs.
    #[error("scene `{scene}`: {problem}")]
    Scene {
        /// Identifier of the scene.
        scene: String,
        /// What is missing and what to do about it.
        problem: String,
    },
    /// A name that a registry does not hold.
    #[error("unknown {kind} `{name}`; known: {}", known.join(", "))]
    Unknown {
        /// Kind of the registry.
        kind: &'static str,
        /// Name asked for.
        name: String,
        /// Names that exist.
        known: Vec<&'static str>,
    },
    /// Two entries of one name.
    #[error("{kind} `{name}` is registered twice")]
    Duplicate {
        /// Kind of the registry.
        kind: &'static str,
        /// The name.
        name: &'static str,
    },
    /// Options that an entry does not accept.
    #[error("options of {kind} `{name}`: {problem}")]
    Options {
        /// Kind of the registry.
        kind: &'static str,
        /// Entry whose options they are.
        name: &'static str,
        /// What the entry says of them.
        problem: String,
    },
}
