//! Scenes with known answers: a straight road along x, cars at constant speed.

#![allow(dead_code, clippy::unwrap_used)] // Each test uses some of it; a failed unwrap is a failed test.

use std::sync::Arc;

use sage_core::scene::{
    AdversaryOrigin, Lane, Map, MapFeature, MapKind, Scene, SceneIndex, Track, TrackKind,
};
use sage_sim::SimScene;

pub const FRAMES: usize = 91;

/// A car that drives straight: position at frame 0, heading, speed.
pub fn car(id: &str, [x, y]: [f64; 2], heading: f64, speed: f64) -> Track {
    let (sin, cos) = heading.sin_cos();
    let at = |frame: usize| 0.1 * speed * frame as f64;
    Track {
        id: id.to_owned(),
        kind: TrackKind::Vehicle,
        position: (0..FRAMES).map(|f| [x + at(f) * cos, y + at(f) * sin, 0.75]).collect(),
        heading: vec![heading; FRAMES],
        velocity: vec![[speed * cos, speed * sin]; FRAMES],
        size: vec![[4.5, 2.0, 1.5]; FRAMES],
        valid: vec![true; FRAMES],
    }
}

/// A lane along x at an offset, from x = −100 to 300 m.
fn lane(map: &mut Map, id: &str, y: f64, z: f64) {
    let start = map.points.len();
    map.points.extend((0..=80).map(|k| [-100.0 + 5.0 * f64::from(k), y, z]));
    let points = start..map.points.len();
    let lane = Some(Box::new(Lane { speed_limit: Some(15.0), ..Lane::default() }));
    map.features.push(MapFeature { id: id.to_owned(), kind: MapKind::LaneSurfaceStreet, points, lane });
}

/// A straight road with one lane.
pub fn road() -> Map {
    let mut map = Map::default();
    lane(&mut map, "lane", 0.0, 0.0);
    map
}

/// A road and a bridge across it, 6 m higher.
pub fn road_under_a_bridge() -> Map {
    let mut map = road();
    let start = map.points.len();
    map.points.extend((0..=40).map(|k| [40.0, -100.0 + 5.0 * f64::from(k), 6.0]));
    let points = start..map.points.len();
    let kind = MapKind::LaneSurfaceStreet;
    map.features.push(MapFeature { id: "bridge".to_owned(), kind, points, lane: Some(Box::default()) });
    map
}

/// A scene of tracks, the first the ego and the second, if there is one, the adversary.
pub fn scene(map: Map, tracks: Vec<Track>) -> Scene {
    Scene {
        id: "hand-made".to_owned(),
        frames: FRAMES,
        timestamps: vec![],
        adversary: (tracks.len() > 1).then_some(1),
        tracks: tracks.into(),
        map: Arc::new(map),
        lights: vec![],
        ego: 0,
        adversary_origin: AdversaryOrigin::User,
        notes: vec![],
        held: Vec::new(),
    }
}

/// The scene, prepared.
pub fn prepared(scene: Scene) -> Arc<SimScene> {
    let index = SceneIndex::new(scene.map.clone());
    SimScene::new(Arc::new(scene), index).unwrap()
}
