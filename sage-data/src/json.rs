//! What is wrong with a JSON file, and where.

use std::path::Path;

use serde::Deserialize;

use crate::Error;

/// The error of a file that is no `T`, with the place of the value. The file is read once more to find it.
pub(crate) fn explained<'j, T: Deserialize<'j>>(
    path: &Path,
    body: &'j [u8],
    error: serde_json::Error,
) -> Error {
    let mut reader = serde_json::Deserializer::from_slice(body);
    let located = serde_path_to_error::deserialize::<_, T>(&mut reader);
    let field = located.err().map_or(String::new(), |error| error.path().to_string());
    // As in other errors: objects/3/position.
    let field = field.replace('[', ".").replace([']'], "").replace('.', "/");
    let line = body.split(|byte| *byte == b'\n').nth(error.line().saturating_sub(1)).unwrap_or_default();
    let at = &line[error.column().saturating_sub(1).min(line.len())..];
    let words = ["NaN", "Infinity", "-Infinity", "aN", "nfinity", "I"];
    let problem = match words.iter().any(|word| at.starts_with(word.as_bytes())) {
        true => format!("{error}: NaN and Infinity are no JSON; a finite number is expected"),
        false => error.to_string(),
    };
    let field = if field == "/" { String::new() } else { field };
    Error::Json { path: path.to_owned(), field, problem }
}
