//! What a target expects of everybody else, and how the score of a mode follows its path.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::sync::Arc;

use sage_backbones::{
    backbones,
    candle::{DType, Tensor},
    features::{AgentForecasts, FORECAST_STEPS, Features, ForecastMode, STRIDE},
    forecast::features_with_forecast,
    subsampling::Subsampling,
};
use sage_core::{
    generator::Observation,
    motion::{HORIZON, NOW},
    scene::{Scene, SceneIndex},
    seed::Rng,
};
use sage_data::procedural::{Kind, generate};

fn look(scene: &Scene) -> Features {
    let now = Observation::of(scene, &SceneIndex::new(scene.map.clone())).unwrap();
    Features::of(&now, scene.adversary.unwrap(), None).unwrap()
}

fn sums_to_one(ways: &[ForecastMode]) -> bool {
    (ways.iter().map(|way| way.weight).sum::<f32>() - 1.0).abs() < 1e-5
}

/// Greatest distance of a way from where a track really is, over the looks at which it is seen.
fn farthest(way: &ForecastMode, scene: &Scene, track: usize, features: &Features) -> f64 {
    let at = |look: usize| NOW + (look + 1) * STRIDE;
    let seen = (0..FORECAST_STEPS).filter(|look| scene.tracks[track].is_valid(at(*look)));
    let gap = |look: usize| {
        let [x, y] = features.frame.to_local(scene.tracks[track].point(at(look)));
        (f64::from(way.poses[look][0]) - x).hypot(f64::from(way.poses[look][1]) - y)
    };
    seen.map(gap).fold(0.0, f64::max)
}

#[test]
fn who_follows_a_lane_is_expected_along_its_bends() {
    // On procedural scenes most drive along lanes: going on so is far nearer to what they do than going straight.
    let (mut along, mut straight) = (Vec::new(), Vec::new());
    for number in 0..12 {
        let scene = generate(Kind::ALL[number % Kind::ALL.len()], 9, number as u64).unwrap();
        let features = look(&scene);
        let ego = &features.agent_forecasts.ego[0];
        let [x, y] = features.frame.to_local(scene.ego().point(NOW));
        let [vx, vy] = features.frame.turn_to_local(scene.ego().velocity[NOW]);
        let mut plain = ego.clone();
        for (look, pose) in plain.poses.iter_mut().enumerate() {
            let t = ((look + 1) * STRIDE) as f64 * 0.1;
            [pose[0], pose[1]] = [(x + t * vx) as f32, (y + t * vy) as f32];
        }
        along.push(farthest(ego, &scene, scene.ego, &features));
        straight.push(farthest(&plain, &scene, scene.ego, &features));
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    assert!(mean(&along) < 0.8 * mean(&straight), "{} m against {} m", mean(&along), mean(&straight));
}

#[test]
fn who_stands_stays_and_who_drives_has_several_manners() {
    let mut scene = generate(Kind::Merge, 5, 4).unwrap();
    let other = (0..scene.tracks.len())
        .find(|&k| k != scene.ego && Some(k) != scene.adversary && scene.tracks[k].is_valid(NOW))
        .unwrap();
    scene.tracks[other].velocity[NOW] = [0.1, 0.0];
    let features = look(&scene);
    let place = features.frame.to_local(scene.tracks[other].point(NOW));
    let standing: Vec<&ForecastMode> =
        features.agent_forecasts.others.iter().filter(|way| way.stands).collect();
    let own = standing.iter().find(|way| {
        let [x, y, ..] = way.poses[0];
        (f64::from(x) - place[0]).hypot(f64::from(y) - place[1]) < 0.01
    });
    assert!(own.is_some_and(|way| way.poses.iter().all(|pose| pose == &way.poses[0]) && way.weight == 1.0));
    assert!(features.agent_forecasts.ego.len() == 3 && sums_to_one(&features.agent_forecasts.ego));
    // Braking is behind, gaining ahead of an even speed.
    let gone = |way: &ForecastMode| {
        let [x, y, ..] = way.poses[FORECAST_STEPS - 1];
        let [a, b, ..] = way.poses[0];
        (x - a).hypot(y - b)
    };
    let [even, braking, gaining] = [0, 1, 2].map(|k| gone(&features.agent_forecasts.ego[k]));
    assert!(braking < even && even < gaining, "{braking} {even} {gaining}");
}

#[test]
fn an_outlook_mirrors_and_uses_nothing_of_the_future() {
    let plain = generate(Kind::FourWay, 5, 3).unwrap();
    let features = look(&plain);
    let twin = features.mirrored();
    for (a, b) in features.agent_forecasts.ego.iter().zip(&twin.agent_forecasts.ego) {
        for (p, q) in a.poses.iter().zip(&b.poses) {
            assert_eq!([p[0], -p[1], p[2], -p[3]], *q);
        }
    }
    let mut forgetful = plain.clone();
    for track in &mut forgetful.tracks {
        for frame in NOW + 1..plain.frames {
            (track.valid[frame], track.position[frame], track.velocity[frame]) = (false, [9.0; 3], [9.0; 2]);
        }
    }
    assert_eq!(features.agent_forecasts, look(&forgetful).agent_forecasts);
}

#[test]
fn a_ring_of_lanes_without_length_ends() {
    let mut scene = generate(Kind::Straight, 5, 2).unwrap();
    let mut map = (*scene.map).clone();
    for k in 0..map.features.len() {
        if map.features[k].kind.is_motor_lane() {
            // All points of the lane in one place but for its first segment; its exit is itself.
            let range = map.features[k].points.clone();
            if let Some(lane) = map.features[k].lane.as_mut() {
                lane.exits = vec![k];
            }
            let second = map.points[range.start + 1];
            map.points[range.start + 1..range.end].fill(second);
        }
    }
    scene.map = Arc::new(map);
    let index = SceneIndex::new(scene.map.clone());
    let features =
        Features::of(&Observation::of(&scene, &index).unwrap(), scene.adversary.unwrap(), None).unwrap();
    let finite = |way: &ForecastMode| way.poses.iter().flatten().all(|x| x.is_finite());
    assert!(features.agent_forecasts.ego.iter().chain(&features.agent_forecasts.others).all(finite));
}

#[test]
fn a_network_foresees_the_ego_in_several_ways_and_never_by_its_log() {
    let scene = generate(Kind::FourWay, 5, 1).unwrap();
    let index = SceneIndex::new(scene.map.clone());
    let network = backbones().unwrap().build_default("densetnt").unwrap();
    let adversary = scene.adversary.unwrap();
    let ways = |scene: &Scene| {
        let now = Observation::of(scene, &index).unwrap();
        features_with_forecast(&*network, &now, adversary, Subsampling::NONE).unwrap().agent_forecasts
    };
    let foreseen: AgentForecasts = ways(&scene);
    assert!(foreseen.ego.len() > 3 && sums_to_one(&foreseen.ego));
    assert!(foreseen.ego.windows(2).all(|w| w[0].weight >= w[1].weight), "the likeliest first");
    let unit = |pose: &[f32; 4]| (pose[2].hypot(pose[3]) - 1.0).abs() < 1e-4;
    assert!(foreseen.ego.iter().flat_map(|way| &way.poses).all(unit));
    let mut other = scene.clone();
    let ego = other.ego;
    for frame in NOW + 1..other.frames {
        other.tracks[ego].position[frame] = [0.0; 3];
    }
    assert_eq!(foreseen, ways(&other));
    assert_eq!(foreseen.others, look(&scene).agent_forecasts.others);
}

#[test]
fn a_mode_along_its_own_path_has_its_own_log_probability() {
    let scene = generate(Kind::FourWay, 5, 1).unwrap();
    let index = SceneIndex::new(scene.map.clone());
    for name in ["densetnt", "query-transformer"] {
        let plain = backbones().unwrap().build_default(name).unwrap();
        // Stirred, so that the steering branch says something.
        let mut rng = Rng::new(3, name, "stir");
        let mut weights = plain.parameters().clone();
        for (name, tensor) in plain.parameters().iter() {
            let noise: Vec<f32> = (0..tensor.elem_count()).map(|_| (0.1 * rng.normal()) as f32).collect();
            let noise = Tensor::from_vec(noise, tensor.dims(), tensor.device()).unwrap();
            weights.insert(name, (tensor + noise).unwrap());
        }
        let network = plain.with_parameters(weights).unwrap();
        let now = Observation::of(&scene, &index).unwrap();
        let features =
            features_with_forecast(&*network, &now, scene.adversary.unwrap(), Subsampling::NONE).unwrap();
        let encoding = network.encode(Arc::new(features)).unwrap();
        let log_probs = network.log_probs(&encoding).unwrap();
        let modes = [3, 11, 0];
        let paths = network.trajectories(&encoding, &modes).unwrap();
        assert_eq!(paths.dims(), [3, HORIZON, 2]);
        let steps: Vec<u32> = (1..=FORECAST_STEPS).map(|k| (k * STRIDE - 1) as u32).collect();
        let places = paths.index_select(&Tensor::new(&steps[..], paths.device()).unwrap(), 1).unwrap();
        let numbers = |tensor: Tensor| tensor.to_dtype(DType::F64).unwrap().to_vec1::<f64>().unwrap();
        let all = numbers(log_probs.clone());
        let own = numbers(network.log_probs_along(&encoding, &log_probs, &modes, &places).unwrap());
        let far = (&places + 7.0).unwrap();
        let moved = numbers(network.log_probs_along(&encoding, &log_probs, &modes, &far).unwrap());
        let relative = numbers(network.relative_log_probs(&encoding, &modes).unwrap());
        for (k, &mode) in modes.iter().enumerate() {
            assert!((own[k] - all[mode]).abs() < 1e-3, "{name}: {} for {}", own[k], all[mode]);
            let gap = |x: &[f64], at: usize, from: usize| x[at] - x[from];
            assert!((gap(&relative, k, 0) - gap(&all, mode, modes[0])).abs() < 1e-3, "{name}");
        }
        assert!((0..3).any(|k| (moved[k] - own[k]).abs() > 1e-3), "{name}: another path, another score");
    }
}

#[test]
fn a_coarser_view_sees_a_part_of_what_the_full_one_sees() {
    let scene = generate(Kind::FourWay, 3, 0).unwrap();
    let index = SceneIndex::new(scene.map.clone());
    let network = backbones().unwrap().build_default("densetnt").unwrap();
    let now = Observation::of(&scene, &index).unwrap();
    let see = |view| features_with_forecast(&*network, &now, scene.adversary.unwrap(), view).unwrap();
    let (full, plain) = (see(Subsampling::NONE), look(&scene));
    assert_eq!((&full.goals, full.groups.len()), (&plain.goals, plain.groups.len()));
    let coarse = see(Subsampling { max_polylines: 20, dense_goal_radius: 30.0, ..Subsampling::NONE });
    assert_eq!(coarse.groups.len(), full.agents + 20);
    assert!(coarse.goals.iter().all(|goal| full.goals.contains(goal)));
    let within = |goals: &[[f32; 2]]| goals.iter().filter(|[x, y]| x * x + y * y < 900.0).count();
    assert_eq!(within(&coarse.goals), within(&full.goals));
    let beyond = |features: &Features| (features.modes() - within(&features.goals)) as f64;
    assert!((0.4..0.6).contains(&(beyond(&coarse) / beyond(&full))));
    for (view, field) in [
        (Subsampling { max_polylines: 0, ..Subsampling::NONE }, "max_polylines"),
        (Subsampling { dense_goal_radius: f32::NAN, ..Subsampling::NONE }, "dense_goal_radius"),
        (Subsampling { ego_goal_stride: 0, ..Subsampling::NONE }, "ego_goal_stride"),
    ] {
        assert!(view.check().unwrap_err().to_string().contains(field));
    }
}
