//! Damage that fits any format. Each kind has a name.

use sage_core::seed::Rng;

/// Longest slice that is removed or copied, bytes.
const LONGEST: usize = 400;
/// Bytes behind which formats have counts: opcodes of pickles, keys of messages.
const COUNTED: &[u8] = b"XBTCUJM\x8b\x8c\x8d\x8e\x95\x96\x0a\x12\x1a\x3a\x42";
/// What stands in for numbers and words of texts.
const WORDS: &str = r#"0 -1 1 91 0.1 -0 1e9 1e308 -1e308 1e400 1e-320 -10000 18446744073709551615 9223372036854775808 -9223372036854775808 123456789012345678901234567890 NaN
    null true [] {} "" [[]] [0] "x" "vehicle" "lane" "stop" {"x":0,"y":0}"#;

/// Damages bytes. Returns the kind of damage.
pub fn any(bytes: &mut Vec<u8>, rng: &mut Rng) -> &'static str {
    if bytes.is_empty() {
        return "empty";
    }
    let at = rng.below(bytes.len());
    let slice = at..(at + rng.below(LONGEST)).min(bytes.len());
    let times = 1 + rng.below(8);
    match rng.below(11) {
        0 => {
            for _ in 0..times {
                let at = rng.below(bytes.len());
                bytes[at] ^= 1 << rng.below(8);
            }
            "bits flipped"
        }
        1 => {
            let values = [0, 0xff, 0x7f, 0x80, rng.bits() as u8];
            for _ in 0..times {
                let at = rng.below(bytes.len());
                bytes[at] = values[rng.below(5)];
            }
            "bytes replaced"
        }
        2 => {
            bytes.truncate(at);
            "cut"
        }
        3 => {
            drop(bytes.drain(slice));
            "slice removed"
        }
        4 => {
            let copy = bytes[slice].to_vec();
            bytes.splice(at..at, copy);
            "slice copied"
        }
        5 => {
            numbers(bytes, rng);
            "values replaced"
        }
        6 => {
            count(bytes, rng);
            "count blown up"
        }
        7 => {
            let places: Vec<usize> = (0..bytes.len()).filter(|k| bytes[*k].is_ascii_digit()).collect();
            for _ in 0..times.min(places.len()) {
                bytes[places[rng.below(places.len())]] = b"0123456789-.eL"[rng.below(14)];
            }
            "digits replaced"
        }
        8 => {
            word(bytes, rng, |byte| byte.is_ascii_digit());
            "number replaced"
        }
        9 => {
            word(bytes, rng, |byte| byte.is_ascii_alphabetic() || byte == b'_');
            "word replaced"
        }
        _ => {
            let part = bytes[at..(at + 1 + rng.below(9)).min(bytes.len())].to_vec();
            let again = part.repeat(1 << rng.below(15));
            bytes.splice(at..at, again);
            "part repeated"
        }
    }
}

/// Damages a value of a text: a digit, a number or a word, so that most texts can still be parsed.
pub fn value(bytes: &mut Vec<u8>, rng: &mut Rng) {
    match rng.below(3) {
        0 => word(bytes, rng, |byte| byte.is_ascii_alphabetic() || byte == b'_'),
        _ => word(bytes, rng, |byte| byte.is_ascii_digit()),
    }
}

/// Replaces floats by values that no file has.
pub fn numbers(bytes: &mut [u8], rng: &mut Rng) {
    let values = [f64::NAN, f64::INFINITY, 3e38, -1e30, 0.0, 1e-40, 1e300, -1e9, 1e9];
    for _ in 0..1 + rng.below(20) {
        let value = values[rng.below(values.len())];
        let raw = if rng.below(2) == 0 {
            value.to_le_bytes().to_vec()
        } else {
            (value as f32).to_le_bytes().to_vec()
        };
        let at = rng.below(bytes.len());
        let end = (at + raw.len()).min(bytes.len());
        bytes[at..end].copy_from_slice(&raw[..end - at]);
    }
}

/// Replaces a count: one behind a byte that announces one, the first bytes, or any.
fn count(bytes: &mut [u8], rng: &mut Rng) {
    let counted: Vec<usize> = (1..bytes.len()).filter(|k| COUNTED.contains(&bytes[k - 1])).collect();
    let at = match rng.below(4) {
        0 => 0,
        1 => rng.below(bytes.len()),
        _ => counted.get(rng.below(counted.len().max(1))).copied().unwrap_or(0),
    };
    let size = [1, 4, 8][rng.below(3)];
    let end = (at + size).min(bytes.len());
    let mut before = [0; 8];
    before[..end - at].copy_from_slice(&bytes[at..end]);
    let before = u64::from_le_bytes(before);
    let values = [
        0,
        before + 1,
        before.wrapping_sub(1),
        u64::MAX,
        i64::MAX as u64,
        1 << 40,
        1 << 31,
        1 << 20,
        rng.bits(),
    ];
    bytes[at..end].copy_from_slice(&values[rng.below(values.len())].to_le_bytes()[..end - at]);
}

/// Replaces a run of certain characters by another word, or by a number near it.
fn word(bytes: &mut Vec<u8>, rng: &mut Rng, is_of_it: fn(u8) -> bool) {
    let starts: Vec<usize> =
        (0..bytes.len()).filter(|k| is_of_it(bytes[*k]) && (*k == 0 || !is_of_it(bytes[k - 1]))).collect();
    if starts.is_empty() {
        return;
    }
    let from = starts[rng.below(starts.len())];
    let to = from + bytes[from..].iter().take_while(|byte| is_of_it(**byte)).count();
    let old =
        std::str::from_utf8(&bytes[from..to]).ok().and_then(|text| text.parse::<u64>().ok()).unwrap_or(0);
    let new = match rng.below(4) {
        0 => [old + 1, old.saturating_sub(1), old.saturating_mul(2), 1 << 33][rng.below(4)].to_string(),
        _ => {
            let words: Vec<&str> = WORDS.split_whitespace().collect();
            words[rng.below(words.len())].to_owned()
        }
    };
    bytes.splice(from..to, new.bytes());
}
