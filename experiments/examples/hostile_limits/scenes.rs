//! Crafted scenes: valid to look at, and built to be slow, large or far.

use std::{f64::consts::TAU, sync::Arc};

use sage_core::{
    scene::{Lane, Map, MapFeature, MapKind, Scene, Track},
    seed::Rng,
};
use sage_data::Recording;

/// Number of kinds of crafted scenes.
pub const CRAFTED: usize = 16;

/// A crafted scene, from the shipped one. Its file has less than 1 MB.
pub fn crafted(base: &Scene, which: usize, rng: &mut Rng) -> Scene {
    let mut scene = base.clone();
    let far = 10f64.powf(rng.uniform(2.0, 7.9));
    match which {
        0 => moved(&mut scene, far),
        1 => {
            let track = rng.below(scene.tracks.len());
            let frame = rng.below(scene.frames);
            scene.tracks[track].position[frame][rng.below(2)] += far;
        }
        2 => {
            // A fast road user: each step just below the limit.
            let track = rng.below(scene.tracks.len());
            for (frame, position) in scene.tracks[track].position.iter_mut().enumerate() {
                position[0] += 98.0 * frame as f64;
            }
        }
        3 => {
            let track = rng.below(scene.tracks.len());
            let size = [far, 10f64.powf(rng.uniform(-3.0, 7.9)), 1.0];
            scene.tracks[track].size.iter_mut().for_each(|slot| *slot = size);
        }
        4 => {
            let track = rng.below(scene.tracks.len());
            scene.tracks[track].velocity.iter_mut().for_each(|v| *v = [far, -far]);
        }
        5 => {
            let track = rng.below(scene.tracks.len());
            scene.tracks[track].heading.iter_mut().enumerate().for_each(|(k, h)| *h = far * k as f64);
        }
        6 => copies(&mut scene, 40, 0.0, rng),
        7 => copies(&mut scene, 40, 30.0, rng),
        8 => lines(
            &mut scene,
            30_000,
            |k, _| [0.004 * k as f64 - 60.0, 3.0 * ((k % 2) as f64)],
            MapKind::is_edge,
        ),
        9 => lines(
            &mut scene,
            30_000,
            |_, rng| [rng.uniform(-80.0, 80.0), rng.uniform(-80.0, 80.0)],
            MapKind::is_edge,
        ),
        10 => lines(
            &mut scene,
            30_000,
            |_, rng| [rng.uniform(-80.0, 80.0), rng.uniform(-80.0, 80.0)],
            MapKind::is_lane,
        ),
        11 => short_lanes(&mut scene, 3000, rng),
        12 => lines(&mut scene, 300, |k, _| [2e4 * (k % 2) as f64, k as f64], MapKind::is_lane),
        13 => {
            let circle = |k: usize| (k as f64 * 0.01).sin_cos();
            let (sin, cos): (Vec<f64>, Vec<f64>) = (0..30_000).map(circle).unzip();
            lines(&mut scene, 30_000, |k, _| [20.0 * cos[k], 20.0 * sin[k]], MapKind::is_lane);
        }
        14 => longer(&mut scene, 4000),
        _ => {
            for track in &mut scene.tracks {
                for frame in 0..scene.frames {
                    if rng.below(3) == 0 && frame != 10 {
                        track.valid[frame] = false;
                    }
                }
            }
            scene.tracks[0].valid[0] = true;
        }
    }
    scene
}

/// The scene as a file: a pickle or native.
pub fn to_file(scene: Scene, native: bool) -> Vec<u8> {
    let recording = Recording::procedural(scene);
    if native { recording.to_native().unwrap() } else { recording.to_pickle().unwrap() }
}

fn moved(scene: &mut Scene, by: f64) {
    for position in scene.tracks.iter_mut().flat_map(|track| &mut track.position) {
        position[0] += by;
        position[1] -= by;
    }
    let map = Arc::make_mut(&mut scene.map);
    for point in &mut map.points {
        point[0] += by;
        point[1] -= by;
    }
}

/// Copies of all tracks, spread by some metres.
fn copies(scene: &mut Scene, count: usize, spread: f64, rng: &mut Rng) {
    let tracks: Vec<Track> = scene.tracks.to_vec();
    for number in 0..count {
        for track in &tracks {
            let mut copy = track.clone();
            copy.id = format!("{}-{number}", track.id);
            let by = [rng.uniform(-1.0, 1.0) * spread, rng.uniform(-1.0, 1.0) * spread];
            for position in &mut copy.position {
                position[0] += by[0];
                position[1] += by[1];
            }
            scene.tracks.push(copy);
        }
    }
    scene.tracks.truncate(60);
}

/// A feature of a kind with many points.
fn lines(
    scene: &mut Scene,
    count: usize,
    mut point: impl FnMut(usize, &mut Rng) -> [f64; 2],
    is_kind: impl Fn(&MapKind) -> bool,
) {
    let mut rng = Rng::new(count as u64, "lines", "crafted");
    let map = Arc::make_mut(&mut scene.map);
    let Some(model) = map.features.iter().find(|feature| is_kind(&feature.kind)).cloned() else { return };
    let first = map.points.len();
    map.points.extend((0..count).map(|k| point(k, &mut rng)).map(|[x, y]| [x, y, 0.0]));
    let lane = model.lane.is_some().then(empty_lane);
    map.features.push(MapFeature {
        id: "crafted".to_owned(),
        points: first..map.points.len(),
        lane,
        ..model
    });
}

/// Lanes of two points, each linked to many others.
fn short_lanes(scene: &mut Scene, count: usize, rng: &mut Rng) {
    let map: &mut Map = Arc::make_mut(&mut scene.map);
    let Some(model) = map.features.iter().find(|feature| feature.kind.is_lane()).cloned() else { return };
    let base = map.features.len();
    for number in 0..count {
        let first = map.points.len();
        let [x, y, turn] = [rng.uniform(-60.0, 60.0), rng.uniform(-60.0, 60.0), rng.uniform(0.0, TAU)];
        map.points.push([x, y, 0.0]);
        map.points.push([x + turn.cos(), y + turn.sin(), 0.0]);
        let mut lane = empty_lane();
        lane.exits = (0..8).map(|_| base + rng.below(count)).collect();
        let id = format!("short-{number}");
        map.features.push(MapFeature { id, points: first..first + 2, lane: Some(lane), ..model.clone() });
    }
}

fn empty_lane() -> Box<Lane> {
    Box::new(Lane {
        speed_limit: None,
        entries: Vec::new(),
        exits: Vec::new(),
        neighbors: Default::default(),
        boundaries: Default::default(),
        stop_signs: Vec::new(),
        width: Vec::new(),
    })
}

/// Two tracks of many frames.
fn longer(scene: &mut Scene, frames: usize) {
    scene.tracks.truncate(2);
    scene.lights.clear();
    scene.timestamps = (0..frames).map(|k| 0.1 * k as f64).collect();
    for track in &mut scene.tracks {
        let last = track.position[scene.frames - 1];
        let beyond = |frame: usize| [last[0] + 40.0 * (frame as f64), last[1], 0.0];
        track.position.extend((1..=frames - scene.frames).map(beyond));
        track.heading.resize(frames, 0.0);
        track.velocity.resize(frames, [400.0, 0.0]);
        track.size.resize(frames, track.size[0]);
        track.valid.resize(frames, true);
    }
    scene.frames = frames;
}
