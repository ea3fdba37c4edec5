//! Hashes of the content of a file of tensors, stored in its JSON header, so that a changed bit is noticed.
//!
//! The hash is the last field of the JSON text: `{…,"hash":"…"}`. It covers that text without the field, and the name,
//! type, shape and bytes of every tensor, in the order of the names.

use std::collections::BTreeMap;

/// Digits of a hash.
const DIGITS: usize = 64;
/// What stands before the digits, and after them.
const FIELD: [&str; 2] = [",\"hash\":\"", "\"}"];

/// A tensor, as far as the hash covers it.
#[derive(Clone, Debug)]
pub struct HashedTensor<'a> {
    /// Name of the type of its numbers, such as `F32`.
    pub dtype: String,
    /// Shape.
    pub shape: Vec<usize>,
    /// Bytes of its numbers, little-endian.
    pub bytes: &'a [u8],
}

/// What is wrong with the hash of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WrongHash {
    /// It is that of another content.
    #[error(
        "its content does not match the hash in its header: the file is damaged or was changed; copy or make it again"
    )]
    Differs,
    /// There is none.
    #[error(
        "it holds no hash of its content: it is damaged or another program has written it; copy or make it again"
    )]
    Missing,
}

/// The hash of a JSON object and some tensors, as hexadecimal digits.
pub fn content_hash<'a>(
    json: &str,
    tensors: impl IntoIterator<Item = (&'a str, HashedTensor<'a>)>,
) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut part = |bytes: &[u8]| {
        hasher.update(&(bytes.len() as u64).to_le_bytes()).update(bytes);
    };
    part(json.as_bytes());
    let sorted: BTreeMap<&str, HashedTensor> = tensors.into_iter().collect();
    for (name, tensor) in sorted {
        part(name.as_bytes());
        part(tensor.dtype.as_bytes());
        let shape: Vec<u8> = tensor.shape.iter().flat_map(|size| (*size as u64).to_le_bytes()).collect();
        part(&shape);
        part(tensor.bytes);
    }
    hasher.finalize().to_hex().to_string()
}

/// A JSON object with a hash as its last field. The object must not be empty.
pub fn with_hash(json: &str, hash: &str) -> String {
    let [before, after] = FIELD;
    format!("{}{before}{hash}{after}", json.strip_suffix('}').unwrap_or(json))
}

/// A JSON object without its hash, and the hash if it has one.
pub fn split_hash(text: &str) -> (String, Option<&str>) {
    let [before, after] = FIELD;
    let split = || {
        let (start, hash) = text.strip_suffix(after)?.rsplit_once(before)?;
        let is_hash = hash.len() == DIGITS && hash.bytes().all(|byte| byte.is_ascii_hexdigit());
        is_hash.then(|| (format!("{start}}}"), Some(hash)))
    };
    split().unwrap_or_else(|| (text.to_owned(), None))
}

fn has_hash_elsewhere(json: &str) -> bool {
    serde_json::from_str::<serde_json::Map<_, _>>(json).is_ok_and(|fields| fields.contains_key("hash"))
}

/// Compares the hash of a file with its content. Returns the JSON object without the hash.
///
/// *Errors*: [`WrongHash`].
pub fn check_hash<'a>(
    text: &str,
    tensors: impl IntoIterator<Item = (&'a str, HashedTensor<'a>)>,
) -> Result<String, WrongHash> {
    let (json, stored) = split_hash(text);
    match stored {
        // Another program has written the header again, or a digit of the hash is damaged.
        None if has_hash_elsewhere(&json) => Err(WrongHash::Differs),
        None => Err(WrongHash::Missing),
        Some(stored) if content_hash(&json, tensors) == stored => Ok(json),
        Some(_) => Err(WrongHash::Differs),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const JSON: &str = r#"{"name":"x","rows":[1,2.5]}"#;

    fn hash_of(json: &str, name: &str, dtype: &str, shape: &[usize], bytes: &[u8]) -> String {
        content_hash(json, [(name, HashedTensor { dtype: dtype.to_owned(), shape: shape.to_vec(), bytes })])
    }

    #[test]
    fn a_hash_is_the_last_field_and_comes_off_again() {
        let hash = hash_of(JSON, "a", "F32", &[1], &[0; 4]);
        let text = with_hash(JSON, &hash);
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap()["hash"], hash);
        assert_eq!(split_hash(&text), (JSON.to_owned(), Some(&*hash)));
        assert_eq!(split_hash(JSON), (JSON.to_owned(), None));
        let short = with_hash(JSON, "12");
        assert_eq!(split_hash(&short), (short.clone(), None));
    }

    #[test]
    fn every_part_changes_the_hash() {
        let all = [
            hash_of(JSON, "a", "F32", &[1], &[0; 4]),
            hash_of(&JSON.replace('x', "y"), "a", "F32", &[1], &[0; 4]),
            hash_of(JSON, "b", "F32", &[1], &[0; 4]),
            hash_of(JSON, "a", "I32", &[1], &[0; 4]),
            hash_of(JSON, "a", "F32", &[1, 1], &[0; 4]),
            hash_of(JSON, "a", "F32", &[1], &[0, 0, 0, 1]),
            content_hash(JSON, []),
        ];
        let different: std::collections::BTreeSet<&String> = all.iter().collect();
        assert_eq!(different.len(), all.len());
    }

    #[test]
    fn a_flipped_bit_and_a_missing_hash_are_noticed() {
        let bytes = [1, 2, 3, 4];
        let tensor = |bytes| [("a", HashedTensor { dtype: "F32".to_owned(), shape: vec![1], bytes })];
        let text = with_hash(JSON, &content_hash(JSON, tensor(&bytes)));
        assert_eq!(check_hash(&text, tensor(&bytes)), Ok(JSON.to_owned()));
        assert_eq!(check_hash(&text, tensor(&[1, 2, 3, 5])), Err(WrongHash::Differs));
        assert_eq!(check_hash(&text.replace("2.5", "2.6"), tensor(&bytes)), Err(WrongHash::Differs));
        assert_eq!(check_hash(JSON, tensor(&bytes)), Err(WrongHash::Missing));
        for changed in [text.replace("\"hash\":", "\"hash\": "), text.replace("\"}", "x\"}")] {
            assert_eq!(check_hash(&changed, tensor(&bytes)), Err(WrongHash::Differs), "{changed}");
        }
    }
}
