//! Writes a scene into a copy of its source. Unchanged values stay as they are.

use std::path::Path;

use sage_core::scene::{Scene, Track};

use super::{complete, retimed};
use crate::{
    Error,
    pickle::{Array, Document, Id, Node},
    repairs::Decoded,
};

/// Writes a scene into the values of its file, given the scene as it was read. Returns the ids of the changed tracks.
///
/// Unchanged tracks and all other values of the file stay as they are. A changed column keeps its type and shape, so its
/// numbers are rounded to that type. A file at another frame rate keeps its frames unless a track changed, the user chose
/// a part of it, or `ten_hertz` asks for the frames of the scene.
///
/// *Errors*: [`Error::Field`] if the scene has other track ids, track kinds, frames, map or lights than the
/// file. This function cannot write such changes.
pub(crate) fn write_changes<'s>(
    document: &mut Document,
    scene: &'s Scene,
    original: &Decoded,
    ten_hertz: bool,
    path: &Path,
) -> Result<Vec<&'s str>, Error> {
    let refuse = |field: &str, found: &str| Error::Field {
        path: path.to_owned(),
        field: field.to_owned(),
        found: found.to_owned(),
        expected: "what the source file holds".to_owned(),
    };
    let names =
        |scene: &Scene| scene.tracks.iter().map(|t| (t.id.clone(), t.kind.clone())).collect::<Vec<_>>();
    let Decoded { scene: read, frames, is_chosen } = original;
    if names(scene) != names(read) || scene.frames != read.frames {
        return Err(refuse("tracks", "other tracks or another number of frames"));
    }
    let same_lights = scene.lights.len() == read.lights.len()
        && scene.lights.iter().zip(&read.lights).all(|(light, other)| light.is_same_steady(other));
    if scene.map != read.map || !same_lights {
        return Err(refuse("map_features", "another map"));
    }
    let pairs = || scene.tracks.iter().zip(&read.tracks).filter(|(changed, read)| changed != read);
    let ids: Vec<&str> = pairs().map(|(changed, _)| &changed.id[..]).collect();
    match frames {
        Some(frames) if *is_chosen || ten_hertz || !ids.is_empty() => {
            retimed(document, scene, frames);
            complete(document);
        }
        Some(_) => {}
        None => pairs().for_each(|(changed, read)| write_track(document, changed, read)),
    }
    if (scene.ego, scene.adversary) != (read.ego, read.adversary) {
        write_roles(document, scene);
    }
    Ok(ids)
}

/// Writes who the ego and the adversary are, as readers find them.
fn write_roles(document: &mut Document, scene: &Scene) {
    let root = document.root();
    let Some(metadata) = document.get(root, "metadata") else { return };
    let metadata = document.push(document.node(metadata).clone());
    let ids = [Some(scene.ego), scene.adversary].into_iter().flatten().map(|track| &scene.tracks[track].id);
    let ids: Vec<Id> = ids.map(|id| text(document, id)).collect();
    document.set(metadata, "sdc_id", ids[0]);
    let interest = document.push(Node::List(ids));
    document.set(metadata, "objects_of_interest", interest);
    document.set(root, "metadata", metadata);
}

fn text(document: &mut Document, text: &str) -> Id {
    let data = document.push_bytes(text.as_bytes());
    document.push(Node::Str(data))
}

/// Adds a text to the metadata of a file. The dict is copied first, because other values may share it.
pub(crate) fn annotate(document: &mut Document, key: &str, text: &str) {
    let root = document.root();
    let Some(metadata) = document.get(root, "metadata") else { return };
    let metadata = document.push(document.node(metadata).clone());
    let text = self::text(document, text);
    document.set(metadata, key, text);
    document.set(root, "metadata", metadata);
}

/// Writes the changed columns of a track.
fn write_track(document: &mut Document, changed: &Track, original: &Track) {
    let index = || {
        let entries = document.entries(document.get(document.root(), "tracks")?)?;
        entries.iter().rposition(|(k, _)| document.identifier(*k).as_deref() == Some(&changed.id))
    };
    // The source was decoded before, so the track exists.
    if let Some(index) = index() {
        write_columns(document, index, changed.valid.len(), changed_columns(changed, original));
    }
}

/// Writes columns of the track at an index. Its dicts are copied first, because other values may share them.
pub(super) fn write_columns(document: &mut Document, index: usize, frames: usize, columns: Columns) {
    let found = || {
        let tracks = document.get(document.root(), "tracks")?;
        let track = document.entries(tracks)?.get(index)?.1;
        Some((tracks, track, document.get(track, "state")?))
    };
    let Some((tracks, track, state)) = found() else { return };
    let state = document.push(document.node(state).clone());
    for (key, value) in columns {
        let rows = |id: &Id| match document.node(*id) {
            Node::Array(array) => array.shape.first().map_or(0, |n| *n as usize),
            _ => document.items(*id).map_or(0, <[Id]>::len),
        };
        // A number that stands for all frames stays.
        let Some(old) = document.get(state, key).filter(|id| rows(id) == frames) else { continue };
        let node = rewritten(document, old, frames, value);
        let new = document.push(node);
        document.set(state, key, new);
    }
    let track = document.push(document.node(track).clone());
    document.set(track, "state", state);
    let mut node = document.node(tracks).clone();
    if let Node::Dict(entries) | Node::DefaultDict { entries, .. } = &mut node {
        entries[index].1 = track;
    }
    document.replace(tracks, node);
}

/// New value of a column by frame and component; `None` if the scene has none and the old value stays.
type Column<'t> = Box<dyn Fn(usize, usize) -> Option<f64> + 't>;
/// Columns with their keys.
type Columns<'t> = Vec<(&'static str, Column<'t>)>;

/// Columns in which a track differs. Sizes that were corrected during reading and not changed since stay as
/// in the file.
fn changed_columns<'t>(changed: &'t Track, original: &Track) -> Columns<'t> {
    let differs = |key: &str| match key {
        "position" => changed.position != original.position,
        "velocity" => changed.velocity != original.velocity,
        "heading" => changed.heading != original.heading,
        "valid" => changed.valid != original.valid,
        _ => changed.size != original.size,
    };
    all_columns(changed).into_iter().filter(|(key, _)| differs(key)).collect()
}

/// All columns of a track, under the keys that files use.
pub(super) fn all_columns(track: &Track) -> Columns<'_> {
    let mut columns: Columns = vec![
        ("position", Box::new(|f, c| track.position[f].get(c).copied())),
        ("velocity", Box::new(|f, c| track.velocity[f].get(c).copied())),
        ("heading", Box::new(|f, _| Some(track.heading[f]))),
        ("valid", Box::new(|f, _| Some(f64::from(u8::from(track.valid[f]))))),
        ("size", Box::new(|f, c| track.size[f].get(c).copied())),
    ];
    for (k, key) in ["length", "width", "height"].into_iter().enumerate() {
        columns.push((key, Box::new(move |f, _| Some(track.size[f][k]))));
    }
    columns
}

/// The column `old` with new numbers: an array of the same type and shape, or a list of rows.
fn rewritten(document: &mut Document, old: Id, frames: usize, value: Column) -> Node {
    match document.node(old).clone() {
        Node::Array(array) => {
            let width = if let [_, width] = array.shape[..] { width as usize } else { 1 };
            let before: Vec<f64> = array.dtype.read(document.bytes(array.data)).collect();
            let values = (0..frames * width).map(|k| {
                let (frame, column) = if array.fortran && width > 1 {
                    (k % frames, k / frames)
                } else {
                    (k / width, k % width)
                };
                value(frame, column).unwrap_or(before[k])
            });
            let data = array.dtype.write(values);
            let data = document.push_bytes(&data);
            Node::Array(Box::new(Array { data, ..*array }))
        }
        node => {
            let rows: Vec<Id> = document.items(old).map(<[Id]>::to_vec).unwrap_or_default();
            let rows =
                rows.into_iter().enumerate().map(|(frame, row)| rewritten_row(document, row, frame, &value));
            let rows: Vec<Id> = rows.collect();
            if matches!(node, Node::Tuple(_)) { Node::Tuple(rows) } else { Node::List(rows) }
        }
    }
}

/// One row of a list of rows, as the same type of container.
fn rewritten_row(document: &mut Document, row: Id, frame: usize, value: &Column) -> Id {
    match document.node(row).clone() {
        Node::List(cells) => {
            let cells =
                cells.into_iter().enumerate().map(|(c, old)| cell(document, old, value(frame, c))).collect();
            document.push(Node::List(cells))
        }
        Node::Tuple(cells) => {
            let cells =
                cells.into_iter().enumerate().map(|(c, old)| cell(document, old, value(frame, c))).collect();
            document.push(Node::Tuple(cells))
        }
        Node::Array(array) => {
            let before: Vec<f64> = array.dtype.read(document.bytes(array.data)).collect();
            let after = before.iter().enumerate().map(|(c, old)| value(frame, c).unwrap_or(*old));
            let data = array.dtype.write(after);
            let data = document.push_bytes(&data);
            document.push(Node::Array(Box::new(Array { data, ..*array })))
        }
        _ => cell(document, row, value(frame, 0)),
    }
}

/// A new number, or the old value if there is none.
fn cell(document: &mut Document, old: Id, value: Option<f64>) -> Id {
    value.map_or(old, |x| document.push(Node::Float(x)))
}
