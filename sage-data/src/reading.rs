//! Options of reading a scene file.

use serde::{Deserialize, Serialize};

/// How a scene file is read. The default takes a file as it is and mends what is safe to mend ([`crate::repairs`]).
///
/// Three seconds into the recording, with another car in the ego's place:
///
/// ```
/// use std::path::Path;
///
/// use sage_data::{ReadOptions, Recording};
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let other = Recording::read(file)?.scene.adversary()?.id.clone();
/// let options = ReadOptions { now: Some(30), ego_track: Some(other.clone()), ..ReadOptions::default() };
/// let scene = Recording::read_as(file, &options)?.scene;
/// // Of 91 frames 60 follow frame 30.
/// assert_eq!((scene.horizon(), &scene.ego().id), (60, &other));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReadOptions {
    /// The frame at 10 Hz that becomes *now*: the scene is the window from 10 frames before it to 80 after it.
    /// `None` keeps all frames, and *now* is 1.0 s after the first.
    pub now: Option<usize>,
    /// Also resamples recordings below 5 Hz.
    pub resample: bool,
    /// Frames per second of a file without times.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate: Option<f64>,
    /// Recomputes velocities and headings from positions.
    pub trust_positions: bool,
    /// The road user that is the ego in place of the one that the file names, by its id.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ego_track: Option<String>,
    /// Road users that are left out, by their ids; not the ego. Where one is the adversary, another is chosen.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub without: Vec<String>,
    /// Refuses a scene in which any track has an unusable value, instead of leaving that track out.
    pub strict: bool,
}

impl ReadOptions {
    /// Hash of a scene as it is read, as hexadecimal digits: of the bytes of its file, and of the road users that these options choose
    /// as the ego or leave out.
    pub fn source_hash(&self, bytes: &[u8]) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(bytes);
        if let Some(id) = &self.ego_track {
            hasher.update(b"ego ").update(id.as_bytes());
        }
        let mut without: Vec<&str> = self.without.iter().map(String::as_str).collect();
        without.sort_unstable();
        without.dedup();
        for id in without {
            hasher.update(b"without ").update(&(id.len() as u64).to_le_bytes()).update(id.as_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// What is appended to the name of a scene that is a window of its recording, such as `-now40`.
    pub fn suffix(&self) -> String {
        self.now.map_or(String::new(), |now| format!("-now{now}"))
    }
}
