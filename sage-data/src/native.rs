//! Native scene files: safetensors.
//!
//! A scene is a few packed tensors and a JSON header with the names. Reading it means one read of the file, slices and checks.
//! The data of a MetaDrive source beyond the scene is stored as a pickle whose large arrays refer to the tensors, so that
//! converting back loses nothing; reading a scene does not touch it. `docs/formats.md` describes the format.

mod decode;
mod encode;
mod packed;
mod source;

pub(crate) use decode::decode;
pub(crate) use encode::encode;
pub(crate) use source::document;

use sage_core::scene::AdversaryOrigin;
use serde::{Deserialize, Serialize};

/// Key of the header in the file's metadata.
const KEY: &str = "sage-scene";
/// Version of the format.
const VERSION: u32 = 1;

/// Tensors that packed source arrays can refer to, by index.
const PACKED: [&str; 12] = [
    "tracks.position",
    "tracks.heading",
    "tracks.velocity",
    "tracks.length",
    "tracks.width",
    "tracks.height",
    "tracks.valid",
    "map.points",
    "lane.width",
    "lights.stop_point",
    "timestamps",
    "lane.links",
];

/// All content that is not numeric.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    version: u32,
    id: String,
    frames: usize,
    ego: usize,
    adversary: Option<usize>,
    adversary_origin: AdversaryOrigin,
    notes: Vec<String>,
    /// Id and kind of each track.
    tracks: Vec<(String, String)>,
    /// Id, kind and number of points of each map feature.
    features: Vec<(String, String, usize)>,
    /// Feature, speed limit (m/s) and number of widths of each lane.
    lanes: Vec<(usize, Option<f64>, usize)>,
    /// Lane, and whether the stop point is known, of each light.
    lights: Vec<(String, bool)>,
}

/// Relation of a lane to another feature: the second column of `lane.links`.
#[derive(Clone, Copy, PartialEq)]
enum Link {
    Entry,
    Exit,
    Neighbor(usize),
    Boundary(usize),
    StopSign,
}

impl Link {
    fn code(self) -> i64 {
        match self {
            Self::Entry => 0,
            Self::Exit => 1,
            Self::Neighbor(side) => 2 + side as i64,
            Self::Boundary(side) => 4 + side as i64,
            Self::StopSign => 6,
        }
    }

    fn from_code(code: i64) -> Option<Self> {
        Some(match code {
            0 => Self::Entry,
            1 => Self::Exit,
            2 | 3 => Self::Neighbor((code - 2) as usize),
            4 | 5 => Self::Boundary((code - 4) as usize),
            6 => Self::StopSign,
            _ => return None,
        })
    }
}
