//! The JSON of GPUDrive, PufferDrive and ScenarioMax: a scene a file, converted from the Waymo Open Motion Dataset or another.
//!
//! A file becomes MetaDrive values and goes through the decoder that pickles go through. There are two dialects without a
//! version ([`Dialect`]). `docs/formats.md` says what is kept in each direction.
//!
//! | | present | old |
//! | --- | --- | --- |
//! | told by | `metadata` | no `metadata` |
//! | headings | radians | degrees |
//! | names of road users | `id` | their number in `objects`, from 0 |
//! | the ego | `metadata.sdc_track_index` | none: the user names it |
//! | absent frames | −10 000 | 0.0001 |
//! | `map_element_id` of driveways | 20 | −1 |
//!
//! - `map_element_id` gives the type of a road (`map_elements.rs`), without it `type` alone does.
//! - `tl_states` holds for each lane lists of `state` (`stop`, `arrow_go`, …), `x`, `y`, `z` and `time_index`, the frames in which
//!   the light was seen.
//! - `tracks_to_predict` beyond the objects are left out, with a note.
//! - Keys of the scene, of `metadata`, road users and roads that are not known are kept and written again; others, in points and
//!   lights, are not.
//! - The unit of headings is that of the dialect, unless the values and the motion say otherwise: beyond a turn and in degrees along
//!   the motion, or, in the old dialect, within a turn and in radians along it. Both are noted.

mod decode;
mod encode;
mod file;
mod headings;
mod keyed;
mod lights;
mod map_elements;
mod names;

pub(crate) use decode::document;
pub use encode::EncodedGpuDrive;
pub(crate) use encode::encode;

use std::path::Path;

use sage_core::files;
use serde::{Deserialize, de::IgnoredAny};

use crate::{gzip, parquet_files};

/// Name of the data set and version in MetaDrive values; a file does not say what it was converted from.
pub(crate) const DATASET: &str = "gpudrive";
/// Coordinate of a frame in which a road user is absent.
const ABSENT: f64 = -10_000.0;
/// Key of what this project adds to a file, which other readers skip.
const OWN: &str = "sage";
/// Key of MetaDrive values for what the file says besides, as JSON text by key.
const REST: &str = "gpudrive";

/// How a file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dialect {
    /// Headings in radians, ids, and `metadata` that names the ego.
    Present,
    /// Headings in degrees, and neither ids nor `metadata`: road users are named by their number in the file, from 0.
    Old,
}

/// Id of the adversary of an attack, by its provenance.
pub(crate) fn attacker(provenance: &str) -> Option<String> {
    let facts: serde_json::Value = serde_json::from_str(provenance).ok()?;
    Some(facts.get("adversary")?.as_str()?.to_owned())
}

/// Bytes of the start of a file that are looked at.
const LOOK: usize = 1 << 16;

/// True if a file is named like one that is compressed.
pub(crate) fn is_compressed_name(path: &Path) -> bool {
    path.file_name().unwrap_or_default().to_string_lossy().ends_with(".json.gz")
}

/// True if a file has the ending of a scene.
fn is_named(path: &Path) -> bool {
    is_compressed_name(path) || path.extension().is_some_and(|ending| ending == "json")
}

/// True if a file with the ending of a scene, which does not begin like one, is no other JSON either: it is empty, cut or
/// overwritten, or what it is stands far behind its start. Left out of a folder without a word, a scene would be missing.
pub(crate) fn is_damaged(path: &Path) -> bool {
    // Scenarios of Argoverse 2 have a map each, which their reader checks.
    if !is_named(path) || parquet_files::is_map_name(path) {
        return false;
    }
    // Other files of JSON are short. Rows are not, and there may be very many.
    if files::read_start(path, ROW.len() as u64).is_ok_and(|start| start == ROW) {
        return false;
    }
    let Ok(bytes) = files::read(path, MOST_OTHER) else { return true };
    let bytes = if gzip::is_gzip(&bytes) { gzip::inflate(&bytes, MOST_OTHER) } else { Ok(bytes) };
    let Ok(bytes) = bytes else { return true };
    let body = bytes.strip_prefix(BOM).unwrap_or(&bytes);
    match serde_json::from_slice::<SceneKeys>(body) {
        Ok(keys) => keys.objects.is_some() || keys.roads.is_some(),
        // A list or a number.
        Err(_) => serde_json::from_slice::<IgnoredAny>(body).is_err(),
    }
}

/// The mark of a text in UTF-8.
const BOM: &[u8] = b"\xef\xbb\xbf";
/// How a row of this project begins.
const ROW: &[u8] = b"{\"run_hash\"";
/// Longest file that is read to see whether it is other JSON, bytes.
const MOST_OTHER: u64 = 1 << 24;

/// Keys of a scene.
#[derive(Deserialize)]
struct SceneKeys {
    objects: Option<IgnoredAny>,
    roads: Option<IgnoredAny>,
}

/// True if a file is a scene of GPUDrive, by its ending and its first bytes: many files of JSON are none.
pub(crate) fn is_scene_file(path: &Path) -> bool {
    if !is_named(path) {
        return false;
    }
    let start = files::read_start(path, LOOK as u64).unwrap_or_default();
    begins_scene(&if gzip::is_gzip(&start) { gzip::inflated_start(&start, LOOK as u64) } else { start })
}

/// True if a file begins like a scene of GPUDrive: an object with road users or roads.
pub(crate) fn begins_scene(bytes: &[u8]) -> bool {
    let body = bytes.strip_prefix(BOM).unwrap_or(bytes).trim_ascii_start();
    let body = &body[..body.len().min(LOOK)];
    let has = |key: &[u8]| body.windows(key.len()).any(|window| window == key);
    // A native file has zeros among its first bytes.
    body.starts_with(b"{")
        && !bytes[..bytes.len().min(9)].contains(&0)
        && (has(b"\"objects\"") && has(b"\"position\"") || has(b"\"roads\"") && has(b"\"geometry\""))
}
