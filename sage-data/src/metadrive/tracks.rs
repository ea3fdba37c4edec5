//! Tracks of a file.
//!
//! A track with an unusable value is left out and noted; the file keeps it. The ego and the adversary that the file
//! names must be whole. What a frame holds that is not valid is never used: a number there that is not finite counts
//! as 0.

use std::collections::{BTreeMap, HashSet};

use sage_core::{
    motion::{MAX_COORDINATE, check_path},
    scene::Note,
    scene::{Track, TrackKind},
};

use super::fields::{Field, Fields};
use crate::{
    Error,
    pickle::{Id, Node},
    repairs::{
        Repair,
        sizes::{default_size, size_of_type},
    },
};

/// Number of left-out tracks that a note each names; the rest are counted.
const NAMED: usize = 5;

/// The tracks that must be whole.
pub(super) enum Whole {
    /// All of them.
    All,
    /// Those with these ids.
    Only(Vec<String>),
}

impl Whole {
    fn holds(&self, id: &str) -> bool {
        match self {
            Self::All => true,
            Self::Only(ids) => ids.iter().any(|known| known == id),
        }
    }
}

/// Reads the tracks of a file, and notes what was mended or left out.
pub(super) fn tracks(
    fields: &Fields,
    top: Id,
    frames: usize,
    whole: &Whole,
    notes: &mut Vec<Note>,
) -> Result<Vec<Track>, Error> {
    let field = Field::ROOT.key("tracks");
    let id = fields.required(top, &Field::ROOT, "tracks", "a dict of tracks")?;
    let entries = fields.entries(id, &field)?;
    let mut known_ids = HashSet::with_capacity(entries.len());
    let mut tracks = Vec::with_capacity(entries.len());
    let mut left_out: Vec<Note> = Vec::new();
    let mut without_size: BTreeMap<String, usize> = BTreeMap::new();
    for (key, value) in entries {
        let name = fields.identifier(*key, &field)?;
        let field = field.key(&name);
        if !known_ids.insert(name.clone()) {
            return Err(fields.error(&field, "an id that occurs twice", "one track per id"));
        }
        match track(fields, *value, &field, name.clone(), frames) {
            Ok((mut track, without)) => {
                if swap_sizes(&mut track) {
                    notes.push(Note::swapped_sizes(&name));
                }
                if let Some(kind) = without {
                    *without_size.entry(kind).or_default() += 1;
                }
                tracks.push(track);
            }
            Err(Error::Field { field: found_at, found, expected, .. })
                if !whole.holds(&name) && !fields.is_used_up() =>
            {
                let at = found_at.strip_prefix(&format!("{field}/")).unwrap_or(&found_at).to_owned();
                let why = format!("`{at}` is {found}; expected {expected}");
                left_out.push(Note::track_left_out(&name, &why));
            }
            Err(error) => return Err(error),
        }
    }
    let more = left_out.len().saturating_sub(NAMED);
    notes.extend(left_out.into_iter().take(NAMED));
    if more > 0 {
        let text = format!("{more} more tracks are left out, because a value of theirs is unusable");
        notes.push(Repair::TrackLeftOut.note(text));
    }
    for (kind, count) in without_size {
        let [length, width, height] = size_of_type(&kind);
        let tracks = if count == 1 { "1 track" } else { &format!("{count} tracks") };
        let text =
            format!("{tracks} of type {kind} without a size: {length} × {width} × {height} m is assumed");
        notes.push(Repair::NoSize.note(text));
    }
    Ok(tracks)
}

/// A track, and its type if the file gives no size.
fn track(
    fields: &Fields,
    id: Id,
    field: &Field,
    name: String,
    frames: usize,
) -> Result<(Track, Option<String>), Error> {
    let kind = fields.required(id, field, "type", "VEHICLE, PEDESTRIAN, CYCLIST, …")?;
    let word = match fields.document.node(kind) {
        Node::None => TrackKind::UNSET,
        _ => fields.word(kind, &field.key("type"))?,
    };
    let kind = TrackKind::from_name(word);
    // A bus is a vehicle of another size.
    let own = if size_of_type(word) == default_size(&kind) { kind.name() } else { word };
    let state = fields.required(id, field, "state", "a dict of columns")?;
    let field = &field.key("state");
    let get = |key: &str, expected: &str| fields.required(state, field, key, expected);
    let valid = fields.column(get("valid", "one number per frame")?, &field.key("valid"), frames)?;
    let valid: Vec<bool> = valid.into_iter().map(|x| x != 0.0).collect();
    let position = get("position", "(x, y, z) per frame")?;
    let position = fields.valid_table::<3>(position, &field.key("position"), &[3, 2], &valid)?;
    let valid_points = (0..frames).filter(|f| valid[*f]).map(|f| (f, [position[f][0], position[f][1]]));
    check_path(valid_points).map_err(|problem| {
        let field = field.key("position");
        fields.error(&field.key(&problem.frame().to_string()), problem.found(), problem.expected())
    })?;
    let velocity = get("velocity", "(vx, vy) per frame")?;
    let velocity = fields.valid_table::<2>(velocity, &field.key("velocity"), &[2, 3], &valid)?;
    let heading = get("heading", "one number per frame")?;
    let heading = fields.valid_column(heading, &field.key("heading"), &valid)?;
    let (size, has_size) = sizes(fields, state, field, own, &valid)?;
    for (axis, key) in ["length", "width", "height"].into_iter().enumerate() {
        // A height of 0 is how files write that it is not known.
        let is_wrong = |x: f64| if axis == 2 { x < 0.0 } else { x <= 0.0 };
        if let Some(frame) = (0..frames).find(|&f| valid[f] && is_wrong(size[f][axis])) {
            let field = field.key(key);
            let index = frame.to_string();
            return Err(fields.error(
                &field.key(&index),
                size[frame][axis].to_string(),
                "metres above 0 where the track is valid",
            ));
        }
    }
    let without = (!has_size).then(|| own.to_owned());
    Ok((Track { id: name, kind, position, heading, velocity, size, valid }, without))
}

/// Length, width and height per frame: from a column each, from one column `size`, or from a number each. Without any,
/// the default of the kind; then the second value is false.
fn sizes(
    fields: &Fields,
    state: Id,
    field: &Field,
    kind: &str,
    valid: &[bool],
) -> Result<(Vec<[f64; 3]>, bool), Error> {
    let [length, width, height] = ["length", "width", "height"].map(|key| fields.optional(state, key));
    if length.is_none() && width.is_none() {
        if let Some(size) = fields.optional(state, "size") {
            let field = field.key("size");
            let rows = match constant_row(fields, size) {
                Some(row) => {
                    fields.check_number(&field, &row)?;
                    fields.spend(&field, size_of::<[f64; 3]>() * valid.len())?;
                    vec![row; valid.len()]
                }
                None => fields.valid_table::<3>(size, &field, &[3, 2], valid)?,
            };
            return Ok((rows, true));
        }
        fields.spend(field, size_of::<[f64; 3]>() * valid.len())?;
        return Ok((vec![size_of_type(kind); valid.len()], false));
    }
    let column = |key: &str, id: Option<Id>| -> Result<Vec<f64>, Error> {
        let field = field.key(key);
        let id = id.ok_or_else(|| fields.error(&field, "missing", "one number per frame"))?;
        match constant(fields, id) {
            Some(x) => {
                fields.check_number(&field, &[x])?;
                fields.spend(&field, size_of::<f64>() * valid.len())?;
                Ok(vec![x; valid.len()])
            }
            None => fields.valid_column(id, &field, valid),
        }
    };
    let (length, width) = (column("length", length)?, column("width", width)?);
    let height = match height {
        Some(height) => column("height", Some(height))?,
        None => vec![0.0; valid.len()],
    };
    Ok(((0..valid.len()).map(|f| [length[f], width[f], height[f]]).collect(), true))
}

/// A single number for all frames.
fn constant(fields: &Fields, id: Id) -> Option<f64> {
    match fields.document.node(id) {
        Node::Array(array) if array.shape.is_empty() => {
            array.dtype.read(fields.document.bytes(array.data)).next()
        }
        _ => fields.document.number(id),
    }
}

/// One size for all frames: two or three numbers.
fn constant_row(fields: &Fields, id: Id) -> Option<[f64; 3]> {
    let mut row = [0.0; 3];
    match fields.document.node(id) {
        Node::List(items) | Node::Tuple(items) if matches!(items.len(), 2 | 3) => {
            for (slot, item) in row.iter_mut().zip(items) {
                *slot = fields.document.number(*item)?;
            }
        }
        Node::Array(array) if matches!(array.shape[..], [2 | 3]) => {
            let numbers = array.dtype.read(fields.document.bytes(array.data));
            row.iter_mut().zip(numbers).for_each(|(slot, x)| *slot = x);
        }
        _ => return None,
    }
    row.iter().all(|x| x.abs() <= MAX_COORDINATE).then_some(row)
}

/// Swaps length and width of a vehicle back if the file has swapped them: in every valid frame the vehicle is
/// shorter than any car, wider than half a lane, and wider than long.
fn swap_sizes(track: &mut Track) -> bool {
    let valid = || track.size.iter().zip(&track.valid).filter(|(_, valid)| **valid).map(|(size, _)| size);
    let swapped = track.kind == TrackKind::Vehicle
        && valid().next().is_some()
        && valid().all(|[length, width, _]| *width > 1.5 * length && *length < 2.6 && *width > 3.0);
    if swapped {
        track.size.iter_mut().for_each(|size| size.swap(0, 1));
    }
    swapped
}
