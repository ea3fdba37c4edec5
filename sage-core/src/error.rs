//! Errors of scenes, candidates and options, grouped by how a caller can react.

use crate::{geometry::MAX_COORDINATE, motion::PathTooLong};

/// An error of `sage-core`.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A position that is NaN, infinite or outside ±[`crate::motion::MAX_COORDINATE`].
    #[error(
        "{what}: point {index} is [{:?}, {:?}]; expected finite coordinates within ±{MAX_COORDINATE:e} m",
        .point[0], .point[1]
    )]
    NotFinite {
        /// Name of the candidate or trajectory that holds the point.
        what: String,
        /// Index of the point, from 0.
        index: usize,
        /// The point as given.
        point: [f64; 2],
    },
    /// A position too far from the one before, or behind too long a path.
    #[error("{what}: point {} {problem}", problem.frame())]
    TooLong {
        /// Name of the candidate or trajectory that holds the point.
        what: String,
        /// The limit that it exceeds; its frame is the index of the point, from 0.
        problem: PathTooLong,
    },
    /// A trajectory whose length is not the horizon.
    #[error("{what}: {found} points, expected {expected}")]
    Length {
        /// Name of the candidate or trajectory.
        what: String,
        /// Points found.
        found: usize,
        /// Points expected.
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
    /// Ego and adversary overlap *now*, so no attack can be measured ([`crate::objective::violation::CONTACT_NOW`]).
    #[error(
        "scene `{scene}`: contact_now: the boxes of ego `{ego}` and adversary `{adversary}` overlap at frame {}, so no \
         attack can be measured; name another track as the adversary",
        crate::motion::NOW
    )]
    ContactNow {
        /// Identifier of the scene.
        scene: String,
        /// Track of the ego.
        ego: String,
        /// Track of the adversary.
        adversary: String,
    },
    /// A person who was asked for has no place beside the ego's recorded way, so nothing can be measured.
    #[error(
        "scene `{scene}`: no_place: there is no place for a {who}; {why}. Other values of the place may have one"
    )]
    NoPlace {
        /// Identifier of the scene.
        scene: String,
        /// What the person is.
        who: String,
        /// How many places were tried, and why they are none.
        why: String,
    },
    /// A name that is not in a registry.
    #[error("unknown {kind} `{name}`; known: {}", listed(known))]
    Unknown {
        /// Kind of the registry.
        kind: &'static str,
        /// The unknown name.
        name: String,
        /// Names that are registered.
        known: Vec<String>,
    },
    /// Two entries with the same name.
    #[error("{kind} `{name}` is registered twice")]
    Duplicate {
        /// Kind of the registry.
        kind: &'static str,
        /// The name.
        name: String,
    },
    /// Options that an entry refuses.
    #[error("options of {kind} `{name}`: {problem}")]
    Options {
        /// Kind of the registry.
        kind: &'static str,
        /// Entry that the options belong to.
        name: &'static str,
        /// Message of the entry.
        problem: String,
    },
}

/// Names as a list; one with a comma stands in backticks.
fn listed(names: &[String]) -> String {
    let quoted = |name: &String| if name.contains(", ") { format!("`{name}`") } else { name.clone() };
    names.iter().map(quoted).collect::<Vec<_>>().join(", ")
}
