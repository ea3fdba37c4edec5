//! Forecasts of the ego and of the other agents, and how the score of a mode depends on its trajectory.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::sync::Arc;

use sage_backbones::{
    backbones,
    candle::{DType, Tensor},
    features::{AgentForecasts, EdgeKinds, FORECAST_STEPS, Features, ForecastMode, STRIDE},
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

fn features_of(scene: &Scene) -> Features {
    let now = Observation::of(scene, &SceneIndex::new(scene.map.clone())).unwrap();
    Features::of(&now, scene.adversary.unwrap(), None, EdgeKinds::default()).unwrap()
}

fn sums_to_one(modes: &[ForecastMode]) -> bool {
    (modes.iter().map(|mode| mode.weight).sum::<f32>() - 1.0).abs() < 1e-5
}

/// Greatest distance of a forecast from the recorded track, over the forecast steps at which the track is
/// valid.
fn farthest(mode: &ForecastMode, scene: &Scene, track: usize, features: &Features) -> f64 {
    let frame = |step: usize| NOW + (step + 1) * STRIDE;
    let valid = (0..FORECAST_STEPS).filter(|step| scene.tracks[track].is_valid(frame(*step)));
    let gap = |step: usize| {
        let [x, y] = features.frame.frame_from_world(scene.tracks[track].point(frame(step)));
        (f64::from(mode.poses[step][0]) - x).hypot(f64::from(mode.poses[step][1]) - y)
    };
    valid.map(gap).fold(0.0, f64::max)
}

#[test]
fn the_forecast_of_a_vehicle_on_a_lane_follows_the_lane() {
    // In procedural scenes most vehicles drive along lanes, so a forecast along the lane is far nearer to the
    // record than a straight one.
    let (mut along, mut straight) = (Vec::new(), Vec::new());
    for number in 0..12 {
        let scene = generate(Kind::ALL[number % Kind::ALL.len()], 9, number as u64).unwrap();
        let features = features_of(&scene);
        let ego = &features.agent_forecasts.ego[0];
        let [x, y] = features.frame.frame_from_world(scene.ego().point(NOW));
        let [vx, vy] = features.frame.direction_from_world(scene.ego().velocity[NOW]);
        let mut plain = ego.clone();
        for (step, pose) in plain.poses.iter_mut().enumerate() {
            let t = ((step + 1) * STRIDE) as f64 * 0.1;
            [pose[0], pose[1]] = [(x + t * vx) as f32, (y + t * vy) as f32];
        }
        along.push(farthest(ego, &scene, scene.ego, &features));
        straight.push(farthest(&plain, &scene, scene.ego, &features));
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    assert!(mean(&along) < 0.8 * mean(&straight), "{} m against {} m", mean(&along), mean(&straight));
}

#[test]
fn a_standing_agent_stays_and_a_moving_one_has_several_acceleration_profiles() {
    let mut scene = generate(Kind::Merge, 5, 4).unwrap();
    let other = (0..scene.tracks.len())
        .find(|&k| k != scene.ego && Some(k) != scene.adversary && scene.tracks[k].is_valid(NOW))
        .unwrap();
    scene.tracks[other].velocity[NOW] = [0.1, 0.0];
    let features = features_of(&scene);
    let position = features.frame.frame_from_world(scene.tracks[other].point(NOW));
    let standing: Vec<&ForecastMode> =
        features.agent_forecasts.others.iter().filter(|mode| mode.stands).collect();
    let own = standing.iter().find(|mode| {
        let [x, y, ..] = mode.poses[0];
        (f64::from(x) - position[0]).hypot(f64::from(y) - position[1]) < 0.01
    });
    assert!(
        own.is_some_and(|mode| mode.poses.iter().all(|pose| pose == &mode.poses[0]) && mode.weight == 1.0)
    );
    assert!(features.agent_forecasts.ego.len() == 3 && sums_to_one(&features.agent_forecasts.ego));
    // Braking gives the shortest distance, acceleration the longest.
    let driven = |mode: &ForecastMode| {
        let [x, y, ..] = mode.poses[FORECAST_STEPS - 1];
        let [a, b, ..] = mode.poses[0];
        (x - a).hypot(y - b)
    };
    let [constant, braking, accelerating] = [0, 1, 2].map(|k| driven(&features.agent_forecasts.ego[k]));
    assert!(braking < constant && constant < accelerating, "{braking} {constant} {accelerating}");
}

#[test]
fn forecasts_can_be_mirrored_and_do_not_use_the_future() {
    let plain = generate(Kind::FourWay, 5, 3).unwrap();
    let features = features_of(&plain);
    let mirror = features.mirrored();
    for (a, b) in features.agent_forecasts.ego.iter().zip(&mirror.agent_forecasts.ego) {
        for (p, q) in a.poses.iter().zip(&b.poses) {
            assert_eq!([p[0], -p[1], p[2], -p[3]], *q);
        }
    }
    let mut without_future = plain.clone();
    for track in &mut without_future.tracks {
        for frame in NOW + 1..plain.frames {
            (track.valid[frame], track.position[frame], track.velocity[frame]) = (false, [9.0; 3], [9.0; 2]);
        }
    }
    assert_eq!(features.agent_forecasts, features_of(&without_future).agent_forecasts);
}

#[test]
fn a_ring_of_lanes_without_length_ends() {
    let mut scene = generate(Kind::Straight, 5, 2).unwrap();
    let mut map = (*scene.map).clone();
    for k in 0..map.features.len() {
        if map.features[k].kind.is_motor_lane() {
            // All points of the lane are equal except the first; the lane is its own exit.
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
    let features = Features::of(
        &Observation::of(&scene, &index).unwrap(),
        scene.adversary.unwrap(),
        None,
        EdgeKinds::default(),
    )
    .unwrap();
    let finite = |mode: &ForecastMode| mode.poses.iter().flatten().all(|x| x.is_finite());
    assert!(features.agent_forecasts.ego.iter().chain(&features.agent_forecasts.others).all(finite));
}

#[test]
fn a_networks_ego_forecast_has_several_modes_and_does_not_use_the_log() {
    let scene = generate(Kind::FourWay, 5, 1).unwrap();
    let index = SceneIndex::new(scene.map.clone());
    let network = backbones().unwrap().build_default("densetnt").unwrap();
    let adversary = scene.adversary.unwrap();
    let forecasts = |scene: &Scene| {
        let now = Observation::of(scene, &index).unwrap();
        features_with_forecast(&*network, &now, adversary, Subsampling::NONE).unwrap().agent_forecasts
    };
    let own: AgentForecasts = forecasts(&scene);
    assert!(own.ego.len() > 3 && sums_to_one(&own.ego));
    assert!(own.ego.windows(2).all(|w| w[0].weight >= w[1].weight), "the likeliest first");
    let unit = |pose: &[f32; 4]| (pose[2].hypot(pose[3]) - 1.0).abs() < 1e-4;
    assert!(own.ego.iter().flat_map(|mode| &mode.poses).all(unit));
    let mut other = scene.clone();
    let ego = other.ego;
    for frame in NOW + 1..other.frames {
        other.tracks[ego].position[frame] = [0.0; 3];
    }
    assert_eq!(own, forecasts(&other));
    assert_eq!(own.others, features_of(&scene).agent_forecasts.others);
}

#[test]
fn a_mode_along_its_own_trajectory_has_its_own_log_probability() {
    let scene = generate(Kind::FourWay, 5, 1).unwrap();
    let index = SceneIndex::new(scene.map.clone());
    for name in ["densetnt", "query-transformer"] {
        let plain = backbones().unwrap().build_default(name).unwrap();
        // With noise on all weights, so that the interaction head is not zero.
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
        let trajectories = network.trajectories(&encoding, &modes).unwrap();
        assert_eq!(trajectories.dims(), [3, HORIZON, 2]);
        let steps: Vec<u32> = (1..=FORECAST_STEPS).map(|k| (k * STRIDE - 1) as u32).collect();
        let steps = Tensor::new(&steps[..], trajectories.device()).unwrap();
        let points = trajectories.index_select(&steps, 1).unwrap();
        let numbers = |tensor: Tensor| tensor.to_dtype(DType::F64).unwrap().to_vec1::<f64>().unwrap();
        let all = numbers(log_probs.clone());
        let own = numbers(network.log_probs_along(&encoding, &log_probs, &modes, &points).unwrap());
        let far = (&points + 7.0).unwrap();
        let moved = numbers(network.log_probs_along(&encoding, &log_probs, &modes, &far).unwrap());
        let relative = numbers(network.relative_log_probs(&encoding, &modes).unwrap());
        for (k, &mode) in modes.iter().enumerate() {
            assert!((own[k] - all[mode]).abs() < 1e-3, "{name}: {} for {}", own[k], all[mode]);
            let gap = |x: &[f64], at: usize, from: usize| x[at] - x[from];
            assert!((gap(&relative, k, 0) - gap(&all, mode, modes[0])).abs() < 1e-3, "{name}");
        }
        assert!(
            (0..3).any(|k| (moved[k] - own[k]).abs() > 1e-3),
            "{name}: another trajectory, another score"
        );
    }
}

#[test]
fn subsampled_polylines_and_goals_are_a_subset() {
    let scene = generate(Kind::FourWay, 3, 0).unwrap();
    let index = SceneIndex::new(scene.map.clone());
    let network = backbones().unwrap().build_default("densetnt").unwrap();
    let now = Observation::of(&scene, &index).unwrap();
    let subsampled =
        |subsampling| features_with_forecast(&*network, &now, scene.adversary.unwrap(), subsampling).unwrap();
    let (full, plain) = (subsampled(Subsampling::NONE), features_of(&scene));
    assert_eq!((&full.goals, full.groups.len()), (&plain.goals, plain.groups.len()));
    let coarse = subsampled(Subsampling { max_polylines: 20, dense_goal_radius: 30.0, ..Subsampling::NONE });
    assert_eq!(coarse.groups.len(), full.agents + 20);
    assert!(coarse.goals.iter().all(|goal| full.goals.contains(goal)));
    let within = |goals: &[[f32; 2]]| goals.iter().filter(|[x, y]| x * x + y * y < 900.0).count();
    assert_eq!(within(&coarse.goals), within(&full.goals));
    let beyond = |features: &Features| (features.modes() - within(&features.goals)) as f64;
    assert!((0.4..0.6).contains(&(beyond(&coarse) / beyond(&full))));
    for (subsampling, field) in [
        (Subsampling { max_polylines: 0, ..Subsampling::NONE }, "max_polylines"),
        (Subsampling { dense_goal_radius: f32::NAN, ..Subsampling::NONE }, "dense_goal_radius"),
        (Subsampling { ego_goal_stride: 0, ..Subsampling::NONE }, "ego_goal_stride"),
    ] {
        assert!(subsampling.check().unwrap_err().to_string().contains(field));
    }
}
