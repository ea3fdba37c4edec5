//! What must hold for every backbone, and for features, on procedural scenes.
#![allow(clippy::unwrap_used)]

use std::{path::Path, sync::Arc};

use candle_core::{DType, Device, Tensor};
use sage_backbones::{
    Backbone, Parameters,
    backbone::{ParameterGroup, to_world},
    backbones,
    candidates::Selection,
    features::{Features, GOAL_COLUMNS, VECTOR_COLUMNS},
    parameters::Header,
    prediction::{predict, propose},
    training::{Examples, SceneData, recorded_sample, trainable},
};
use sage_core::{
    generator::Observation,
    geometry::distance,
    motion::{HORIZON, NOW},
    scene::{Map, Scene, SceneIndex},
    seed::Rng,
};
use sage_data::procedural::{Kind, generate};

const LEARNED: [&str; 3] = ["densetnt", "query-transformer", "densetnt-cat"];

fn network(name: &str) -> Box<dyn Backbone> {
    backbones().unwrap().build_default(name).unwrap()
}

fn all() -> Vec<Box<dyn Backbone>> {
    backbones().unwrap().entries().iter().map(|entry| network(entry.name)).collect()
}

fn scene(kind: Kind) -> SceneData {
    let scene = generate(kind, 5, 1).unwrap();
    SceneData::new(scene.id.clone(), scene)
}

fn features(network: &dyn Backbone, data: &SceneData) -> Arc<Features> {
    let target = data.scene.adversary.unwrap();
    Arc::new(network.features(&data.observe().unwrap(), target, None).unwrap())
}

fn numbers(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// The same weights with noise on them, so that nothing is zero by its start.
fn stirred(network: &dyn Backbone, dtype: DType) -> Parameters {
    let stir = |(name, tensor): (&str, &Tensor)| {
        let mut rng = Rng::new(3, name, "noise");
        let values: Vec<f64> = numbers(tensor).into_iter().map(|x| x + 0.05 * rng.normal()).collect();
        let tensor = Tensor::from_vec(values, tensor.dims(), &Device::Cpu).unwrap();
        (name.to_owned(), tensor.to_dtype(dtype).unwrap())
    };
    network.parameters().iter().map(stir).collect()
}

#[test]
fn probabilities_sum_to_one_and_paths_start_at_the_target() {
    let data = scene(Kind::FourWay);
    for network in all() {
        let encoding = network.encode(features(&*network, &data)).unwrap();
        let log_probs = numbers(&network.log_probs(&encoding).unwrap());
        let ends = network.mode_ends(&encoding).unwrap();
        assert_eq!(log_probs.len(), ends.len());
        let total: f64 = log_probs.iter().map(|p| p.exp()).sum();
        assert!((total - 1.0).abs() < 1e-5, "{}: {total}", network.name());
        let paths = network.trajectories(&encoding, &[0, 3]).unwrap();
        assert_eq!(paths.dims(), [2, HORIZON, 2]);
        if network.name() != "densetnt-cat" {
            let start = data.scene.adversary().unwrap().point(NOW);
            for path in to_world(&paths, encoding.features()).unwrap() {
                // Nothing drives 40 m/s.
                assert!(distance(path.points()[0], start) < 4.0, "{}", network.name());
            }
            let last = numbers(&paths.narrow(1, HORIZON - 1, 1).unwrap());
            assert!((last[2] - f64::from(ends[3][0])).abs() < 1e-3, "{}", network.name());
        }
    }
}

#[test]
fn every_parameter_that_pretraining_moves_gets_a_gradient_and_no_other_does() {
    for name in LEARNED {
        let network = network(name);
        let (parameters, variables) = stirred(&*network, DType::F32).variables(|_| true).unwrap();
        let traced = network.with_parameters(parameters).unwrap();
        let mut largest = vec![0.0_f64; variables.len()];
        for kind in [Kind::FourWay, Kind::Roundabout] {
            let data = scene(kind);
            let sample =
                recorded_sample(&data, data.scene.adversary.unwrap(), trainable(&*traced).unwrap()).unwrap();
            let store = trainable(&*traced).unwrap().loss(&sample).unwrap().total.backward().unwrap();
            for (slot, (name, variable)) in variables.iter().enumerate() {
                let role = network.parameter_group(name);
                match store.get(variable).map(numbers) {
                    Some(gradient) => {
                        assert!(gradient.iter().all(|g| g.is_finite()), "{name}");
                        assert!(
                            !matches!(role, ParameterGroup::Unused | ParameterGroup::Interaction),
                            "{name} is reached"
                        );
                        largest[slot] = gradient.iter().fold(largest[slot], |a, g| a.max(g.abs()));
                    }
                    None => assert!(
                        matches!(role, ParameterGroup::Unused | ParameterGroup::Interaction),
                        "{name} is not reached"
                    ),
                }
            }
        }
        for ((name, _), largest) in variables.iter().zip(largest) {
            match network.parameter_group(name) {
                ParameterGroup::Prior | ParameterGroup::Scoring => {
                    assert!(largest > 1e-9, "{name}: {largest}")
                }
                ParameterGroup::WithoutEffect => assert!(largest < 1e-5, "{name}: {largest}"),
                ParameterGroup::Interaction | ParameterGroup::Unused => {}
            }
        }
    }
}

#[test]
fn fine_tuning_reaches_what_it_moves_and_the_prior_is_silent_about_the_ego() {
    let data = scene(Kind::FourWay);
    for name in ["densetnt", "query-transformer"] {
        let network = network(name);
        let (parameters, variables) =
            network.parameters().variables(|name| network.parameter_group(name).is_finetuned()).unwrap();
        let traced = network.with_parameters(parameters).unwrap();
        let features = features(&*network, &data);
        let encoding = traced.encode(features.clone()).unwrap();
        let log_probs = traced.log_probs(&encoding).unwrap();
        let plain = network.log_probs(&network.encode(features).unwrap()).unwrap();
        assert_eq!(numbers(&log_probs), numbers(&plain), "the branch adds nothing at the start");
        let store = log_probs.get(0).unwrap().backward().unwrap();
        for (name, variable) in variables.iter() {
            let gradient = numbers(store.get(variable).unwrap_or_else(|| panic!("{name} is not reached")));
            let is_behind =
                network.parameter_group(name) == ParameterGroup::Interaction && !name.contains(".last.");
            // A zero last layer lets nothing through to the layers before it.
            assert!(is_behind || name.ends_with("last.bias") || gradient.iter().any(|g| *g != 0.0), "{name}");
        }
    }
}

#[test]
fn encodings_and_trajectories_stay_valid_while_what_fine_tuning_moves_changes() {
    let data = scene(Kind::FourWay);
    for network in all() {
        let noisy = stirred(&*network, DType::F32);
        let tuned = network.parameters().iter().map(|(name, own)| {
            let moved = network.parameter_group(name).is_finetuned();
            (name.to_owned(), if moved { noisy.get(name).unwrap() } else { own }.clone())
        });
        let tuned = network.with_parameters(tuned.collect()).unwrap();
        let features = features(&*network, &data);
        let [own, other] = [&network, &tuned].map(|model| model.encode(features.clone()).unwrap());
        for (a, b) in own.states().iter().zip(other.states()) {
            assert_eq!(numbers(a), numbers(b), "{}: states", network.name());
        }
        assert_eq!(network.mode_ends(&own).unwrap(), tuned.mode_ends(&own).unwrap());
        let [a, b] = [&network, &tuned].map(|model| model.trajectories(&own, &[0, 5, 9]).unwrap());
        assert_eq!(numbers(&a), numbers(&b), "{}: trajectories", network.name());
        // An encoding of one is one of the other, and the law says something: scores do change.
        let [a, b] = [&own, &other].map(|encoding| numbers(&tuned.log_probs(encoding).unwrap()));
        assert_eq!(a, b);
        if !network.parameter_specs().is_empty() {
            assert_ne!(a, numbers(&network.log_probs(&own).unwrap()), "{}", network.name());
        }
    }
}

#[test]
fn gradients_agree_with_finite_differences_in_double_precision() {
    let data = scene(Kind::TJunction);
    for name in ["densetnt", "query-transformer"] {
        let network = network(name);
        let weights = stirred(&*network, DType::F64);
        let sample =
            recorded_sample(&data, data.scene.adversary.unwrap(), trainable(&*network).unwrap()).unwrap();
        let total = |weights: Parameters| {
            let network = network.with_parameters(weights).unwrap();
            trainable(&*network).unwrap().loss(&sample).unwrap().total
        };
        let loss = |weights: Parameters| numbers(&total(weights))[0];
        let (traced, variables) =
            weights.variables(|name| network.parameter_group(name).is_pretrained()).unwrap();
        let store = total(traced).backward().unwrap();
        for (name, variable) in variables.iter() {
            // The second network's labels follow its paths and count as given: what moves the paths
            // moves them too.
            if network.name() == "query-transformer" && network.parameter_group(name) == ParameterGroup::Prior
            {
                continue;
            }
            let mut rng = Rng::new(1, name, "direction");
            let direction: Vec<f64> = (0..variable.elem_count()).map(|_| rng.normal()).collect();
            let along = |step: f64| {
                let moved: Vec<f64> =
                    numbers(variable).iter().zip(&direction).map(|(x, d)| x + step * d).collect();
                let mut weights = weights.clone();
                weights.insert(name, Tensor::from_vec(moved, variable.dims(), &Device::Cpu).unwrap());
                loss(weights)
            };
            // Small enough that hardly any ReLU or maximum changes sides on the way.
            let step = 1e-8;
            let difference = (along(step) - along(-step)) / (2.0 * step);
            let slope: f64 =
                numbers(store.get(variable).unwrap()).iter().zip(&direction).map(|(g, d)| g * d).sum();
            assert!(
                (slope - difference).abs() <= 2e-5 * (1.0 + slope.abs()),
                "{name}: {slope} against {difference}"
            );
        }
    }
}

/// The scene turned by an angle and moved.
fn moved(scene: &Scene, angle: f64, by: [f64; 2]) -> Scene {
    let (sin, cos) = angle.sin_cos();
    let turn = |[x, y]: [f64; 2]| [cos * x - sin * y, sin * x + cos * y];
    let place = |[x, y, z]: [f64; 3]| {
        let [x, y] = turn([x, y]);
        [x + by[0], y + by[1], z]
    };
    change(scene, place, turn, |heading| heading + angle)
}

/// The scene with left and right exchanged.
fn mirrored(scene: &Scene) -> Scene {
    change(scene, |[x, y, z]| [x, -y, z], |[x, y]| [x, -y], |heading| -heading)
}

fn change(
    scene: &Scene,
    place: impl Fn([f64; 3]) -> [f64; 3],
    turn: impl Fn([f64; 2]) -> [f64; 2],
    head: impl Fn(f64) -> f64,
) -> Scene {
    let mut scene = scene.clone();
    for track in &mut scene.tracks {
        track.position.iter_mut().for_each(|p| *p = place(*p));
        track.velocity.iter_mut().for_each(|v| *v = turn(*v));
        track.heading.iter_mut().for_each(|h| *h = head(*h));
    }
    for light in &mut scene.lights {
        light.stop_point = light.stop_point.map(&place);
    }
    let mut map = (*scene.map).clone();
    map.points.iter_mut().for_each(|p| *p = place(*p));
    scene.map = Arc::new(map);
    scene
}

fn look(scene: &Scene) -> Features {
    let now = Observation::of(scene, &SceneIndex::new(scene.map.clone())).unwrap();
    Features::of(&now, scene.adversary.unwrap(), None).unwrap()
}

fn share_that_agrees(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    let same = a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() < 1e-3).count();
    same as f64 / a.len() as f64
}

#[test]
fn features_do_not_depend_on_where_the_world_lies() {
    for kind in Kind::ALL {
        let plain = generate(kind, 5, 2).unwrap();
        let [a, b] = [look(&plain), look(&moved(&plain, 1.1, [3000.0, -500.0]))];
        assert_eq!(a.groups, b.groups);
        // A goal on the rim of a lane or of the region can fall to either side.
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
        let [a, b] = [look(&plain).mirrored(), look(&mirrored(&plain))];
        assert_eq!(a.groups, b.groups);
        assert!(share_that_agrees(&a.vectors.values, &b.vectors.values) > 0.999);
        // Goals come in another order.
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
        // Where two lanes are equally near, either may be taken.
        assert!(agree as f64 > 0.95 * common.len() as f64, "{kind:?}: {agree} of {}", common.len());
    }
}

#[test]
fn features_use_nothing_of_the_future() {
    let plain = generate(Kind::Merge, 5, 4).unwrap();
    let mut forgetful = plain.clone();
    for track in &mut forgetful.tracks {
        for f in NOW + 1..plain.frames {
            track.valid[f] = false;
            track.position[f] = [0.0; 3];
            track.velocity[f] = [0.0; 2];
            track.heading[f] = 0.0;
        }
    }
    for light in &mut forgetful.lights {
        light.states.truncate(NOW + 1);
    }
    let [a, b] = [look(&plain), look(&forgetful)];
    assert_eq!(a.vectors, b.vectors);
    assert_eq!(a.goal_features, b.goal_features);
    assert_eq!((a.vectors.columns, a.goal_features.columns), (VECTOR_COLUMNS, GOAL_COLUMNS));
}

#[test]
fn lanes_beside_are_reached_where_a_source_lists_ids_alone() {
    let mut scene = generate(Kind::Straight, 5, 2).unwrap();
    let plain = look(&scene);
    let mut map = (*scene.map).clone();
    for lane in map.features.iter_mut().filter_map(|f| f.lane.as_mut()) {
        for neighbor in lane.neighbors.iter_mut().flatten() {
            (neighbor.own, neighbor.other) = ([0, 0], [0, 0]);
        }
    }
    scene.map = Arc::new(map);
    let reached = |f: &Features| (0..f.modes()).filter(|&k| f.goal_features.row(k)[16] > 0.0).count();
    let bare = reached(&look(&scene));
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
        let found = predict(&*network, features, 32, Selection::TopK, &mut Rng::new(0, "", "")).unwrap();
        assert_eq!(found.len(), 32, "{}", network.name());
    }
}

#[test]
fn absurd_speeds_and_maps_cost_no_more_than_plain_ones() {
    let mut scene = generate(Kind::Straight, 5, 6).unwrap();
    let target = scene.adversary.unwrap();
    scene.tracks[target].velocity[NOW] = [9e7, -9e7];
    let mut map = (*scene.map).clone();
    map.points.iter_mut().step_by(3).for_each(|p| p[0] += 9e7);
    map.features.iter_mut().filter_map(|f| f.lane.as_mut()).for_each(|lane| lane.speed_limit = Some(1e300));
    scene.map = Arc::new(map);
    let data = SceneData::new("absurd", scene);
    let features = features(&*network("densetnt"), &data);
    assert!(features.modes() <= 4096);
    assert!(features.vectors.values.iter().chain(&features.goal_features.values).all(|x| x.is_finite()));
    for network in all() {
        let features = self::features(&*network, &data);
        predict(&*network, features, 6, Selection::TopK, &mut Rng::new(0, "", "")).unwrap();
    }
}

#[test]
fn an_agent_that_is_not_there_now_is_refused_by_name() {
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

#[test]
fn an_encoding_of_another_network_is_refused() {
    let data = scene(Kind::Curve);
    let [ours, other] = ["densetnt", "lane-graph"].map(network);
    let foreign = other.encode(features(&*other, &data)).unwrap();
    let error = ours.log_probs(&foreign).unwrap_err().to_string();
    assert!(error.contains("made by another network"), "{error}");
}

#[test]
fn weights_that_do_not_fit_are_refused_with_every_tensor_at_fault() {
    let network = network("densetnt");
    let mut weights = network.parameters().clone();
    let zeros = |shape: &[usize]| Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
    weights.insert("decoder.tnt_decoder.fc.bias", zeros(&[7]));
    weights.insert("surplus.weight", zeros(&[2, 3]));
    let weights: Parameters = weights
        .iter()
        .filter(|(name, _)| *name != "rounds.0.mlp.linear.bias")
        .map(|(name, tensor)| (name.to_owned(), tensor.clone()))
        .collect();
    let error = network.load_parameters(weights, "`here`").err().unwrap().to_string();
    assert_eq!(
        error,
        "`here`: tensor `decoder.tnt_decoder.fc.bias` is [7], expected [18]; \
         tensor `rounds.0.mlp.linear.bias` [64] is missing; \
         tensor `surplus.weight` [2, 3] is not part of this network"
    );
    let other = backbones().unwrap().build_default("query-transformer").unwrap();
    assert!(other.load_parameters(network.parameters().clone(), "`here`").is_err());
}

#[test]
fn files_of_weights_survive_the_way_and_broken_ones_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("prior.safetensors");
    let network = network("query-transformer");
    let header = Header {
        backbone: network.name().to_owned(),
        options: network.options().clone(),
        license: "none".to_owned(),
        ..Header::default()
    };
    network.parameters().save(&header, &path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(network.parameters().to_bytes(&header).unwrap(), bytes, "equal weights are equal bytes");
    let (weights, found) = Parameters::load(&path).unwrap();
    assert_eq!(found, header);
    assert_eq!(weights.hash().unwrap(), network.parameters().hash().unwrap());
    assert_eq!(weights.to_bytes(&header).unwrap(), bytes);
    for cut in [0, 5, 100, bytes.len() / 2, bytes.len() - 1] {
        let error = Parameters::from_bytes(&bytes[..cut], &path).unwrap_err().to_string();
        assert!(error.contains("prior.safetensors") && error.contains("no whole file of weights"), "{error}");
    }
    let plain =
        safetensors::serialize([("a", &Tensor::zeros(2, DType::F32, &Device::Cpu).unwrap())], None).unwrap();
    let error = Parameters::from_bytes(&plain, Path::new("plain")).unwrap_err().to_string();
    assert!(error.contains("`plain`: has no `sage` header"), "{error}");
    assert!(
        Parameters::load(Path::new("nowhere")).unwrap_err().to_string().starts_with("cannot read `nowhere`")
    );
}

#[test]
fn predictions_repeat_and_only_the_draw_depends_on_the_seed() {
    let data = scene(Kind::FourWay);
    let network = network("densetnt");
    let encoding = network.encode(features(&*network, &data)).unwrap();
    let modes = |selection, seed| {
        let found = propose(&*network, &encoding, 32, selection, &mut Rng::new(seed, "a", "b")).unwrap();
        assert!(found.windows(2).all(|w| w[0].log_prob >= w[1].log_prob));
        found.into_iter().map(|p| p.mode).collect::<Vec<_>>()
    };
    for selection in [Selection::TopK, Selection::Nms { radius: 4.0 }] {
        assert_eq!(modes(selection, 1), modes(selection, 2));
    }
    assert_eq!(modes(Selection::Gumbel, 1), modes(Selection::Gumbel, 1));
    assert_ne!(modes(Selection::Gumbel, 1), modes(Selection::Gumbel, 2));
}
