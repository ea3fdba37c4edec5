//! Seeded scenes for property tests: a curved road with edges and random traffic.

#![allow(dead_code)] // Each test program uses some of it.

use std::sync::Arc;

use sage_core::{
    motion::{HORIZON, NOW, Trajectory},
    scene::{AdversaryOrigin, Map, MapFeature, MapKind, Scene, Track, TrackKind},
    seed::Rng,
};

const FRAMES: usize = NOW + HORIZON + 1;

/// A track on an arc from a pose, with random size and kind.
fn track(rng: &mut Rng, id: usize, start: [f64; 2], heading: f64, speed: f64, gaps: bool) -> Track {
    let yaw_rate = rng.uniform(-0.15, 0.15);
    let kind = [TrackKind::Vehicle, TrackKind::Vehicle, TrackKind::Pedestrian, TrackKind::Cyclist]
        [rng.below(4)]
    .clone();
    let size = [rng.uniform(0.6, 6.0), rng.uniform(0.5, 2.4), 1.6];
    let mut track = Track {
        id: id.to_string(),
        kind,
        position: vec![],
        heading: vec![],
        velocity: vec![],
        size: vec![],
        valid: vec![],
    };
    let (mut at, mut h) = (start, heading);
    for _ in 0..FRAMES {
        let valid = !gaps || rng.unit() > 0.05;
        let masked = |x: f64| if valid { x } else { 0.0 };
        track.position.push([masked(at[0]), masked(at[1]), 0.0]);
        track.heading.push(masked(h));
        track.velocity.push([masked(speed * h.cos()), masked(speed * h.sin())]);
        track.size.push(size.map(masked));
        track.valid.push(valid);
        h += yaw_rate * 0.1;
        at = [at[0] + 0.1 * speed * h.cos(), at[1] + 0.1 * speed * h.sin()];
    }
    track
}

/// The scene of a seed.
pub fn scene(seed: u64) -> Scene {
    let mut rng = Rng::new(seed, "laws", "scene");
    let mut tracks: Vec<Track> = (0..2 + rng.below(12))
        .map(|id| {
            let start = [rng.uniform(-40.0, 40.0), rng.uniform(-40.0, 40.0)];
            let (heading, speed) = (rng.uniform(-3.0, 3.0), rng.uniform(0.0, 12.0));
            track(&mut rng, id, start, heading, if id % 4 == 3 { 0.0 } else { speed }, id >= 2)
        })
        .collect();
    tracks[0].kind = TrackKind::Vehicle;
    tracks[1].kind = TrackKind::Vehicle;
    let mut map = Map::default();
    for id in 0..1 + rng.below(6) {
        let first = map.points.len();
        let mut at = [rng.uniform(-60.0, 60.0), rng.uniform(-60.0, 60.0)];
        let mut heading = rng.uniform(-3.0, 3.0);
        for _ in 0..2 + rng.below(60) {
            map.points.push([at[0], at[1], 0.0]);
            heading += rng.uniform(-0.2, 0.2);
            at = [at[0] + 1.5 * heading.cos(), at[1] + 1.5 * heading.sin()];
        }
        let kind = if id % 3 == 2 { MapKind::EdgeMedian } else { MapKind::EdgeBoundary };
        map.features.push(MapFeature {
            id: format!("m{id}"),
            kind,
            points: first..map.points.len(),
            lane: None,
        });
    }
    Scene {
        id: format!("laws-{seed}"),
        frames: FRAMES,
        timestamps: vec![],
        tracks: tracks.into(),
        map: Arc::new(map),
        lights: vec![],
        ego: 0,
        adversary: Some(1),
        adversary_origin: AdversaryOrigin::User,
        notes: vec![],
        held: Vec::new(),
    }
}

/// The candidate of a seed: the log, an arc that may stop, or a straight line to the ego with or without
/// noise.
pub fn candidate(scene: &Scene, seed: u64) -> Trajectory {
    let mut rng = Rng::new(seed, &scene.id, "candidate");
    let (ego, adversary) = (&scene.tracks[0], &scene.tracks[1]);
    let from = adversary.point(NOW);
    let points: Vec<[f64; 2]> = match rng.below(4) {
        0 => (NOW + 1..FRAMES).map(|f| adversary.point(f)).collect(),
        1 => {
            let (yaw_rate, gain) = (rng.uniform(-0.4, 0.4), rng.uniform(-3.0, 2.0));
            let (mut at, mut h, mut v) = (from, adversary.heading[NOW], rng.uniform(0.0, 12.0));
            let step = |_| {
                v = f64::max(v + 0.1 * gain, 0.0);
                h += 0.1 * yaw_rate;
                at = [at[0] + 0.1 * v * h.cos(), at[1] + 0.1 * v * h.sin()];
                at
            };
            (0..HORIZON).map(step).collect()
        }
        variant => {
            let aim = 1 + rng.below(HORIZON);
            let to = ego.point(NOW + aim);
            let noise = if variant == 2 { 0.0 } else { 0.05 };
            let at = |t: usize, k: usize| from[k] + (to[k] - from[k]) * t as f64 / aim as f64;
            (1..=HORIZON)
                .map(|t| [at(t, 0) + noise * rng.normal(), at(t, 1) + noise * rng.normal()])
                .collect()
        }
    };
    Trajectory::new("candidate", points).unwrap()
}

/// The scene turned by `angle` about the origin, then moved.
pub fn moved(scene: &Scene, angle: f64, by: [f64; 2]) -> Scene {
    let mut scene = scene.clone();
    let turn = |p: [f64; 2]| turned(p, angle);
    for track in &mut scene.tracks {
        for p in &mut track.position {
            let [x, y] = turn([p[0], p[1]]);
            *p = [x + by[0], y + by[1], p[2]];
        }
        track.heading.iter_mut().for_each(|h| *h += angle);
        track.velocity.iter_mut().for_each(|v| *v = turn(*v));
    }
    let mut map = (*scene.map).clone();
    for p in &mut map.points {
        let [x, y] = turn([p[0], p[1]]);
        *p = [x + by[0], y + by[1], p[2]];
    }
    scene.map = Arc::new(map);
    scene
}

/// A trajectory turned by `angle` about the origin, then moved.
pub fn moved_trajectory(trajectory: &Trajectory, angle: f64, by: [f64; 2]) -> Trajectory {
    let moved_point = |p: &[f64; 2]| {
        let [x, y] = turned(*p, angle);
        [x + by[0], y + by[1]]
    };
    Trajectory::new("moved", trajectory.points().iter().map(moved_point).collect()).unwrap()
}

fn turned([x, y]: [f64; 2], angle: f64) -> [f64; 2] {
    let (s, c) = angle.sin_cos();
    [x * c - y * s, x * s + y * c]
}
