//! The data of a MetaDrive source that the scene does not contain, stored in a native file.
//!
//! `source.pickle` is a pickle of the source, which Python can read. Its packed arrays are empty.
//! `source.arrays` has one row per packed array, which locates its elements: index among the arrays of the
//! pickle, tensor, first element, number of axes, and lengths (unused ones are 0).

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
    metadrive::entries_of_features,
    pickle::{Array, Document, ElementKind, Id, Node},
};

/// Length of a row of `source.arrays`.
const WIDTH: usize = 6;

/// The two tensors that store a source.
pub(super) fn pack(document: &Document, scene: &Scene, tensors: &[Packed]) -> Vec<Packed> {
    let packed = packed_arrays(document, scene, tensors);
    // The index of an array counts the arrays of the pickle.
    let (pickle, order) = document.to_pickle_without(|id| packed.contains_key(&id));
    let mut rows: Vec<[i64; WIDTH]> = Vec::with_capacity(packed.len());
    for (index, id) in order.iter().enumerate() {
        if let (Some((tensor, first)), Node::Array(array)) = (packed.get(id), document.node(*id)) {
            let length = |axis: usize| array.shape.get(axis).map_or(0, |n| i64::from(*n));
            rows.push([
                index as i64,
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

/// The complete source of a native file; `None` if the file has none.
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
        let [index, tensor, first, axes, ..] = row.map(|x| usize::try_from(x).unwrap_or(usize::MAX));
        let id = *order.get(index).ok_or_else(wrong)?;
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
        // Regular files use each element once.
        budget = budget.checked_sub(elements.len()).ok_or_else(wrong)?;
        let data = document.push_bytes(elements);
        document.replace(id, Node::Array(Box::new(Array { shape, data, ..*array })));
    }
    Ok(Some(document))
}

/// Arrays in the order of their creation in the document.
fn arrays(document: &Document) -> impl Iterator<Item = Id> {
    document.ids().filter(|id| matches!(document.node(*id), Node::Array(_)))
}

/// True if the elements of an array have the type and byte order of a tensor.
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

/// Source arrays whose bytes are part of a tensor: tensor and first element of each.
fn packed_arrays(document: &Document, scene: &Scene, tensors: &[Packed]) -> HashMap<Id, (usize, usize)> {
    let mut arrays = HashMap::new();
    let mut add_array = |id: Option<Id>, name: &str, first: usize| {
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
            arrays.insert(id, (number, first));
        }
    };
    let top = document.root();
    let dict = |id: Option<Id>| id.and_then(|id| document.entries(id)).unwrap_or_default();
    let get = |id: Id, key: &str| document.get(id, key);
    for (k, (_, track)) in dict(get(top, "tracks")).iter().enumerate() {
        let Some(state) = get(*track, "state") else { continue };
        let first = k * scene.frames;
        add_array(get(state, "position"), "tracks.position", 3 * first);
        add_array(get(state, "velocity"), "tracks.velocity", 2 * first);
        for name in ["tracks.heading", "tracks.length", "tracks.width", "tracks.height", "tracks.valid"] {
            add_array(get(state, &name["tracks.".len()..]), name, first);
        }
    }
    let mut widths = 0;
    let entries = entries_of_features(document, &scene.map);
    for (value, feature) in entries.into_iter().zip(&scene.map.features) {
        let get = |key: &str| value.and_then(|value| get(value, key));
        for key in ["polyline", "polygon", "position"] {
            add_array(get(key), "map.points", 3 * feature.points.start);
        }
        if let Some(lane) = &feature.lane {
            add_array(get("width").filter(|_| !lane.width.is_empty()), "lane.width", 2 * widths);
            widths += lane.width.len();
        }
    }
    for (k, (_, light)) in dict(get(top, "dynamic_map_states")).iter().enumerate() {
        add_array(get(*light, "stop_point"), "lights.stop_point", 3 * k);
    }
    add_array(get(top, "metadata").and_then(|metadata| get(metadata, "ts")), "timestamps", 0);
    arrays
}
