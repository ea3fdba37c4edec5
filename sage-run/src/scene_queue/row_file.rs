//! Files of rows whose fields are not of interest: which run wrote one, and what is printed of it.

use std::{borrow::Cow, fmt, path::Path};

use advsage::rows::ROW_LIMIT;
use sage_core::files;
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{IgnoredAny, MapAccess, Visitor},
};
use serde_json::value::RawValue;

use crate::{Result, terminal};

/// True if a file is a row of the run with a hash. A row is a JSON object whose first field is `run_hash`.
pub fn is_row_of(path: &Path, run_hash: &str) -> bool {
    // Rows with candidates are long, so only the start is read; that it ends early is an error to the parser.
    let start = files::read_start(path, run_hash.len() as u64 + 64).unwrap_or_default();
    let mut hash = RunHash(None);
    let _ = serde_json::Deserializer::from_slice(&start).deserialize_map(&mut hash);
    hash.0.is_some_and(|hash| hash == run_hash)
}

/// The first field of a row, if it is the hash of a run.
struct RunHash(Option<String>);

impl<'j> Visitor<'j> for &mut RunHash {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a row")
    }

    fn visit_map<A: MapAccess<'j>>(self, mut map: A) -> Result<(), A::Error> {
        if map.next_key::<Cow<str>>()?.is_some_and(|key| key == "run_hash") {
            self.0 = Some(map.next_value()?);
        }
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(())
    }
}

/// The JSON line of a row's file, with the times of the work if this run did it.
///
/// *Errors*: the file cannot be read, or it is not a row.
pub(super) fn json_line(path: &Path, seconds: Option<f64>, step_ms: Option<f64>) -> Result<Vec<u8>> {
    let text = files::read_text(path, ROW_LIMIT)?;
    let printed = Printed { row: serde_json::from_str(&text)?, seconds, step_ms };
    let mut line = Vec::with_capacity(text.len() + 32);
    terminal::json_line(&mut line, &printed)?;
    Ok(line)
}

#[derive(Serialize)]
struct Printed<'j> {
    #[serde(flatten)]
    row: Fields<'j>,
    seconds: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    step_ms: Option<f64>,
}

/// The fields of a row in their order, with the values as they are written.
struct Fields<'j>(Vec<(Cow<'j, str>, &'j RawValue)>);

impl Serialize for Fields<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(key, value)| (key, value)))
    }
}

impl<'de: 'j, 'j> Deserialize<'de> for Fields<'j> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Object;
        impl<'j> Visitor<'j> for Object {
            type Value = Fields<'j>;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a row")
            }

            fn visit_map<A: MapAccess<'j>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut fields = Vec::new();
                while let Some(field) = map.next_entry()? {
                    fields.push(field);
                }
                Ok(Fields(fields))
            }
        }
        deserializer.deserialize_map(Object)
    }
}
