//! A scene written over the file it came from: what was not changed stays as it was.

use std::path::Path;

use sage_core::scene::{Scene, Track};

use super::decode;
use crate::{
    Error,
    pickle::{Array, Document, Id, Node},
};

/// The values of a file with the scene's tracks in place of its own. Tracks that are as the file
/// has them, and all else in the file, are kept value by value; a changed column keeps its type
/// and shape, so its numbers are rounded to that type.
///
/// *Errors*: [`Error::Field`] if the scene does not have the file's tracks, frames, map and
/// lights: those cannot be changed by writing over a source.
pub fn encode(scene: &Scene, source: &Document, path: &Path) -> Result<Document, Error> {
    let mut document = source.clone();
    let original = decode(source, path)?;
    write_changes(&mut document, scene, &original, path)?;
    Ok(document)
}

/// Writes the tracks of a scene that differ from the scene as it was read; their ids.
///
/// *Errors*: as [`encode`].
pub(crate) fn write_changes<'s>(
    document: &mut Document,
    scene: &'s Scene,
    original: &Scene,
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
    if names(scene) != names(original) || scene.frames != original.frames {
        return Err(refuse("tracks", "another set of tracks or frames"));
    }
    if scene.map != original.map || scene.lights != original.lights {
        return Err(refuse("map_features", "another map"));
    }
    let mut ids = Vec::new();
    for (changed, original) in scene.tracks.iter().zip(&original.tracks) {
        if changed != original {
            write_track(document, changed, original);
            ids.push(&changed.id[..]);
        }
    }
    Ok(ids)
}

/// Puts a text into a file's metadata, in a copy of it: others may share the dict.
pub(crate) fn annotate(document: &mut Document, key: &str, text: &str) {
    let root = document.root();
    let Some(metadata) = document.get(root, "metadata") else { return };
    let metadata = document.push(document.node(metadata).clone());
    let data = document.push_bytes(text.as_bytes());
    let text = document.push(Node::Str(data));
    document.set(metadata, key, text);
    document.set(root, "metadata", metadata);
}

/// Writes the columns in which a track differs, into copies of its dicts: others may share them.
fn write_track(document: &mut Document, changed: &Track, original: &Track) {
    let found = || {
        let tracks = document.get(document.root(), "tracks")?;
        let entries = document.entries(tracks)?;
        let place =
            entries.iter().rposition(|(k, _)| document.identifier(*k).as_deref() == Some(&changed.id))?;
        let track = entries[place].1;
        Some((tracks, place, track, document.get(track, "state")?))
    };
    // The source decoded a moment ago, so it is there.
    let Some((tracks, place, track, state)) = found() else { return };
    let state = document.push(document.node(state).clone());
    for (key, value) in changed_columns(changed, original) {
        let Some(old) = document.get(state, key).filter(|id| !matches!(document.node(*id), Node::None))
        else {
            continue;
        };
        let node = rewritten(document, old, changed.valid.len(), value);
        let new = document.push(node);
        document.set(state, key, new);
    }
    let track = document.push(document.node(track).clone());
    document.set(track, "state", state);
    let mut node = document.node(tracks).clone();
    if let Node::Dict(entries) | Node::DefaultDict { entries, .. } = &mut node {
        entries[place].1 = track;
    }
    document.replace(tracks, node);
}

/// A column's values by frame and component; `None` where the scene has none and the file's stay.
type Column<'t> = Box<dyn Fn(usize, usize) -> Option<f64> + 't>;

/// Columns in which a track differs. Sizes that were mended on reading and not changed since stay
/// as the file has them.
fn changed_columns<'t>(changed: &'t Track, original: &Track) -> Vec<(&'static str, Column<'t>)> {
    let mut columns: Vec<(&'static str, Column<'t>)> = Vec::new();
    if changed.position != original.position {
        columns.push(("position", Box::new(|f, c| changed.position[f].get(c).copied())));
    }
    if changed.velocity != original.velocity {
        columns.push(("velocity", Box::new(|f, c| changed.velocity[f].get(c).copied())));
    }
    if changed.heading != original.heading {
        columns.push(("heading", Box::new(|f, _| Some(changed.heading[f]))));
    }
    if changed.valid != original.valid {
        columns.push(("valid", Box::new(|f, _| Some(f64::from(u8::from(changed.valid[f]))))));
    }
    if changed.size != original.size {
        for (k, key) in ["length", "width", "height"].into_iter().enumerate() {
            columns.push((key, Box::new(move |f, _| Some(changed.size[f][k]))));
        }
    }
    columns
}

/// The column `old` with other numbers: an array of its type and shape, or a list of rows.
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

/// One row of a list of rows, of the sort that it was.
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

/// A single number, or the old one where there is none.
fn cell(document: &mut Document, old: Id, value: Option<f64>) -> Id {
    value.map_or(old, |x| document.push(Node::Float(x)))
}
