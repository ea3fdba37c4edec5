//! Files with one other value, so that a broken file is a line of a table: place, value, and the words of its error.
//!
//! | place | what it names |
//! | --- | --- |
//! | `/objects/0/id` | a value of JSON, or of the JSON in the header of a safetensors file |
//! | `tracks.position@3` | a number of a tensor |
//! | `*` | the whole file |
//!
//! A value is JSON; `-` takes it away; `raw …` is text in the notation of `programs.rs`; `copy PLACE` is the value of another
//! place; `zeros N` are N of them; `star N` is a line of N points that crosses itself everywhere.

use std::{collections::BTreeMap, f64::consts::TAU};

use sage_core::content_hash::{HashedTensor, content_hash, split_hash, with_hash};
use serde_json::{Value, json};

use super::{
    formats::{header, with_header},
    programs::assembled,
};

/// Stands for a value that is no JSON.
const RAW: &str = "\"@raw@\"";

/// A file with another value in a place.
pub fn changed(file: &[u8], place: &str, value: &str) -> Vec<u8> {
    if place == "*" {
        return assembled(value.trim_start_matches("raw "));
    }
    if file.first() == Some(&b'{') {
        return changed_json(&String::from_utf8_lossy(file), place, value).into_bytes();
    }
    let mut tensors = TensorFile::of(file);
    match place.split_once('@') {
        Some((name, index)) => {
            tensors.set(name, index.parse().expect("an index"), value.parse().expect("a number"))
        }
        None => tensors.json = changed_json(&tensors.json, place, value),
    }
    tensors.to_bytes()
}

/// JSON with another value in a place.
fn changed_json(json: &str, place: &str, value: &str) -> String {
    let mut all: Value = serde_json::from_str(json).expect("JSON");
    let (parent, key) = place.rsplit_once('/').expect("a place begins with /");
    let (word, rest) = value.split_once(' ').unwrap_or((value, ""));
    let new = match word {
        "-" => None,
        "raw" => Some(json!("@raw@")),
        "copy" => Some(all.pointer(rest).expect(rest).clone()),
        "zeros" => Some(vec![0; rest.parse().expect("a number")].into()),
        "star" => Some(star(rest.parse().expect("a number"))),
        _ => Some(serde_json::from_str(value).unwrap_or_else(|_| panic!("{value} is no JSON"))),
    };
    match (all.pointer_mut(parent).expect(place), new) {
        (Value::Object(fields), None) => drop(fields.remove(key).expect(place)),
        (Value::Object(fields), Some(new)) => drop(fields.insert(key.to_owned(), new)),
        (other, Some(new)) => other[key.parse::<usize>().expect(place)] = new,
        (_, None) => panic!("{place} is no field"),
    }
    let raw = || String::from_utf8(assembled(rest)).expect("text");
    if word == "raw" { all.to_string().replacen(RAW, &raw(), 1) } else { all.to_string() }
}

fn star(count: usize) -> Value {
    let turn = |k: usize| TAU * (k * (count / 2 - 1)) as f64 / count as f64;
    (0..count)
        .map(|k| json!({"x": 100.0 * turn(k).cos(), "y": 100.0 * turn(k).sin()}))
        .collect::<Vec<_>>()
        .into()
}

/// A safetensors file: the JSON under the one key of its metadata, the table of tensors, and the data.
pub struct TensorFile {
    key: String,
    pub json: String,
    has_hash: bool,
    tensors: BTreeMap<String, Value>,
    pub data: Vec<u8>,
}

impl TensorFile {
    /// A file that this program wrote or that is shipped.
    pub fn of(bytes: &[u8]) -> Self {
        let place = header(bytes).expect("the file has a header");
        let mut tensors: BTreeMap<String, Value> =
            serde_json::from_slice(&bytes[place.clone()]).expect("JSON");
        let metadata = tensors.remove("__metadata__").expect("metadata");
        let (key, text) = metadata.as_object().and_then(|fields| fields.iter().next()).expect("one key");
        let (json, hash) = split_hash(text.as_str().expect("a text"));
        let data = bytes[place.end..].to_vec();
        Self { key: key.clone(), json, has_hash: hash.is_some(), tensors, data }
    }

    /// Where the bytes of a tensor are.
    fn range(tensor: &Value) -> std::ops::Range<usize> {
        let [from, to] = [0, 1].map(|k| tensor["data_offsets"][k].as_u64().expect("a number") as usize);
        from..to
    }

    fn set(&mut self, name: &str, index: usize, value: f64) {
        let tensor = self.tensors.get(name).expect(name);
        let raw = match tensor["dtype"].as_str() {
            Some("F32") => (value as f32).to_le_bytes().to_vec(),
            Some("F64") => value.to_le_bytes().to_vec(),
            Some("I64") => (value as i64).to_le_bytes().to_vec(),
            _ => vec![value as u8],
        };
        let at = Self::range(tensor).start + raw.len() * index;
        self.data[at..at + raw.len()].copy_from_slice(&raw);
    }

    /// Names of the tensors.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// Takes the hash of the content away.
    pub fn without_hash(mut self) -> Self {
        self.has_hash = false;
        self
    }

    /// The file, with the hash of its content if it had one, as somebody who crafts one writes it.
    pub fn to_bytes(&self) -> Vec<u8> {
        let hashed = self.tensors.iter().map(|(name, tensor)| {
            let shape = tensor["shape"].as_array().expect("a shape");
            let shape = shape.iter().map(|size| size.as_u64().expect("a number") as usize).collect();
            let dtype = tensor["dtype"].as_str().expect("a type").to_owned();
            (&name[..], HashedTensor { dtype, shape, bytes: &self.data[Self::range(tensor)] })
        });
        let text = match self.has_hash {
            true => with_hash(&self.json, &content_hash(&self.json, hashed)),
            false => self.json.clone(),
        };
        let mut header = self.tensors.clone();
        header.insert("__metadata__".to_owned(), json!({&self.key: text}));
        with_header(&self.data, 0..0, serde_json::to_vec(&header).expect("JSON"))
    }
}
