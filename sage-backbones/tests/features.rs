//! Features on procedural scenes: symmetries, no use of the future, and unusual scenes.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod fixtures;

use std::sync::Arc;

use sage_backbones::{
    candidates::Sampling,
    features::{EdgeKinds, Features, GOAL_COLUMNS, VECTOR_COLUMNS},
    prediction::predict,
    training::Examples,
};
use sage_core::{
    generator::Observation,
    motion::NOW,
    scene::{Map, Scene, SceneData, SceneIndex},
    seed::Rng,
};
use sage_data::procedural::{Kind, generate};

use fixtures::{all, features, network, scene};

/// The scene rotated by an angle and translated.
fn moved(scene: &Scene, angle: f64, by: [f64; 2]) -> Scene {
    let (sin, cos) = angle.sin_cos();
    let turn = |[x, y]: [f64; 2]| [cos * x - sin * y, sin * x + cos * y];
    let point = |[x, y, z]: [f64; 3]| {
        let [x, y] = turn([x, y]);
        [x + by[0], y + by[1], z]
    };
    change(scene, point, turn, |heading| heading + angle)
}

/// The scene with left and right exchanged.
fn mirrored(scene: &Scene) -> Scene {
    change(scene, |[x, y, z]| [x, -y, z], |[x, y]| [x, -y], |heading| -heading)
}

/// The scene with changed positions, directions and headings.
fn change(
    scene: &Scene,
    point: impl Fn([f64; 3]) -> [f64; 3],
    turn: impl Fn([f64; 2]) -> [f64; 2],
    head: impl Fn(f64) -> f64,
) -> Scene {
    let mut scene = scene.clone();
    for track in &mut scene.tracks {
        track.position.iter_mut().for_each(|p| *p = point(*p));
        track.velocity.iter_mut().for_each(|v| *v = turn(*v));
        track.heading.iter_mut().for_each(|h| *h = head(*h));
    }
    for light in &mut scene.lights {
        light.stop_point = light.stop_point.map(&point);
    }
    let mut map = (*scene.map).clone();
    map.points.iter_mut().for_each(|p| *p = point(*p));
    scene.map = Arc::new(map);
    scene
}

/// Features of the scene's adversary, as [`Features::of`] gives them.
fn features_of(scene: &Scene) -> Features {
    let now = Observation::of(scene, &SceneIndex::new(scene.map.clone())).unwrap();
    Features::of(&now, scene.adversary.unwrap(), None, EdgeKinds::default()).unwrap()
}

/// Share of the numbers that are equal within 1e-3.
fn share_that_agrees(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    let same = a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() < 1e-3).count();
    same as f64 / a.len() as f64
}

#[test]
fn features_do_not_depend_on_the_world_frame() {
    for kind in Kind::ALL {
        let plain = generate(kind, 5, 2).unwrap();
        let [a, b] = [features_of(&plain), features_of(&moved(&plain, 1.1, [3000.0, -500.0]))];
        assert_eq!(a.groups, b.groups);
        // Rounding decides on goals at the edge of a lane or of the region.
        assert!(a.modes().abs_diff(b.modes()) <= 4, "{} and {} goals", a.modes(), b.modes());
        assert!(share_that_agrees(&a.vectors.values, &b.vectors.values) > 0.999);
        if a.modes() == b.modes() {
            assert!(share_that_agrees(&a.goal_features.values, &b.goal_features.values) > 0.99);
        }
    }
}

#[test]
fn mirrored_features_are_those_of_the_mirrored_scene() {
    for kind in Kind::ALL {
        let plain = generate(kind, 5, 3).unwrap();
        let [a, b] = [features_of(&plain).mirrored(), features_of(&mirrored(&plain))];
        assert_eq!(a.groups, b.groups);
        assert!(share_that_agrees(&a.vectors.values, &b.vectors.values) > 0.999);
        // The goals have another order.
        let sorted = |f: &Features| {
            let mut rows: Vec<([i32; 2], Vec<f32>)> = (0..f.modes())
                .map(|k| (f.goals[k].map(|x| x.round() as i32), f.goal_features.row(k).to_vec()))
                .collect();
            rows.sort_by_key(|row| row.0);
            rows
        };
        let [a, b] = [sorted(&a), sorted(&b)];
        let common: Vec<_> =
            a.iter().filter_map(|x| Some((x, b.binary_search_by_key(&x.0, |y| y.0).ok()?))).collect();
        assert!(common.len() + 4 >= a.len().max(b.len()), "{} of {} and {}", common.len(), a.len(), b.len());
        let agree = common.iter().filter(|(x, k)| share_that_agrees(&x.1, &b[*k].1) == 1.0).count();
        // If two lanes are equally near, either may be the lane of a goal.
        assert!(agree as f64 > 0.95 * common.len() as f64, "{kind:?}: {agree} of {}", common.len());
    }
}

#[test]
fn features_do_not_use_the_future() {
    let plain = generate(Kind::Merge, 5, 4).unwrap();
    let mut without_future = plain.clone();
    for track in &mut without_future.tracks {
        for f in NOW + 1..plain.frames {
            track.valid[f] = false;
            track.position[f] = [0.0; 3];
            track.velocity[f] = [0.0; 2];
            track.heading[f] = 0.0;
        }
    }
    for light in &mut without_future.lights {
        light.states.truncate(NOW + 1);
    }
    let [a, b] = [features_of(&plain), features_of(&without_future)];
    assert_eq!(a.vectors, b.vectors);
    assert_eq!(a.goal_features, b.goal_features);
    assert_eq!((a.vectors.columns, a.goal_features.columns), (VECTOR_COLUMNS, GOAL_COLUMNS));
}

#[test]
fn neighbour_lanes_are_reachable_if_a_source_lists_only_ids() {
    let mut scene = generate(Kind::Straight, 5, 2).unwrap();
    let plain = features_of(&scene);
    let mut map = (*scene.map).clone();
    for lane in map.features.iter_mut().filter_map(|f| f.lane.as_mut()) {
        for neighbor in lane.neighbors.iter_mut().flatten() {
            (neighbor.own, neighbor.other) = ([0, 0], [0, 0]);
        }
    }
    scene.map = Arc::new(map);
    let reached = |f: &Features| (0..f.modes()).filter(|&k| f.goal_features.row(k)[16] > 0.0).count();
    let bare = reached(&features_of(&scene));
    assert!(bare as f64 > 0.8 * reached(&plain) as f64, "{bare} of {}", reached(&plain));
}

#[test]
fn a_scene_without_lanes_has_goals_on_a_grid() {
    let mut bare = generate(Kind::Straight, 5, 5).unwrap();
    bare.map = Arc::new(Map::default());
    let data = SceneData::new("bare", bare);
    for network in all() {
        let features = features(&*network, &data);
        assert_eq!(features.has_lanes, network.name() == "densetnt-cat");
        let found = predict(&*network, features, 32, Sampling::TopK, &mut Rng::new(0, "", "")).unwrap();
        assert_eq!(found.len(), 32, "{}", network.name());
    }
}

#[test]
fn absurd_speeds_and_maps_cost_no_more_than_normal_ones() {
    let mut scene = generate(Kind::Straight, 5, 6).unwrap();
    let target = scene.adversary.unwrap();
    scene.tracks[target].velocity[NOW] = [9e7, -9e7];
    let mut map = (*scene.map).clone();
    map.points.iter_mut().step_by(3).for_each(|p| p[0] += 9e7);
    map.features.iter_mut().filter_map(|f| f.lane.as_mut()).for_each(|lane| lane.speed_limit = Some(1e300));
    scene.map = Arc::new(map);
    let data = SceneData::new("absurd", scene);
    let own = features(&*network("densetnt"), &data);
    assert!(own.modes() <= 4096);
    assert!(own.vectors.values.iter().chain(&own.goal_features.values).all(|x| x.is_finite()));
    for network in all() {
        let features = features(&*network, &data);
        predict(&*network, features, 6, Sampling::TopK, &mut Rng::new(0, "", "")).unwrap();
    }
}

#[test]
fn an_agent_that_is_not_valid_now_is_refused_by_name() {
    let mut data = scene(Kind::Curve);
    let target = data.scene.adversary.unwrap();
    Arc::make_mut(&mut data.scene).tracks[target].valid[NOW] = false;
    let id = data.scene.tracks[target].id.clone();
    for network in all() {
        let error = network.features(&data.observe().unwrap(), target, None).unwrap_err().to_string();
        assert!(error.contains(&format!("agent `{id}` is not valid at frame 10")), "{error}");
    }
    assert!(network("densetnt").features(&data.observe().unwrap(), 999, None).is_err());
    assert!(!Examples::of(&[data]).list().iter().any(|e| e.track == target));
}
