//! Changes of bytes that fit any format. Each returns its name.

use sage_core::seed::Rng;

/// Longest slice that is removed or duplicated, bytes.
const LONGEST: usize = 400;

/// Flips up to four bits.
pub(super) fn flip(bytes: &mut [u8], rng: &mut Rng) -> &'static str {
    for _ in 0..1 + rng.below(4) {
        let at = rng.below(bytes.len());
        bytes[at] ^= 1 << rng.below(8);
    }
    "bits flipped"
}

/// Cuts the bytes off.
pub(super) fn cut(bytes: &mut Vec<u8>, at: usize) -> &'static str {
    bytes.truncate(at);
    "cut"
}

/// Removes a slice.
pub(super) fn remove(bytes: &mut Vec<u8>, at: usize, rng: &mut Rng) -> &'static str {
    let to = (at + rng.below(LONGEST)).min(bytes.len());
    bytes.drain(at..to);
    "slice removed"
}

/// Inserts a copy of a slice somewhere.
pub(super) fn duplicate(bytes: &mut Vec<u8>, at: usize, rng: &mut Rng) -> &'static str {
    let to = (at + rng.below(LONGEST)).min(bytes.len());
    let slice = bytes[at..to].to_vec();
    let at = rng.below(bytes.len());
    bytes.splice(at..at, slice);
    "slice moved"
}
