//! Broken `Scenario` messages. Their checksums are right, so that the messages are decoded.

use std::path::Path;

use sage_core::{scene::Scene, seed::Rng};
use sage_data::{Error, Recording, repairs::Repair, womd};

use super::{
    Mutant, Mutator, score,
    slices::{cut, duplicate, flip, remove},
};

/// The messages of a shard.
pub fn messages(shard: &[u8]) -> Vec<Vec<u8>> {
    let (mut messages, mut at) = (Vec::new(), 0);
    while let Some(length) = shard[at..].first_chunk() {
        let length = u64::from_le_bytes(*length) as usize;
        messages.push(shard[at + 12..at + 12 + length].to_vec());
        at += 16 + length;
    }
    messages
}

impl Mutator {
    /// The input of a number, a message made from messages.
    pub fn make_message(&self, number: u64) -> Mutant {
        let mut rng = Rng::new(number, "message", "mutation");
        let mut bytes = self.bases[rng.below(self.bases.len())].clone();
        let at = rng.below(bytes.len());
        let kind = match rng.below(8) {
            0 => flip(&mut bytes, &mut rng),
            1 => {
                for _ in 0..1 + rng.below(6) {
                    let at = rng.below(bytes.len());
                    bytes[at] = rng.bits() as u8;
                }
                "bytes replaced"
            }
            2 => cut(&mut bytes, at),
            3 => remove(&mut bytes, at, &mut rng),
            4 => duplicate(&mut bytes, at, &mut rng),
            5 => {
                // A key, a varint or a length of one of the fields, somewhere.
                let value = [0x08, 0x0a, 0x10, 0x12, 0x1a, 0x3a, 0x42, 0x7b, 0x80, 0xff, 0x00][rng.below(11)];
                let count = 1 + rng.below(12);
                bytes.splice(at..at, std::iter::repeat_n(value, count));
                "byte repeated"
            }
            6 => {
                let message =
                    [&[0x12, 0x00][..], &[0x42, 0x00], &[0x3a, 0x00], &[0x09, 0, 0, 0, 0, 0, 0, 0, 0]];
                let message = message[rng.below(4)];
                bytes.extend(std::iter::repeat_n(message, 1 << rng.below(16)).flatten());
                "fields repeated"
            }
            _ => {
                let value = [f64::NAN, f64::INFINITY, 1e300, -1e9, 0.0][rng.below(5)].to_le_bytes();
                let end = (at + 8).min(bytes.len());
                bytes[at..end].copy_from_slice(&value[..end - at]);
                "values replaced"
            }
        };
        Mutant { bytes, kind, hostile: None }
    }
}

/// Names of the parts in which two scenes differ.
fn differences(a: &Scene, b: &Scene) -> String {
    let parts = [
        ("id", a.id == b.id),
        ("frames", a.frames == b.frames),
        ("times", a.timestamps == b.timestamps),
        ("tracks", a.tracks == b.tracks),
        ("map", a.map == b.map),
        ("lights", a.lights == b.lights),
        ("ego", a.ego == b.ego),
        ("adversary", (a.adversary, a.adversary_origin) == (b.adversary, b.adversary_origin)),
    ];
    parts.into_iter().filter(|(_, same)| !same).map(|(name, _)| name).collect::<Vec<_>>().join(", ")
        + &format!("; {:?}", b.notes)
}

/// Reads a message and, if it is a scene, writes it in every format. Panics if a written scene reads as another one.
pub fn consume_message(message: &[u8]) -> Result<(), Error> {
    let path = Path::new("mutant.tfrecord#0");
    let recording = Recording::from_bytes(path, womd::frame(message))?;
    score(&recording.scene);
    // A record without an id gets one and a note; a pickle of it has an id and no such note.
    let named = |scene: &Scene| {
        let notes = scene.notes.iter().filter(|note| note.repair() != Some(Repair::NoId)).cloned().collect();
        Scene { notes, ..scene.clone() }
    };
    let same = |path: &str, bytes: Vec<u8>| -> Result<(), Error> {
        let again = named(&Recording::from_bytes(Path::new(path), bytes)?.scene);
        let expected = named(&recording.scene);
        assert!(again == expected, "the scene differs as `{path}` in {}", differences(&again, &expected));
        Ok(())
    };
    same("mutant.pkl", recording.to_pickle()?)?;
    same("mutant.safetensors", recording.to_native()?)?;
    let encoded = recording.to_scenario()?;
    let again = Recording::from_bytes(path, womd::frame(&encoded.data)).expect("a written record is read");
    // Without notes, nothing is lost. What was mended needs no mending again, so the scenes differ in their own notes.
    let without_notes = |scene: &Scene| Scene { notes: Vec::new(), ..scene.clone() };
    assert!(
        without_notes(&again.scene) == without_notes(&recording.scene) || !encoded.notes.is_empty(),
        "the scene differs as a record: {}",
        differences(&again.scene, &recording.scene)
    );
    Ok(())
}
