//! Encodes a scene, and its source's data beyond it, as tensors.

use std::{collections::HashMap, path::Path};

use safetensors::{Dtype, tensor::TensorView};
use sage_core::{
    scene::Note,
    scene::{Lane, Scene, Track},
};

use super::{
    Header, KEY, Link, VERSION,
    packed::{Packed, floats, integers},
    source,
};
use crate::{Error, Format, pickle::Document};

/// The bytes of a native file. The same scene and source give the same bytes.
///
/// *Errors*: [`Error::Field`] for what the format cannot hold; none is known for a checked scene.
pub(crate) fn encode(scene: &Scene, original: Option<&Document>, path: &Path) -> Result<Vec<u8>, Error> {
    let mut tensors = tensors(scene);
    if let Some(document) = original {
        tensors.extend(source::pack(document, scene, &tensors));
    }
    let fail = |found: String| Error::Field {
        path: path.to_owned(),
        field: KEY.to_owned(),
        found,
        expected: "a scene that safetensors can hold".to_owned(),
    };
    let header = serde_json::to_string(&header(scene)).map_err(|e| fail(e.to_string()))?;
    let tensor_views: Result<Vec<_>, _> = tensors
        .iter()
        .map(|t| TensorView::new(t.dtype, t.shape.clone(), &t.data).map(|tensor_view| (t.name, tensor_view)))
        .collect();
    let tensor_views = tensor_views.map_err(|e| fail(e.to_string()))?;
    let serialize = |header: &str| {
        let metadata = HashMap::from([(KEY.to_owned(), header.to_owned())]);
        safetensors::serialize(tensor_views.clone(), Some(metadata)).map_err(|e| fail(e.to_string()))
    };
    let bytes = serialize(&header)?;
    if Format::of(&bytes) == Some(Format::Native) {
        return Ok(bytes);
    }
    // A header of this length would make the file start like a pickle. Eight more bytes avoid that.
    serialize(&(header + &" ".repeat(PADDING)))
}

/// Alignment of safetensors headers, bytes.
const PADDING: usize = 8;

fn header(scene: &Scene) -> Header {
    let map = &scene.map;
    let lanes = map.features.iter().enumerate().filter_map(|(k, f)| {
        let lane = f.lane.as_ref()?;
        Some((k, lane.speed_limit, lane.width.len()))
    });
    Header {
        version: VERSION,
        id: scene.id.clone(),
        frames: scene.frames,
        ego: scene.ego,
        adversary: scene.adversary,
        adversary_origin: scene.adversary_origin,
        notes: scene.notes.iter().map(Note::to_string).collect(),
        tracks: scene.tracks.iter().map(|t| (t.id.clone(), t.kind.name().to_owned())).collect(),
        features: map
            .features
            .iter()
            .map(|f| (f.id.clone(), f.kind.name().to_owned(), f.points.len()))
            .collect(),
        lanes: lanes.collect(),
        lights: scene.lights.iter().map(|l| (l.lane.clone(), l.stop_point.is_some())).collect(),
    }
}

fn tensors(scene: &Scene) -> Vec<Packed> {
    let (n, frames) = (scene.tracks.len(), scene.frames);
    let per_frame = |name, width: usize, values: &dyn Fn(&Track, usize, usize) -> f64| {
        let all = scene.tracks.iter().flat_map(|track| {
            (0..frames).flat_map(move |frame| (0..width).map(move |column| values(track, frame, column)))
        });
        let shape = if width == 1 { vec![n, frames] } else { vec![n, frames, width] };
        floats(name, shape, all.collect())
    };
    let lanes = || scene.map.features.iter().filter_map(|f| f.lane.as_deref());
    let widths: Vec<f64> = lanes().flat_map(|lane| lane.width.iter().flatten().copied()).collect();
    let stops = scene.lights.iter().flat_map(|l| l.stop_point.unwrap_or_default());
    let valid = scene.tracks.iter().flat_map(|t| t.valid.iter().map(|v| u8::from(*v)));
    let states = scene.lights.iter().flat_map(|l| l.states.iter().map(|s| *s as u8));
    vec![
        per_frame("tracks.position", 3, &|t, f, c| t.position[f][c]),
        per_frame("tracks.heading", 1, &|t, f, _| t.heading[f]),
        per_frame("tracks.velocity", 2, &|t, f, c| t.velocity[f][c]),
        per_frame("tracks.length", 1, &|t, f, _| t.size[f][0]),
        per_frame("tracks.width", 1, &|t, f, _| t.size[f][1]),
        per_frame("tracks.height", 1, &|t, f, _| t.size[f][2]),
        Packed { name: "tracks.valid", dtype: Dtype::BOOL, shape: vec![n, frames], data: valid.collect() },
        floats(
            "map.points",
            vec![scene.map.points.len(), 3],
            scene.map.points.iter().flatten().copied().collect(),
        ),
        floats("lane.width", vec![widths.len() / 2, 2], widths),
        floats("lights.stop_point", vec![scene.lights.len(), 3], stops.collect()),
        floats("timestamps", vec![scene.timestamps.len()], scene.timestamps.clone()),
        integers("lane.links", 7, links(scene)),
        Packed {
            name: "lights.state",
            dtype: Dtype::U8,
            shape: vec![scene.lights.len(), frames],
            data: states.collect(),
        },
    ]
}

/// Rows of lane, relation, other feature, own range, other range.
fn links(scene: &Scene) -> Vec<i64> {
    let mut rows: Vec<i64> = Vec::new();
    let mut row = |lane: usize, link: Link, other: usize, own: [usize; 2], range: [usize; 2]| {
        rows.extend([lane as i64, link.code()]);
        rows.extend([other, own[0], own[1], range[0], range[1]].map(|x| x as i64));
    };
    for (k, feature) in scene.map.features.iter().enumerate() {
        let Some(Lane { entries, exits, neighbors, boundaries, stop_signs, .. }) = feature.lane.as_deref()
        else {
            continue;
        };
        entries.iter().for_each(|other| row(k, Link::Entry, *other, [0; 2], [0; 2]));
        exits.iter().for_each(|other| row(k, Link::Exit, *other, [0; 2], [0; 2]));
        for side in 0..2 {
            neighbors[side].iter().for_each(|n| row(k, Link::Neighbor(side), n.lane, n.own, n.other));
            boundaries[side].iter().for_each(|b| row(k, Link::Boundary(side), b.feature, b.own, [0; 2]));
        }
        stop_signs.iter().for_each(|other| row(k, Link::StopSign, *other, [0; 2], [0; 2]));
    }
    rows
}
