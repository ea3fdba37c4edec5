//! Mutations of any file, and of the parts of a safetensors file.

use std::collections::BTreeMap;

use sage_core::{
    content_hash::{HashedTensor, content_hash, split_hash, with_hash},
    seed::Rng,
};
use serde::{Deserialize, Serialize};

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

/// Position of a tensor in a file, as safetensors writes it.
#[derive(Clone, Deserialize, Serialize)]
struct Tensor {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [usize; 2],
}

/// A safetensors file: the JSON under the one key of its metadata, the table of tensors, and the data.
pub struct TensorFile {
    key: String,
    pub json: String,
    tensors: BTreeMap<String, Tensor>,
    pub data: Vec<u8>,
}

/// Header of such a file.
#[derive(Deserialize, Serialize)]
struct Header {
    #[serde(rename = "__metadata__")]
    metadata: BTreeMap<String, String>,
    #[serde(flatten)]
    tensors: BTreeMap<String, Tensor>,
}

impl TensorFile {
    /// A file that this program wrote or that is shipped.
    pub fn of(bytes: &[u8]) -> Self {
        let length = u64::from_le_bytes(*bytes.first_chunk().expect("the file has a header")) as usize;
        let header: Header = serde_json::from_slice(&bytes[8..8 + length]).expect("the header is JSON");
        let (key, text) = header.metadata.into_iter().next().expect("the metadata has one key");
        let json = split_hash(&text).0;
        Self { key, json, tensors: header.tensors, data: bytes[8 + length..].to_vec() }
    }

    /// The file with the hash of its content, as somebody who crafts one writes it.
    pub fn to_bytes(&self) -> Vec<u8> {
        let hashed = self.tensors.iter().map(|(name, tensor)| {
            let [from, to] = tensor.data_offsets;
            let (dtype, shape) = (tensor.dtype.clone(), tensor.shape.clone());
            (&name[..], HashedTensor { dtype, shape, bytes: &self.data[from..to] })
        });
        let text = with_hash(&self.json, &content_hash(&self.json, hashed));
        let metadata = BTreeMap::from([(self.key.clone(), text)]);
        let header = Header { metadata, tensors: self.tensors.clone() };
        let mut header = serde_json::to_string(&header).expect("names and numbers are JSON");
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
