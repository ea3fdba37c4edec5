//! Warnings about scenes.

use serde::Serialize;

use crate::repairs::Repair;

/// Kinds of warnings that change what is computed, besides the notes of [`Repair`].
const IMPORTANT: [&str; 14] = [
    "short-recording",
    "contact-now",
    "no-road-edges",
    "times-against-motion",
    "velocity-against-positions",
    "heading-against-positions",
    "jumps",
    "speed-beyond-vehicles",
    "size-beyond-vehicles",
    "heading-against-motion",
    "turns-while-standing",
    "recording-off-road",
    "trailer",
    "adversary-kind",
];

/// A warning about a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Stable name of its kind, for counting.
    pub kind: &'static str,
    /// What was found.
    pub detail: String,
    /// Whether it changes what is computed from the scene.
    pub is_important: bool,
}

impl Warning {
    pub(crate) fn new(kind: &'static str, detail: String) -> Self {
        let is_repair = Repair::ALL.iter().any(|repair| repair.name() == kind);
        Self { kind, detail, is_important: is_repair || IMPORTANT.contains(&kind) }
    }
}

impl Serialize for Warning {
    /// As `kind: detail`.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.kind, self.detail)
    }
}
