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
    let original = decode(source, path)?;
    let refuse = |field: &str, found: &str| Error::Field {
        path: path.to_owned(),
        field: field.to_owned(),
        found: found.to_owned(),
        expected: "what the source file holds".to_owned(),
    };
    let names =
        |scene: &Scene| scene.tracks.iter().map(|t| (t.id.clone(), t.kind.clone())).collect::<Vec<_>>();
    if names(scene) != names(&original) || scene.frames != original.frames {
        return Err(refuse("tracks", "another set of tracks or frames"));
    }
    if scene.map != original.map || scene.lights != original.lights {
        return Err(refuse("map_features", "another map"));
    }
    let mut document = source.clone();
    for (changed, original) in scene.tracks.iter().zip(&original.tracks) {
        if changed != original {
            write_track(&mut document, changed, original);
        }
    }
    Ok(document)
}

/// Writes the columns in which a track differs.
fn write_track(document: &mut Document, changed: &Track, original: &Track) {
    let path = ["tracks", &changed.id];
    let state = path
        .into_iter()
        .try_fold(document.root(), |dict, key| lookup(document, dict, key))
        .and_then(|track| document.get(track, "state"));
    // The source decoded a moment ago, so it is there.
    let Some(state) = state else { return };
    // A file whose sizes were mended on reading keeps them as it has them unless they changed.
    let size_keys = ["length", "width", "height"];
    let sizes_changed = changed.size != original.size;
    type Column<'t> = (&'t str, bool, Box<dyn Fn(usize, usize) -> f64 + 't>);
    let mut columns: Vec<Column> = vec![
        ("position", changed.position != original.position, Box::new(|f, c| changed.position[f][c])),
        (
            "velocity",
            changed.velocity != original.velocity,
            Box::new(|f, c| if c < 2 { changed.velocity[f][c] } else { 0.0 }),
        ),
        ("heading", changed.heading != original.heading, Box::new(|f, _| changed.heading[f])),
        ("valid", changed.valid != original.valid, Box::new(|f, _| f64::from(u8::from(changed.valid[f])))),
    ];
    for (k, key) in size_keys.into_iter().enumerate() {
        columns.push((key, sizes_changed, Box::new(move |f, _| changed.size[f][k])));
    }
    for (key, differs, value) in columns {
        let Some(old) = document.get(state, key).filter(|_| differs) else { continue };
        let node = rewritten(document, old, changed.valid.len(), value);
        // A new value beside the old one: others may share the old.
        let new = document.push(node);
        document.set(state, key, new);
    }
}

/// A key that may be written as an int in the file.
fn lookup(document: &Document, dict: Id, key: &str) -> Option<Id> {
    let entries = document.entries(dict)?;
    entries.iter().rev().find(|(k, _)| document.identifier(*k).as_deref() == Some(key)).map(|(_, v)| *v)
}

/// The column `old` with other numbers: an array of its type and shape, or a list of floats.
fn rewritten(document: &mut Document, old: Id, frames: usize, value: impl Fn(usize, usize) -> f64) -> Node {
    match document.node(old).clone() {
        Node::Array(array) => {
            let width = if let [_, width] = array.shape[..] { width as usize } else { 1 };
            let order = |k: usize| match array.fortran && width > 1 {
                true => (k % frames, k / frames),
                false => (k / width, k % width),
            };
            let values = (0..frames * width).map(|k| {
                let (frame, column) = order(k);
                value(frame, column)
            });
            let data = array.dtype.write(values);
            let data = document.push_bytes(&data);
            Node::Array(Box::new(Array { data, ..*array }))
        }
        _ => {
            let rows: Vec<Option<usize>> = match document.items(old) {
                Some(items) => items.iter().map(|item| document.items(*item).map(<[Id]>::len)).collect(),
                None => Vec::new(),
            };
            let rows = rows.into_iter().enumerate().map(|(frame, width)| match width {
                None => document.push(Node::Float(value(frame, 0))),
                Some(width) => {
                    let cells = (0..width).map(|c| document.push(Node::Float(value(frame, c)))).collect();
                    document.push(Node::List(cells))
                }
            });
            Node::List(rows.collect())
        }
    }
}
