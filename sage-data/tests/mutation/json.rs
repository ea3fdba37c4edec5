//! Broken JSON of GPUDrive.

use sage_core::seed::Rng;
use sage_data::{
    Recording,
    procedural::{Kind, generate},
};
use serde_json::{Value, json};

use super::{
    Mutant, Mutator,
    slices::{cut, duplicate, flip, remove},
};

/// Values that replace others.
const WORDS: [&str; 22] = [
    "null",
    "true",
    "-1",
    "0",
    "91",
    "1e308",
    "-10000",
    "1e-320",
    "9223372036854775808",
    "NaN",
    "[]",
    "{}",
    "\"\"",
    "\"vehicle\"",
    "\"lane\"",
    "[[]]",
    "{\"x\":0,\"y\":0}",
    "0.1",
    "[0]",
    "\"stop\"",
    "-0",
    "123456789012345678901234567890",
];

/// Small scenes as JSON, with lights and all types of roads.
pub fn scenes() -> Vec<Vec<u8>> {
    let of = |kind| {
        let scene = generate(kind, 0, 0).expect("a scene");
        let json = Recording::procedural(scene).to_gpudrive().expect("written").json;
        let mut value: Value = serde_json::from_slice(&json).expect("JSON");
        value["objects"].as_array_mut().expect("a list").truncate(3);
        value["roads"].as_array_mut().expect("a list").truncate(12);
        value["tl_states"] = json!({"1": {"state": ["stop", "go"], "x": [0, 0], "y": [0, 0], "z": [0, 0], "time_index": [3, 9]}});
        value["metadata"]["tracks_to_predict"] = json!([{"track_index": 1, "difficulty": 2}]);
        value.to_string().into_bytes()
    };
    vec![of(Kind::Straight), of(Kind::FourWay)]
}

impl Mutator {
    /// The input of a number, JSON made from JSON.
    pub fn make_json(&self, number: u64) -> Mutant {
        let mut rng = Rng::new(number, "json", "mutation");
        let mut bytes = self.bases[rng.below(self.bases.len())].clone();
        let at = rng.below(bytes.len());
        let kind = match rng.below(6) {
            0 => flip(&mut bytes, &mut rng),
            1 => cut(&mut bytes, at),
            2 => remove(&mut bytes, at, &mut rng),
            3 => duplicate(&mut bytes, at, &mut rng),
            4 => {
                let digits: Vec<usize> = (0..bytes.len()).filter(|k| bytes[*k].is_ascii_digit()).collect();
                for _ in 0..1 + rng.below(3) {
                    bytes[digits[rng.below(digits.len())]] = b'0' + rng.below(10) as u8;
                }
                "digits replaced"
            }
            // Most of it is numbers, so a value is found behind one of the names.
            _ => {
                let names: Vec<usize> = (1..bytes.len()).filter(|k| bytes[k - 1..=*k] == *b"\":").collect();
                let from = names[rng.below(names.len())] + 1;
                let length = bytes[from..].iter().position(|byte| matches!(byte, b',' | b'}' | b']'));
                let to = from + length.unwrap_or(0);
                bytes.splice(from..to, WORDS[rng.below(WORDS.len())].bytes());
                "value replaced"
            }
        };
        Mutant { bytes, kind, hostile: None }
    }
}
