//! What a MetaDrive source holds beyond the scene, carried along in a native file.
//!
//! `source.pickle` is the source with its packed arrays emptied: a plain pickle, which Python reads
//! as well. `source.arrays` says where their elements are: a row an array with its place among the
//! arrays of the pickle, tensor, first element, number of axes, and lengths (unused ones 0).

use std::{collections::HashMap, path::Path};

use safetensors::Dtype;
use sage_core::scene::Scene;

use super::{
    PACKED,
    decode::Tensors,
    packed::{Packed, integers},
};
use crate::{
    Error,
    pickle::{Array, Document, ElementKind, Id, Node, Span},
};

/// Rows of `source.arrays`.
const WIDTH: usize = 6;

/// The two tensors that carry a source.
pub(super) fn pack(document: &Document, scene: &Scene, tensors: &[Packed]) -> Vec<Packed> {
    let places = places(document, scene, tensors);
    let mut emptied = document.clone();
    for id in places.keys() {
        if let Node::Array(array) = document.node(*id) {
            let empty = Array { shape: vec![0], data: Span::EMPTY, ..(**array).clone() };
            emptied.replace(*id, Node::Array(Box::new(empty)));
        }
    }
    let pickle = emptied.to_pickle();
    // The pickle's own order of arrays is what a reader of it sees.
    let Ok(read) = Document::parse(pickle.clone()) else { return Vec::new() };
    let order: HashMap<Id, usize> = arrays(&read).enumerate().map(|(place, id)| (id, place)).collect();
    let mut rows: Vec<[i64; WIDTH]> = Vec::with_capacity(places.len());
    for (ours, theirs) in paired(document, &read) {
        if let (Some((tensor, first)), Some(place), Node::Array(array)) =
            (places.get(&ours), order.get(&theirs), document.node(ours))
        {
            let length = |axis: usize| array.shape.get(axis).map_or(0, |n| i64::from(*n));
            rows.push([
                *place as i64,
                *tensor as i64,
                *first as i64,
                array.shape.len() as i64,
                length(0),
                length(1),
            ]);
        }
    }
    rows.sort_unstable();
    rows.dedup();
    vec![
        Packed { name: "source.pickle", dtype: Dtype::U8, shape: vec![pickle.len()], data: pickle },
        integers("source.arrays", WIDTH, rows.into_iter().flatten().collect()),
    ]
}

/// The source of a native file, whole again; `None` if the file has none.
///
/// *Errors*: [`Error::Pickle`] or [`Error::Field`] for a source that does not fit the tensors.
pub(crate) fn document(bytes: &[u8], path: &Path) -> Result<Option<Document>, Error> {
    let file = Tensors::open(path, bytes)?;
    let Some(pickle) = file.find("source.pickle") else { return Ok(None) };
    let parsed = Document::parse(pickle.data.to_vec());
    let mut document = parsed.map_err(|problem| Error::Pickle { path: path.to_owned(), problem })?;
    let order: Vec<Id> = arrays(&document).collect();
    let mut budget = bytes.len();
    for row in file.integers::<WIDTH>("source.arrays")? {
        let wrong =
            || file.error("source.arrays", format!("{row:?}"), "an array and its elements in a tensor");
        let [place, tensor, first, axes, ..] = row.map(|x| usize::try_from(x).unwrap_or(usize::MAX));
        let id = *order.get(place).ok_or_else(wrong)?;
        let name = PACKED.get(tensor).ok_or_else(wrong)?;
        let data = file.find(name).ok_or_else(wrong)?;
        let Node::Array(array) = document.node(id).clone() else { return Err(wrong()) };
        let shape: Option<Vec<u32>> =
            (axes <= 2).then(|| row[4..4 + axes].iter().map(|n| u32::try_from(*n).ok()).collect()).flatten();
        let shape = shape.ok_or_else(wrong)?;
        let size = usize::from(array.dtype.size);
        let count = shape.iter().try_fold(1usize, |n, length| n.checked_mul(*length as usize));
        let range = count.and_then(|count| {
            let start = first.checked_mul(size)?;
            Some(start..start.checked_add(count.checked_mul(size)?)?)
        });
        let elements = range
            .filter(|_| fits(&array, data.dtype))
            .and_then(|range| data.data.get(range))
            .ok_or_else(wrong)?;
        // Honest files take each element once.
        budget = budget.checked_sub(elements.len()).ok_or_else(wrong)?;
        let data = document.push_bytes(elements);
        document.replace(id, Node::Array(Box::new(Array { shape, data, ..*array })));
    }
    Ok(Some(document))
}

/// Arrays in the order in which the document made them.
fn arrays(document: &Document) -> impl Iterator<Item = Id> {
    document.ids().filter(|id| matches!(document.node(*id), Node::Array(_)))
}

/// Whether an array's elements have a tensor's type, bit for bit.
fn fits(array: &Array, dtype: Dtype) -> bool {
    let little = !array.dtype.big_endian || array.dtype.size == 1;
    let same = match dtype {
        Dtype::F32 => array.dtype.kind == ElementKind::Float && array.dtype.size == 4,
        Dtype::F64 => array.dtype.kind == ElementKind::Float && array.dtype.size == 8,
        Dtype::BOOL => array.dtype.kind == ElementKind::Bool,
        _ => false,
    };
    little && same && (!array.fortran || array.shape.len() < 2)
}

/// Source arrays whose bytes stand in a tensor: tensor and first element of each.
fn places(document: &Document, scene: &Scene, tensors: &[Packed]) -> HashMap<Id, (usize, usize)> {
    let mut places = HashMap::new();
    let mut place = |id: Option<Id>, name: &str, first: usize| {
        let number = PACKED.iter().position(|packed| *packed == name);
        let tensor = tensors.iter().find(|tensor| tensor.name == name);
        let (Some(id), Some(number), Some(tensor)) = (id, number, tensor) else { return };
        let Node::Array(array) = document.node(id) else { return };
        let elements = document.bytes(array.data);
        let start = first * usize::from(array.dtype.size);
        if fits(array, tensor.dtype)
            && array.shape.len() <= 2
            && tensor.data[start.min(tensor.data.len())..].starts_with(elements)
        {
            places.insert(id, (number, first));
        }
    };
    let top = document.root();
    let dict = |id: Option<Id>| id.and_then(|id| document.entries(id)).unwrap_or_default();
    let get = |id: Id, key: &str| document.get(id, key);
    for (k, (_, track)) in dict(get(top, "tracks")).iter().enumerate() {
        let Some(state) = get(*track, "state") else { continue };
        let first = k * scene.frames;
        place(get(state, "position"), "tracks.position", 3 * first);
        place(get(state, "velocity"), "tracks.velocity", 2 * first);
        for name in ["tracks.heading", "tracks.length", "tracks.width", "tracks.height", "tracks.valid"] {
            place(get(state, &name["tracks.".len()..]), name, first);
        }
    }
    let mut widths = 0;
    for ((_, value), feature) in dict(get(top, "map_features")).iter().zip(&scene.map.features) {
        for key in ["polyline", "polygon", "position"] {
            place(get(*value, key), "map.points", 3 * feature.points.start);
        }
        if let Some(lane) = &feature.lane {
            place(get(*value, "width").filter(|_| !lane.width.is_empty()), "lane.width", 2 * widths);
            widths += lane.width.len();
        }
    }
    for (k, (_, light)) in dict(get(top, "dynamic_map_states")).iter().enumerate() {
        place(get(*light, "stop_point"), "lights.stop_point", 3 * k);
    }
    place(get(top, "metadata").and_then(|metadata| get(metadata, "ts")), "timestamps", 0);
    places
}

/// Pairs of values at the same place in two documents of one structure.
fn paired(a: &Document, b: &Document) -> Vec<(Id, Id)> {
    let mut pairs = Vec::new();
    let mut seen = std::collections::HashSet::new();
    let mut open = vec![(a.root(), b.root())];
    while let Some((x, y)) = open.pop() {
        if !seen.insert(x) {
            continue;
        }
        pairs.push((x, y));
        match (a.node(x), b.node(y)) {
            (Node::List(p), Node::List(q))
            | (Node::Tuple(p), Node::Tuple(q))
            | (Node::Set(p), Node::Set(q))
            | (Node::FrozenSet(p), Node::FrozenSet(q)) => {
                open.extend(p.iter().copied().zip(q.iter().copied()))
            }
            (
                Node::Dict(p) | Node::DefaultDict { entries: p, .. },
                Node::Dict(q) | Node::DefaultDict { entries: q, .. },
            ) => {
                open.extend(p.iter().zip(q).flat_map(|(p, q)| [(p.0, q.0), (p.1, q.1)]));
            }
            _ => {}
        }
    }
    pairs
}
