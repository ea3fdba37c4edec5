//! The columns of a track in the values of a file.

use sage_core::scene::Track;

use crate::pickle::{Array, Document, Id, Node};

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
pub(super) type Columns<'t> = Vec<(&'static str, Column<'t>)>;

/// Columns in which a track differs. Sizes that were corrected during reading and not changed since stay as
/// in the file.
pub(super) fn changed_columns<'t>(changed: &'t Track, original: &Track) -> Columns<'t> {
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
