//! Numbers in JSON, which has no infinity: such values are written as text.

use serde::{Serialize, Serializer};

#[derive(Serialize)]
#[serde(untagged)]
enum Written {
    Number(f64),
    Text(String),
}

impl Written {
    fn of(value: f64) -> Self {
        if value.is_finite() { Self::Number(value) } else { Self::Text(value.to_string()) }
    }
}

/// A number, or `inf`, `-inf` or `NaN`.
pub(crate) fn number<S: Serializer>(value: &f64, out: S) -> Result<S::Ok, S::Error> {
    Written::of(*value).serialize(out)
}

/// The same; nothing is null.
pub(crate) fn optional<S: Serializer>(value: &Option<f64>, out: S) -> Result<S::Ok, S::Error> {
    value.map(Written::of).serialize(out)
}
