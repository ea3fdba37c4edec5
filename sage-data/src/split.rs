//! Splits: named lists of scenes for training, selection and reporting.
//!
//! A split file is a JSON object whose values are lists of scene numbers or names; other values (notes) are
//! ignored.

use std::{collections::BTreeMap, path::Path};

use crate::Error;

/// Split name to scene names, in the order of the file.
pub type Splits = BTreeMap<String, Vec<String>>;

/// Largest split file that is read, bytes.
const LIMIT: u64 = 16 << 20;

/// Reads a split file.
///
/// *Errors*: [`Error::Read`]; [`Error::Field`] if the file is not such a JSON object.
///
/// ```
/// use sage_data::split::read_splits;
///
/// let folder = tempfile::tempdir()?;
/// let file = folder.path().join("splits.json");
/// std::fs::write(&file, r#"{"note": "by street", "train": [0, 7], "val": ["crossing"]}"#)?;
/// let splits = read_splits(&file)?;
/// // Numbers become names; what is no list is a note.
/// assert_eq!((&splits["train"][..], &splits["val"][0][..]), (&["0".to_owned(), "7".to_owned()][..], "crossing"));
/// assert_eq!(splits.len(), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_splits(path: &Path) -> Result<Splits, Error> {
    use serde_json::Value;
    let bytes = sage_core::files::read_argument(path, LIMIT)
        .map_err(|source| Error::Read { path: path.to_owned(), source })?;
    let fail = |field: &str, found: String, expected: &str| Error::Field {
        path: path.to_owned(),
        field: field.to_owned(),
        found,
        expected: expected.to_owned(),
    };
    let root: BTreeMap<String, Value> = serde_json::from_slice(&bytes)
        .map_err(|error| fail("", error.to_string(), "a JSON object of split name to list of scenes"))?;
    let mut splits = Splits::new();
    for (name, value) in root {
        let Value::Array(items) = value else { continue };
        let mut scenes = Vec::with_capacity(items.len());
        for item in items {
            match item {
                Value::Number(number) => scenes.push(number.to_string()),
                Value::String(text) => scenes.push(text),
                other => return Err(fail(&name, other.to_string(), "a scene number or name")),
            }
        }
        splits.insert(name, scenes);
    }
    Ok(splits)
}
