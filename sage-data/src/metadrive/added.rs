//! Road users who are added to a recording: standing, in the values of a file.

use sage_core::{motion::NOW, scene::Track};
use serde_json::Value;

use super::complete;
use crate::pickle::{Array, Document, Dtype, ElementKind, Id, Node};

/// Field of the provenance that lists road users who were added to a recording.
pub const ADDED: &str = "added";

/// Ids of the road users that were added to a scene, by its provenance.
pub fn added_tracks(provenance: &str) -> Vec<String> {
    let value: Option<Value> = serde_json::from_str(provenance).ok();
    let ids = value.as_ref().and_then(|value| value.get(ADDED)?.as_array());
    ids.into_iter().flatten().filter_map(|id| id.as_str().map(str::to_owned)).collect()
}

const F64: Dtype = Dtype { kind: ElementKind::Float, size: 8, big_endian: false };
const BOOL: Dtype = Dtype { kind: ElementKind::Bool, size: 1, big_endian: false };

/// Adds tracks that stand where they are *now* at every frame of the file, whatever its rate. What shares the dict of the tracks with
/// other values stays as it is.
pub(crate) fn add_standing(document: &mut Document, tracks: &[Track]) {
    let root = document.root();
    let length = document.get(root, "length").and_then(|length| document.integer(length));
    let frames = length.and_then(|length| usize::try_from(length).ok()).unwrap_or(0);
    let Some(old) = document.get(root, "tracks") else { return };
    let mut entries = document.entries(old).unwrap_or_default().to_vec();
    for track in tracks {
        let value = standing(document, track, frames);
        entries.push((document.new_text(&track.id), value));
    }
    let tracks = document.push(Node::Dict(entries));
    document.set(root, "tracks", tracks);
    complete(document);
}

fn standing(document: &mut Document, track: &Track, frames: usize) -> Id {
    let mut column = |dtype: Dtype, row: &[f64]| {
        let data = document.push_bytes(&dtype.write((0..frames).flat_map(|_| row.iter().copied())));
        let mut shape = vec![frames as u32];
        if row.len() > 1 {
            shape.push(row.len() as u32);
        }
        document.push(Node::Array(Box::new(Array { dtype, shape, fortran: false, from_buffer: false, data })))
    };
    let [length, width, height] = track.size[NOW];
    let columns = [
        ("position", column(F64, &track.position[NOW])),
        ("length", column(F64, &[length])),
        ("width", column(F64, &[width])),
        ("height", column(F64, &[height])),
        ("heading", column(F64, &[track.heading[NOW]])),
        ("velocity", column(F64, &[0.0, 0.0])),
        ("valid", column(BOOL, &[1.0])),
    ];
    let state = document.new_dict(columns);
    let (kind, id) = (document.new_text(track.kind.name()), document.new_text(&track.id));
    let length = document.new_int(frames);
    let added = document.push(Node::Bool(true));
    let metadata = document.new_dict([
        ("track_length", length),
        ("type", kind),
        ("object_id", id),
        // Beside the provenance of the file, which says by what.
        ("added", added),
    ]);
    document.new_dict([("type", kind), ("state", state), ("metadata", metadata)])
}
