//! The `densetnt-cat` network against the results of the published modules.
//!
//! `tests/data/densetnt_synthetic.safetensors` holds results of CAT's modules (PyTorch, f32) on synthetic
//! inputs: random weights, no real scene, no published weights. With `SAGE_REFERENCE` and `SAGE_DATA` set,
//! the same is tested on the features of three recorded scenes, which are not part of this project.
//! Tolerances: a second implementation in f64 differs from the recorded values by 2e-6 in states, 1e-5 in
//! log-probabilities and 2e-6 in losses. Ours works in f32 with other orders of summation, so its tolerances
//! are ten times larger.
#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

use std::{collections::HashMap, path::Path, sync::Arc};

use approx::assert_abs_diff_eq;
use candle_core::{DType, Device, Tensor};
use sage_backbones::{
    Backbone, MotionModel, Parameters, Trainable,
    backbone::{Loss, ParameterGroup, Sample, trajectories_in_world},
    candidates::{Sampling, ranked, suppressed},
    densetnt::{Cat, DenseTnt},
    encoding::Encoding,
    features::{AgentForecasts, EdgeGrid, EdgeKinds, Features, Frame, Layout, Table, cat},
    nn::AdamWConfig,
    training::Trainer,
};
use sage_core::seed::Rng;

struct Fixture(HashMap<String, Tensor>);

impl Fixture {
    fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        Self(candle_core::safetensors::load_buffer(&bytes, &Device::Cpu).unwrap())
    }

    fn synthetic() -> Self {
        Self::read(Path::new("tests/data/densetnt_synthetic.safetensors"))
    }

    fn tensor(&self, name: &str) -> &Tensor {
        self.0.get(name).unwrap_or_else(|| panic!("no `{name}` in the fixture"))
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        numbers(self.tensor(name))
    }

    fn integers(&self, name: &str) -> Vec<usize> {
        self.numbers(name).into_iter().map(|x| x as usize).collect()
    }

    fn points(&self, name: &str) -> Vec<[f32; 2]> {
        self.numbers(name).as_chunks::<2>().0.iter().map(|p| p.map(|x| x as f32)).collect()
    }

    fn network(&self) -> DenseTnt {
        let weights: Parameters = self
            .0
            .iter()
            .filter_map(|(name, tensor)| Some((name.strip_prefix("weights/")?.to_owned(), tensor.clone())))
            .collect();
        Cat::with_weights(weights, "the fixture").unwrap()
    }

    fn rows(&self, prefix: &str) -> (Table, Vec<usize>) {
        let values = self.numbers(&format!("{prefix}matrix")).into_iter().map(|x| x as f32).collect();
        let spans = self.integers(&format!("{prefix}spans"));
        let lengths = spans.as_chunks::<2>().0.iter().map(|[start, end]| end - start).collect();
        (Table { columns: 128, values }, lengths)
    }

    /// Features as recorded, padded as in a batch whose longest polyline has `longest` rows.
    fn features(&self, prefix: &str, goals: Vec<[f32; 2]>, longest: Option<usize>) -> Arc<Features> {
        let (rows, lengths) = self.rows(prefix);
        let own = lengths.iter().copied().max().unwrap();
        let (vectors, groups) = cat::with_padding_row(&rows, &lengths, longest.unwrap_or(own));
        // The small context of the synthetic file has the frame and the speed of the large one.
        let normalizer = self.0.get(&format!("{prefix}normalizer"));
        let [x, y, angle] =
            numbers(normalizer.unwrap_or_else(|| self.tensor("syn/normalizer"))).try_into().unwrap();
        let frame = Frame::new([x, y], -angle);
        let speed = self.0.get(&format!("{prefix}speed")).map_or(7.5, |speed| numbers(speed)[0]);
        Arc::new(Features {
            layout: Layout::Published,
            frame,
            velocity: [0.0, speed as f32],
            vectors,
            groups,
            agents: self.integers(&format!("{prefix}map_start"))[0],
            goal_features: Table { columns: 2, values: goals.iter().flatten().copied().collect() },
            goals,
            half: [0.0; 2],
            agent_forecasts: AgentForecasts::default(),
            edges: Arc::new(EdgeGrid::empty()),
            edge_kinds: EdgeKinds::default(),
            has_lanes: true,
            label: None,
        })
    }

    fn sample(&self, prefix: &str, features: Arc<Features>) -> Sample {
        Sample {
            features,
            future: self.points(&format!("{prefix}labels")),
            valid: match self.0.get(&format!("{prefix}labels_valid")) {
                Some(valid) => numbers(valid).into_iter().map(|v| v == 1.0).collect(),
                None => vec![true; 80],
            },
        }
    }
}

fn numbers(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

fn close(what: &str, found: &Tensor, expected: &[f64], tolerance: f64) {
    let found = numbers(found);
    assert_eq!(found.len(), expected.len(), "{what}");
    let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst <= tolerance, "{what}: off by {worst:e}, expected {tolerance:e} at most");
}

/// Checks states, log-probabilities, both selections and their trajectories.
fn check(fixture: &Fixture, network: &DenseTnt, encoding: &Encoding, prefix: &str) {
    let [elements, _, _, polylines, graph] = encoding.states() else { panic!("five states") };
    close("sub_graph", polylines, &fixture.numbers(&format!("{prefix}sub_graph")), 2e-5);
    close("lane_attended", elements, &fixture.numbers(&format!("{prefix}lane_attended")), 2e-5);
    close("hidden", graph, &fixture.numbers(&format!("{prefix}hidden")), 2e-5);
    check_goals(fixture, network, encoding, prefix);
}

fn check_goals(fixture: &Fixture, network: &DenseTnt, encoding: &Encoding, prefix: &str) {
    let log_probs = network.log_probs(encoding).unwrap();
    close("goal_logprob", &log_probs, &fixture.numbers(&format!("{prefix}goal_logprob")), 1e-4);
    let log_probs: Vec<f32> = log_probs.to_vec1().unwrap();
    let features = encoding.features();
    for kind in ["topk", "nms"] {
        let name = |field: &str| format!("{prefix}{kind}/{field}");
        if !fixture.0.contains_key(&name("index")) {
            continue;
        }
        let expected = fixture.integers(&name("index"));
        let order = ranked(&log_probs);
        let selected = match kind {
            "topk" => order[..expected.len()].to_vec(),
            _ => {
                suppressed(&order, &features.goals, expected.len(), cat::suppression_radius(features.speed()))
            }
        };
        let recorded = fixture.numbers(&name("logprob"));
        for (k, (&found, &index)) in selected.iter().zip(&expected).enumerate() {
            assert_abs_diff_eq!(f64::from(log_probs[found]), recorded[k], epsilon = 1e-4);
            let tie = |other: Option<&f64>| other.is_some_and(|p| (p - recorded[k]).abs() < 1e-4);
            let tied = tie(recorded.get(k + 1)) || (k > 0 && tie(recorded.get(k - 1)));
            // After a tie at any earlier rank, suppression may select other goals.
            if kind == "topk" && !tied && k + 1 < expected.len() {
                assert_eq!(found, index, "{prefix}{kind}, rank {k}");
            }
        }
        if kind == "nms" {
            let same = selected.iter().zip(&expected).filter(|(a, b)| a == b).count();
            assert!(same + 2 >= expected.len(), "{prefix}nms: {same} of {} goals agree", expected.len());
        }
        let trajectories = network.trajectories(encoding, &expected).unwrap();
        close(kind, &trajectories, &fixture.numbers(&name("traj_local")), 1e-4);
        if fixture.0.contains_key(&name("traj_world")) {
            let world = trajectories_in_world(&trajectories, features).unwrap();
            let recorded = fixture.numbers(&name("traj_world"));
            let found = world.iter().flat_map(|trajectory| trajectory.points().iter().flatten());
            for (a, b) in found.zip(&recorded) {
                assert_abs_diff_eq!(a, b, epsilon = 1e-4);
            }
        }
    }
}

fn check_loss(fixture: &Fixture, network: &DenseTnt, sample: &Sample, prefix: &str) {
    let trainer = Trainer::new(network, |_| true, AdamWConfig::default()).unwrap();
    let Loss { total, parts } =
        trainer.trainable().unwrap().loss(sample, &mut Rng::new(0, "", "loss")).unwrap();
    assert_abs_diff_eq!(
        numbers(&total)[0],
        fixture.numbers(&format!("{prefix}loss/total"))[0],
        epsilon = 1e-4
    );
    if let Some(recorded) = fixture.0.get(&format!("{prefix}loss/classification")) {
        assert_abs_diff_eq!(parts[0].1, numbers(recorded)[0], epsilon = 1e-4);
    }
    let store = total.backward().unwrap();
    for (name, variable) in trainer.variables().iter() {
        let recorded = fixture.numbers(&format!("{prefix}loss/grad_norm/{name}"))[0];
        let gradient = store.get(variable).map(numbers);
        let norm = gradient.as_ref().map_or(0.0, |g| g.iter().map(|x| x * x).sum::<f64>().sqrt());
        let off = (norm - recorded).abs();
        assert!(
            off <= 1e-5 || off <= 1e-3 * recorded,
            "{prefix}{name}: gradient {norm}, recorded {recorded}"
        );
        match network.parameter_group(name) {
            ParameterGroup::Unused => assert!(gradient.is_none() && recorded == 0.0, "{name} is not unused"),
            ParameterGroup::WithoutEffect => assert!(norm < 1e-4, "{name} has a gradient of {norm}"),
            _ => assert!(norm > 1e-6, "{name} has no gradient"),
        }
        if let (Some(gradient), Some(recorded)) =
            (gradient, fixture.0.get(&format!("{prefix}loss/grad/{name}")))
        {
            let recorded = numbers(recorded);
            let scale = recorded.iter().fold(1e-2, |a: f64, b| a.max(b.abs()));
            for (a, b) in gradient.iter().zip(&recorded) {
                assert!((a - b).abs() <= 1e-3 * scale, "{prefix}{name}: {a} against {b}");
            }
        }
    }
}

#[test]
fn synthetic_inputs_give_the_published_states_goals_and_trajectories() {
    let fixture = Fixture::synthetic();
    let network = fixture.network();
    let goals = fixture.points("goals_2D");
    for prefix in ["syn/", "small/"] {
        let encoding = network.encode(fixture.features(prefix, goals.clone(), None)).unwrap();
        check(&fixture, &network, &encoding, prefix);
    }
}

#[test]
fn a_small_target_in_a_batch_attends_to_padding_as_published() {
    let fixture = Fixture::synthetic();
    let network = fixture.network();
    let features = fixture.features("small/", fixture.points("goals_2D"), Some(20));
    let encoding = network.encode_padded(&features, 13).unwrap();
    check(&fixture, &network, &encoding, "batch/");
}

#[test]
fn the_loss_and_the_gradient_of_every_parameter_are_the_published_ones() {
    let fixture = Fixture::synthetic();
    let features = fixture.features("syn/", fixture.points("goals_2D"), None);
    check_loss(&fixture, &fixture.network(), &fixture.sample("syn/", features), "syn/");
}

#[test]
fn three_steps_of_adamw_give_the_published_parameters() {
    let fixture = Fixture::synthetic();
    let features = fixture.features("syn/", fixture.points("goals_2D"), None);
    let sample = fixture.sample("syn/", features);
    let network = fixture.network();
    // PyTorch does not update parameters without gradient.
    let mut trainer = Trainer::new(
        &network,
        |name| network.parameter_group(name) != ParameterGroup::Unused,
        AdamWConfig::default(),
    )
    .unwrap();
    for expected in fixture.numbers("syn/adamw/losses") {
        let loss = trainer.trainable().unwrap().loss(&sample, &mut Rng::new(0, "", "loss")).unwrap();
        assert_abs_diff_eq!(numbers(&loss.total)[0], expected, epsilon = 1e-3);
        let gradient = trainer.gradient(&loss, "syn").unwrap();
        if trainer.adam.steps < 3 {
            trainer.update(&[gradient], 1e-3, f64::INFINITY).unwrap();
        }
    }
    let mut compared = 0;
    for (name, variable) in trainer.variables().iter() {
        if let Some(expected) = fixture.0.get(&format!("syn/adamw/after3/{name}")) {
            close(name, variable, &numbers(expected), 2e-4);
            compared += 1;
        }
    }
    assert_eq!(compared, 3);
}

#[test]
fn gradients_agree_with_finite_differences_in_double_precision() {
    let fixture = Fixture::synthetic();
    let features = fixture.features("syn/", fixture.points("goals_2D"), None);
    let sample = fixture.sample("syn/", features);
    let network = fixture.network();
    let weights = network.parameters().to_dtype(DType::F64).unwrap();
    let loss = |weights: Parameters| {
        numbers(
            &Cat::with_weights(weights, "")
                .unwrap()
                .loss(&sample, &mut Rng::new(0, "", "loss"))
                .unwrap()
                .total,
        )[0]
    };
    let (traced, variables) = weights.variables(|_| true).unwrap();
    let total =
        Cat::with_weights(traced, "").unwrap().loss(&sample, &mut Rng::new(0, "", "loss")).unwrap().total;
    let store = total.backward().unwrap();
    for (name, variable) in variables.iter() {
        let mut rng = Rng::new(1, name, "direction");
        let direction: Vec<f64> = (0..variable.elem_count()).map(|_| rng.normal()).collect();
        let along = |step: f64| {
            let moved =
                numbers(variable).iter().zip(&direction).map(|(x, d)| x + step * d).collect::<Vec<_>>();
            let mut weights = weights.clone();
            weights.insert(name, Tensor::from_vec(moved, variable.dims(), &Device::Cpu).unwrap());
            loss(weights)
        };
        // Small enough that hardly any of 100 000 ReLUs changes its branch.
        let step = 1e-8;
        let difference = (along(step) - along(-step)) / (2.0 * step);
        let slope =
            store.get(variable).map_or(0.0, |g| numbers(g).iter().zip(&direction).map(|(g, d)| g * d).sum());
        assert!(
            (slope - difference).abs() <= 1e-5 * (1.0 + slope.abs()),
            "{name}: {slope} against {difference}"
        );
    }
}

#[test]
fn suppression_selects_all_goals_if_they_are_too_few() {
    let fixture = Fixture::synthetic();
    let network = fixture.network();
    let goals = fixture.points("goals_2D")[..20].to_vec();
    let features = fixture.features("syn/", goals, None);
    let mut rng = Rng::new(0, "", "");
    let nms = Sampling::Nms { radius: 500.0 };
    let all = sage_backbones::prediction::predict(&network, features, 32, nms, &mut rng).unwrap();
    assert_eq!(all.len(), 20);
}

/// The fixture of recorded scenes, if its folder is available.
fn recorded() -> Option<Fixture> {
    let Some(folder) = std::env::var_os("SAGE_REFERENCE") else {
        eprintln!("left out: SAGE_REFERENCE is not set");
        return None;
    };
    Some(Fixture::read(&Path::new(&folder).join("fixtures/densetnt_vector.safetensors")))
}

const SCENES: [usize; 3] = [0, 5, 18];

#[test]
fn recorded_inputs_give_the_published_states_goals_and_trajectories() {
    let Some(fixture) = recorded() else { return };
    let network = fixture.network();
    let goals = fixture.points("goals_2D");
    assert_eq!(goals, cat::lattice());
    let coarse: Vec<[f32; 2]> = fixture.integers("coarse_index").into_iter().map(|k| goals[k]).collect();
    for scene in SCENES {
        let prefix = format!("scene{scene}/");
        let features = fixture.features(&prefix, goals.clone(), None);
        let encoding = network.encode(features.clone()).unwrap();
        check(&fixture, &network, &encoding, &prefix);
        check_loss(&fixture, &network, &fixture.sample(&prefix, features), &prefix);
        let coarse = fixture.features(&prefix, coarse.clone(), None);
        check_goals(&fixture, &network, &network.encode(coarse).unwrap(), &format!("{prefix}coarse/"));
    }
}

#[test]
fn a_pair_in_one_batch_gives_the_published_states_of_the_adversary() {
    let Some(fixture) = recorded() else { return };
    let network = fixture.network();
    for scene in SCENES {
        let prefix = format!("scene{scene}/");
        let (_, ego) = fixture.rows(&format!("{prefix}pair/ego_"));
        let (_, own) = fixture.rows(&prefix);
        let longest = own.iter().chain(&ego).copied().max();
        let features = fixture.features(&prefix, cat::lattice(), longest);
        let padding = ego.len().saturating_sub(own.len());
        let encoding = network.encode_padded(&features, padding).unwrap();
        check(&fixture, &network, &encoding, &format!("{prefix}pair/adv_"));
    }
}

#[test]
fn recorded_scenes_give_the_published_features() {
    let (Some(fixture), Some(data)) = (recorded(), std::env::var_os("SAGE_DATA")) else {
        eprintln!("left out: SAGE_DATA or SAGE_REFERENCE is not set");
        return;
    };
    for number in SCENES {
        let path = Path::new(&data).join(format!("pretrain/{number}.pkl"));
        let scene = sage_data::Recording::read(&path).unwrap().scene;
        for (prefix, target) in [
            (format!("scene{number}/"), scene.adversary.unwrap()),
            (format!("scene{number}/pair/ego_"), scene.ego),
        ] {
            let features = cat::features(&scene, target).unwrap();
            let expected = fixture.features(&prefix, cat::lattice(), None);
            assert_eq!(features.agents, expected.agents, "{prefix}");
            assert_eq!(features.groups.len(), expected.groups.len(), "{prefix}");
            assert_eq!(features.groups, expected.groups, "{prefix}");
            assert_eq!(features.goals, expected.goals);
            let pairs = features.vectors.values.iter().zip(&expected.vectors.values);
            let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < 1e-4, "{prefix}: off by {worst}");
            assert_abs_diff_eq!(features.speed(), expected.speed(), epsilon = 1e-4);
            let [a, b] = [features.frame, expected.frame].map(|frame| frame.world_from_frame([30.0, 40.0]));
            assert_abs_diff_eq!(a[0], b[0], epsilon = 1e-3);
            assert_abs_diff_eq!(a[1], b[1], epsilon = 1e-3);
        }
    }
}
