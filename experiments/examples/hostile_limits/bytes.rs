//! Mutations of any file, and of the parts of a safetensors file.

use sage_core::{
    content_hash::{HashedTensor, content_hash, split_hash, with_hash},
    seed::Rng,
};
use serde_json::{Map, Value};

/// Words that stand in for a number.
const NUMBERS: [&str; 16] = [
    "0",
    "-1",
    "1",
    "1e308",
    "-1e308",
    "1e400",
    "1e-320",
    "18446744073709551615",
    "-9223372036854775808",
    "NaN",
    "null",
    "\"x\"",
    "[]",
    "{}",
    "1e9",
    "true",
];

/// The bytes with random damage.
pub fn damaged(mut bytes: Vec<u8>, rng: &mut Rng) -> Vec<u8> {
    if bytes.is_empty() {
        return bytes;
    }
    match rng.below(5) {
        0 => {
            for _ in 0..1 + rng.below(8) {
                let at = rng.below(bytes.len());
                bytes[at] ^= 1 << rng.below(8);
            }
        }
        1 => {
            for _ in 0..1 + rng.below(8) {
                let at = rng.below(bytes.len());
                bytes[at] = [0, 0xff, 0x7f, 0x80, rng.bits() as u8][rng.below(5)];
            }
        }
        2 => bytes.truncate(rng.below(bytes.len())),
        3 => {
            let from = rng.below(bytes.len());
            let to = (from + rng.below(400)).min(bytes.len());
            drop(bytes.drain(from..to));
        }
        _ => {
            let from = rng.below(bytes.len());
            let slice = bytes[from..(from + rng.below(400)).min(bytes.len())].to_vec();
            let at = rng.below(bytes.len());
            bytes.splice(at..at, slice);
        }
    }
    bytes
}

/// A text in which a few numbers are others, or no numbers.
pub fn with_other_numbers(text: &str, rng: &mut Rng) -> String {
    let is_number = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '+' | 'e');
    let mut words: Vec<String> = Vec::new();
    let mut was_number = None;
    for c in text.chars() {
        let own = is_number(c);
        match words.last_mut().filter(|_| was_number == Some(own)) {
            Some(word) => word.push(c),
            None => words.push(c.to_string()),
        }
        was_number = Some(own);
    }
    let numbers: Vec<usize> = (0..words.len()).filter(|k| words[*k].parse::<f64>().is_ok()).collect();
    if !numbers.is_empty() {
        for _ in 0..1 + rng.below(4) {
            words[numbers[rng.below(numbers.len())]] = NUMBERS[rng.below(NUMBERS.len())].to_owned();
        }
    }
    words.concat()
}

/// A safetensors file: the JSON under the one key of its metadata, the table of tensors, and the data.
pub struct TensorFile {
    key: String,
    pub json: String,
    tensors: Map<String, Value>,
    pub data: Vec<u8>,
}

impl TensorFile {
    pub fn of(bytes: &[u8]) -> Self {
        let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
        let mut tensors: Map<String, Value> = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
        let metadata = tensors.remove("__metadata__").unwrap();
        let (key, text) = metadata.as_object().unwrap().iter().next().unwrap();
        let (json, _) = split_hash(text.as_str().unwrap());
        Self { key: key.clone(), json, tensors, data: bytes[8 + length..].to_vec() }
    }

    /// The file with the hash of its content, as somebody who crafts one writes it.
    pub fn to_bytes(&self) -> Vec<u8> {
        let hashed = self.tensors.iter().map(|(name, tensor)| {
            let numbers = |key: &str| -> Vec<usize> {
                tensor[key].as_array().unwrap().iter().map(|n| n.as_u64().unwrap() as usize).collect()
            };
            let [from, to] = numbers("data_offsets")[..] else { panic!("two offsets") };
            let dtype = tensor["dtype"].as_str().unwrap().to_owned();
            (&name[..], HashedTensor { dtype, shape: numbers("shape"), bytes: &self.data[from..to] })
        });
        let text = with_hash(&self.json, &content_hash(&self.json, hashed));
        let mut header = self.tensors.clone();
        header.insert("__metadata__".to_owned(), serde_json::json!({ &self.key[..]: text }));
        let mut header = Value::Object(header).to_string();
        header.extend(std::iter::repeat_n(' ', header.len().next_multiple_of(8) - header.len()));
        [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &self.data].concat()
    }

    /// Numbers of the data that are others.
    pub fn spoil_numbers(&mut self, rng: &mut Rng) {
        let numbers = [f32::NAN, f32::INFINITY, 3e38, -3e38, 0.0, 1e-40, 1e9];
        for _ in 0..1 + rng.below(50) {
            let at = 4 * rng.below(self.data.len() / 4);
            self.data[at..at + 4].copy_from_slice(&numbers[rng.below(numbers.len())].to_le_bytes());
        }
    }
}
