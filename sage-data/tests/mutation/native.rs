//! Broken native files.

use sage_core::seed::Rng;

use super::{Mutant, Mutator};

impl Mutator {
    /// The input of a number, file from native files.
    pub fn make_native(&self, number: u64) -> Mutant {
        let mut rng = Rng::new(number, "native", "mutation");
        let mut bytes = self.bases[rng.below(self.bases.len())].clone();
        let length = u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes")) as usize;
        let kind = match rng.below(9) {
            0 => {
                let value =
                    [0, 1, length as u64 + 1, length as u64 - 1, u64::MAX, 1 << 40, rng.bits()][rng.below(7)];
                bytes[..8].copy_from_slice(&value.to_le_bytes());
                "header length"
            }
            1 => {
                bytes.truncate(rng.below(bytes.len()));
                "cut"
            }
            2 => {
                for _ in 0..1 + rng.below(6) {
                    let at = 8 + rng.below(length);
                    bytes[at] = rng.bits() as u8;
                }
                "header bytes"
            }
            3 => {
                for _ in 0..1 + rng.below(20) {
                    let at = 8 + length + rng.below(bytes.len() - 8 - length);
                    bytes[at] = rng.bits() as u8;
                }
                "data bytes"
            }
            4 => {
                let at = 8 + length + rng.below((bytes.len() - 8 - length).saturating_sub(8).max(1));
                let end = (at + 4).min(bytes.len());
                let value = [f32::NAN, f32::INFINITY, f32::MAX, -1e30][rng.below(4)].to_le_bytes();
                bytes[at..end].copy_from_slice(&value[..end - at]);
                "values replaced"
            }
            how => {
                let text = String::from_utf8(bytes[8..8 + length].to_vec()).expect("a JSON header");
                let (text, kind) = changed_header(&text, how, &mut rng);
                let mut file = (text.len() as u64).to_le_bytes().to_vec();
                file.extend(text.bytes());
                file.extend(&bytes[8 + length..]);
                bytes = file;
                kind
            }
        };
        Mutant { bytes, kind, hostile: None }
    }
}

/// A header with changed numbers, a duplicate tensor, or a renamed key.
fn changed_header(text: &str, how: usize, rng: &mut Rng) -> (String, &'static str) {
    let digits: Vec<(usize, usize)> = {
        let mut runs = Vec::new();
        let mut start = None;
        for (k, c) in text.char_indices() {
            match (c.is_ascii_digit(), start) {
                (true, None) => start = Some(k),
                (false, Some(s)) => {
                    runs.push((s, k));
                    start = None;
                }
                _ => {}
            }
        }
        runs
    };
    match how {
        // Shapes, offsets, counts and indices: all are numbers of the header.
        5 | 6 => {
            let (from, to) = digits[rng.below(digits.len())];
            let old: u64 = text[from..to].parse().unwrap_or(0);
            let new = [0, old + 1, old.saturating_sub(1), old * 2, u64::MAX, 1 << 33, rng.bits() % 1000]
                [rng.below(7)];
            (format!("{}{new}{}", &text[..from], &text[to..]), "number replaced")
        }
        7 => {
            // One of these tensors again, with other offsets.
            let name = ["tracks.position", "map.points", "source.pickle"][rng.below(3)];
            let again = format!(r#","{name}":{{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}}}"#);
            (format!("{}{again}", text.trim_end().trim_end_matches('}').to_owned() + "}"), "duplicate key")
        }
        _ => {
            let from = ["tracks.", "map.", "lane.", "source.", "F32", "\\\"id\\\"", "VEHICLE"][rng.below(7)];
            (text.replacen(from, "x", 1 + rng.below(2)), "name replaced")
        }
    }
}
