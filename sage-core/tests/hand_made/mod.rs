//! Scenes made by hand, whose measures are known.

#![allow(dead_code, clippy::unwrap_used)] // Not every test uses every part; a failed unwrap is a failed test.

use std::sync::Arc;

use sage_core::{
    motion::{NOW, Trajectory},
    objective::{Candidate, Context, ContextOptions, Scorer, Scores},
    scene::{AdversaryOrigin, Map, MapFeature, MapKind, Scene, SceneIndex, Track, TrackKind},
};

/// A car on a straight line; 4 m × 2 m.
pub fn car(id: &str, start: [f64; 2], velocity: [f64; 2]) -> Track {
    let heading = if velocity == [0.0, 0.0] { 0.0 } else { velocity[1].atan2(velocity[0]) };
    let at = |f: usize| {
        let t = 0.1 * (f as f64 - NOW as f64);
        [start[0] + t * velocity[0], start[1] + t * velocity[1], 0.0]
    };
    Track {
        id: id.to_owned(),
        kind: TrackKind::Vehicle,
        position: (0..91).map(at).collect(),
        heading: vec![heading; 91],
        velocity: vec![velocity; 91],
        size: vec![[4.0, 2.0, 1.5]; 91],
        valid: vec![true; 91],
    }
}

/// Ego along +x at 10 m/s from the origin, adversary beside it, edges at y = ±8 with the road between.
pub fn road(adversary: Track, others: Vec<Track>) -> Scene {
    let mut map = Map::default();
    for (id, from, to) in
        [("right", [-100.0, -8.0, 0.0], [300.0, -8.0, 0.0]), ("left", [300.0, 8.0, 0.0], [-100.0, 8.0, 0.0])]
    {
        let first = map.points.len();
        map.points.extend([from, to]);
        map.features.push(MapFeature {
            id: id.into(),
            kind: MapKind::EdgeBoundary,
            points: first..first + 2,
            lane: None,
        });
    }
    let mut tracks = vec![car("ego", [0.0, 0.0], [10.0, 0.0]), adversary];
    tracks.extend(others);
    Scene {
        id: "road".into(),
        frames: 91,
        timestamps: vec![],
        tracks: tracks.into(),
        map: map.into(),
        lights: vec![],
        ego: 0,
        adversary: Some(1),
        adversary_origin: AdversaryOrigin::User,
        notes: vec![],
        held: Vec::new(),
    }
}

/// The scene prepared for scoring.
pub fn context(scene: &Scene) -> Context {
    let index = SceneIndex::new(scene.map.clone());
    Context::new(&Arc::new(scene.clone()), &index, &ContextOptions::default()).unwrap()
}

/// The adversary's plan from its position at a time after *now*, seconds.
pub fn candidate(ctx: &Context, at: impl Fn(f64) -> [f64; 2]) -> Candidate {
    let path = (1..=80).map(|t| at(0.1 * t as f64)).collect();
    ctx.candidate(Trajectory::new("path", path).unwrap())
}

/// The scene with one more map feature in the plane.
pub fn with_feature(scene: &Scene, id: &str, kind: MapKind, points: &[[f64; 2]]) -> Scene {
    let mut map = (*scene.map).clone();
    let first = map.points.len();
    map.points.extend(points.iter().map(|[x, y]| [*x, *y, 0.0]));
    let points = first..map.points.len();
    map.features.push(MapFeature { id: id.into(), kind, points, lane: None });
    Scene { map: map.into(), ..scene.clone() }
}

/// All measures of a plan.
pub fn score(scene: &Scene, at: impl Fn(f64) -> [f64; 2]) -> Scores {
    let ctx = context(scene);
    Scorer::new(&ctx).scores(&candidate(&ctx, at))
}
