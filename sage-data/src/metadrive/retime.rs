//! The values of a file with other frames: those of a scene that was resampled or cut.

use std::collections::{HashMap, HashSet};

use sage_core::{
    motion::{DT, NOW},
    scene::Scene,
};

use super::columns::{all_columns, write_columns};
use crate::pickle::{Array, Document, Dtype, ElementKind, Id, Node};

const F64: Dtype = Dtype { kind: ElementKind::Float, size: 8, big_endian: false };

/// Gives a document the frames of a scene. `frames` has the old frame nearest to each new one: columns that the scene
/// does not model take the values of that frame. Tracks that the scene left out go: at other frames their unusable values
/// might not show.
pub(crate) fn retimed(document: &mut Document, scene: &Scene, frames: &[usize]) {
    let root = document.root();
    let old = document.get(root, "length").and_then(|id| document.integer(id)).unwrap_or_default();
    let old = usize::try_from(old).unwrap_or_default();
    let length = document.push(Node::Int(frames.len() as i64));
    let ids: HashSet<&str> = scene.tracks.iter().map(|track| &track.id[..]).collect();
    for group in ["tracks", "dynamic_map_states"] {
        let Some(objects) = document.get(root, group) else { continue };
        let mut node = document.node(objects).clone();
        if let Node::Dict(entries) | Node::DefaultDict { entries, .. } = &mut node {
            if group == "tracks" {
                entries.retain(|(key, _)| document.identifier(*key).is_some_and(|id| ids.contains(&id[..])));
            }
            for (_, object) in entries {
                *object = retimed_object(document, *object, old, frames, length);
            }
        }
        let objects = document.push(node);
        document.set(root, group, objects);
    }
    document.set(root, "length", length);
    if let Some(metadata) = document.get(root, "metadata") {
        let metadata = document.shallow_copy(metadata);
        write_metadata(document, metadata, scene, frames, length);
        document.set(root, "metadata", metadata);
    }
    let tracks: HashMap<&str, _> = scene.tracks.iter().map(|track| (&track.id[..], track)).collect();
    let Some(objects) = document.get(root, "tracks") else { return };
    for (index, (key, _)) in document.entries(objects).unwrap_or_default().to_vec().into_iter().enumerate() {
        let track = document.identifier(key).and_then(|id| tracks.get(&id[..]).copied());
        if let Some(track) = track {
            write_columns(document, index, frames.len(), all_columns(track));
        }
    }
}

/// A track or light with the rows of the nearest frames.
fn retimed_object(document: &mut Document, object: Id, old: usize, frames: &[usize], length: Id) -> Id {
    let object = document.shallow_copy(object);
    if let Some(state) = document.get(object, "state") {
        let mut node = document.node(state).clone();
        if let Node::Dict(entries) | Node::DefaultDict { entries, .. } = &mut node {
            for (_, column) in entries {
                *column = gathered(document, *column, old, frames);
            }
        }
        let state = document.push(node);
        document.set(object, "state", state);
    }
    if let Some(metadata) = document.get(object, "metadata")
        && document.get(metadata, "track_length").is_some()
    {
        let metadata = document.shallow_copy(metadata);
        document.set(metadata, "track_length", length);
        document.set(object, "metadata", metadata);
    }
    object
}

fn write_metadata(document: &mut Document, metadata: Id, scene: &Scene, frames: &[usize], length: Id) {
    if let Some(times) = document.get(metadata, "ts") {
        let count = frames.len();
        let even = || (0..count).map(|frame| DT * frame as f64).collect();
        let new: Vec<f64> = if scene.timestamps.len() == count { scene.timestamps.clone() } else { even() };
        let new = match document.node(times).clone() {
            Node::Array(array) => {
                // Whole numbers, such as microseconds, cannot hold seconds.
                let dtype = if array.dtype.kind == ElementKind::Float { array.dtype } else { F64 };
                let data = document.push_bytes(&dtype.write(new.into_iter()));
                let shape = vec![count as u32];
                document.push(Node::Array(Box::new(Array { dtype, shape, fortran: false, data, ..*array })))
            }
            _ => {
                let items = new.into_iter().map(|time| document.push(Node::Float(time))).collect();
                document.push(Node::List(items))
            }
        };
        document.set(metadata, "ts", new);
    }
    if document.get(metadata, "track_length").is_some() {
        document.set(metadata, "track_length", length);
    }
    if document.get(metadata, "current_time_index").is_some() {
        let now = document.push(Node::Int(NOW as i64));
        document.set(metadata, "current_time_index", now);
    }
    if let Some(rate) = document.get(metadata, "sample_rate").and_then(|rate| document.number(rate)) {
        // Some writers store a rate, others a period.
        let rate = document.push(Node::Float(if rate < 2.0 { 0.1 } else { 10.0 }));
        document.set(metadata, "sample_rate", rate);
    }
}

/// A column with the rows of some frames; any other value as it is.
fn gathered(document: &mut Document, column: Id, old: usize, frames: &[usize]) -> Id {
    match document.node(column).clone() {
        Node::Array(array) if array.shape.first() == Some(&(old as u32)) => {
            let width: usize = array.shape[1..].iter().map(|n| *n as usize).product();
            let size = usize::from(array.dtype.size);
            let bytes = document.bytes(array.data);
            let mut data = Vec::with_capacity(frames.len() * width * size);
            for frame in frames {
                if array.fortran && width > 1 {
                    for k in 0..width {
                        data.extend_from_slice(&bytes[(k * old + frame) * size..][..size]);
                    }
                } else {
                    data.extend_from_slice(&bytes[frame * width * size..][..width * size]);
                }
            }
            let data = document.push_bytes(&data);
            let mut shape = array.shape.clone();
            shape[0] = frames.len() as u32;
            document.push(Node::Array(Box::new(Array { shape, data, fortran: false, ..*array })))
        }
        Node::List(items) if items.len() == old => {
            document.push(Node::List(frames.iter().map(|frame| items[*frame]).collect()))
        }
        Node::Tuple(items) if items.len() == old => {
            document.push(Node::Tuple(frames.iter().map(|frame| items[*frame]).collect()))
        }
        _ => column,
    }
}
