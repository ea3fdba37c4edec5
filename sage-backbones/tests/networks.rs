//! Laws of every backbone, its weights and its predictions, on procedural scenes.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod fixtures;

use std::path::Path;

use candle_core::{DType, Device, Tensor};
use insta::assert_snapshot;
use sage_backbones::{
    Backbone, Parameters,
    backbone::{ParameterGroup, Shared, trajectories_in_world},
    candidates::Sampling,
    parameters::Header,
    prediction::propose,
    training::{recorded_sample, trainable},
};
use sage_core::{
    geometry::distance,
    motion::{HORIZON, NOW},
    seed::Rng,
};
use sage_data::procedural::Kind;

use fixtures::{all, features, network, scene};

const LEARNED: [&str; 4] = ["densetnt", "query-transformer", "diffusion", "densetnt-cat"];

fn numbers(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// The network's weights with noise, so that none is zero by its initialisation.
fn noisy(network: &dyn Backbone, dtype: DType) -> Parameters {
    let add_noise = |(name, tensor): (&str, &Tensor)| {
        let mut rng = Rng::new(3, name, "noise");
        let values: Vec<f64> = numbers(tensor).into_iter().map(|x| x + 0.05 * rng.normal()).collect();
        let tensor = Tensor::from_vec(values, tensor.dims(), &Device::Cpu).unwrap();
        (name.to_owned(), tensor.to_dtype(dtype).unwrap())
    };
    network.parameters().iter().map(add_noise).collect()
}

#[test]
fn probabilities_sum_to_one_and_trajectories_start_at_the_target() {
    let data = scene(Kind::FourWay);
    for network in all() {
        let encoding = network.encode(features(&*network, &data)).unwrap();
        let log_probs = numbers(&network.log_probs(&encoding).unwrap());
        let ends = network.mode_ends(&encoding).unwrap();
        assert_eq!(log_probs.len(), ends.len());
        let total: f64 = log_probs.iter().map(|p| p.exp()).sum();
        assert!((total - 1.0).abs() < 1e-5, "{}: {total}", network.name());
        let trajectories = network.trajectories(&encoding, &[0, 3]).unwrap();
        assert_eq!(trajectories.dims(), [2, HORIZON, 2]);
        if network.name() != "densetnt-cat" {
            let start = data.scene.adversary().unwrap().point(NOW);
            for trajectory in trajectories_in_world(&trajectories, encoding.features()).unwrap() {
                // A step of 4 m would be a speed of 40 m/s.
                assert!(distance(trajectory.points()[0], start) < 4.0, "{}", network.name());
            }
            let last = numbers(&trajectories.narrow(1, HORIZON - 1, 1).unwrap());
            assert!((last[2] - f64::from(ends[3][0])).abs() < 1e-3, "{}", network.name());
        }
    }
}

#[test]
fn every_parameter_that_pretraining_changes_gets_a_gradient_and_no_other_does() {
    for name in LEARNED {
        let network = network(name);
        let (parameters, variables) = noisy(&*network, DType::F32).variables(|_| true).unwrap();
        let traced = network.with_parameters(parameters).unwrap();
        let mut largest = vec![0.0_f64; variables.len()];
        for kind in [Kind::FourWay, Kind::Roundabout] {
            let data = scene(kind);
            let sample =
                recorded_sample(&data, data.scene.adversary.unwrap(), trainable(&*traced).unwrap()).unwrap();
            let store = trainable(&*traced)
                .unwrap()
                .loss(&sample, &mut Rng::new(0, "", "loss"))
                .unwrap()
                .total
                .backward()
                .unwrap();
            for (slot, (name, variable)) in variables.iter().enumerate() {
                let group = network.parameter_group(name);
                match store.get(variable).map(numbers) {
                    Some(gradient) => {
                        assert!(gradient.iter().all(|g| g.is_finite()), "{name}");
                        assert!(
                            !matches!(group, ParameterGroup::Unused | ParameterGroup::Interaction),
                            "{name} has a gradient"
                        );
                        largest[slot] = gradient.iter().fold(largest[slot], |a, g| a.max(g.abs()));
                    }
                    None => assert!(
                        matches!(group, ParameterGroup::Unused | ParameterGroup::Interaction),
                        "{name} has no gradient"
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
fn fine_tuned_parameters_get_a_gradient_and_the_interaction_head_starts_at_zero() {
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
        assert_eq!(
            numbers(&log_probs),
            numbers(&plain),
            "the output of the interaction head is zero at the start"
        );
        let store = log_probs.get(0).unwrap().backward().unwrap();
        for (name, variable) in variables.iter() {
            let gradient = numbers(store.get(variable).unwrap_or_else(|| panic!("{name} has no gradient")));
            let is_before_last =
                network.parameter_group(name) == ParameterGroup::Interaction && !name.contains(".last.");
            // The last layer is zero, so the gradients of the layers before it are zero too.
            assert!(
                is_before_last || name.ends_with("last.bias") || gradient.iter().any(|g| *g != 0.0),
                "{name}"
            );
        }
    }
}

#[test]
fn what_experts_share_does_not_depend_on_fine_tuned_parameters() {
    let data = scene(Kind::FourWay);
    for network in all() {
        let is_shared = network.shared() == Shared::Trajectories;
        let changed = noisy(&*network, DType::F32);
        let tuned = network.parameters().iter().map(|(name, own)| {
            let is_tuned = network.parameter_group(name).is_finetuned();
            (name.to_owned(), if is_tuned { changed.get(name).unwrap() } else { own }.clone())
        });
        let tuned = network.with_parameters(tuned.collect()).unwrap();
        let features = features(&*network, &data);
        let [own, other] = [&network, &tuned].map(|model| model.encode(features.clone()).unwrap());
        for (a, b) in own.states().iter().zip(other.states()) {
            assert_eq!(numbers(a), numbers(b), "{}: states", network.name());
        }
        let [a, b] = [&network, &tuned].map(|model| model.mode_ends(&own).unwrap());
        assert_eq!(a == b, is_shared, "{}: ends", network.name());
        let [a, b] = [&network, &tuned].map(|model| model.trajectories(&own, &[0, 5, 9]).unwrap());
        assert_eq!(numbers(&a) == numbers(&b), is_shared, "{}: trajectories", network.name());
        // Each network can read the other's encoding. The scores do change, so the test is not trivial.
        let [a, b] = [&own, &other].map(|encoding| numbers(&tuned.log_probs(encoding).unwrap()));
        assert_eq!(a, b);
        if is_shared && !network.parameter_specs().is_empty() {
            assert_ne!(a, numbers(&network.log_probs(&own).unwrap()), "{}", network.name());
        }
    }
}

#[test]
fn gradients_agree_with_finite_differences_in_double_precision() {
    let data = scene(Kind::TJunction);
    for name in ["densetnt", "query-transformer", "diffusion"] {
        let network = network(name);
        let weights = noisy(&*network, DType::F64);
        let sample =
            recorded_sample(&data, data.scene.adversary.unwrap(), trainable(&*network).unwrap()).unwrap();
        let total = |weights: Parameters| {
            let network = network.with_parameters(weights).unwrap();
            trainable(&*network).unwrap().loss(&sample, &mut Rng::new(0, "", "loss")).unwrap().total
        };
        let loss = |weights: Parameters| numbers(&total(weights))[0];
        let (traced, variables) =
            weights.variables(|name| network.parameter_group(name).is_pretrained()).unwrap();
        let store = total(traced).backward().unwrap();
        for (name, variable) in variables.iter() {
            // The labels of this network depend on its trajectories, but the gradient treats them as
            // constants.
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
            // Small enough that hardly any ReLU or maximum changes its branch.
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

#[test]
fn an_encoding_of_another_network_is_refused() {
    let data = scene(Kind::Curve);
    let [ours, other] = ["densetnt", "lane-graph"].map(network);
    let foreign = other.encode(features(&*other, &data)).unwrap();
    assert_snapshot!(ours.log_probs(&foreign).unwrap_err(), @"this encoding was computed by another network, `lane-graph`; encode the features again");
}

#[test]
fn weights_that_do_not_fit_are_refused_with_every_mismatch() {
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
    let other = fixtures::network("query-transformer");
    assert!(other.load_parameters(network.parameters().clone(), "`here`").is_err());
}

#[test]
fn files_of_weights_load_unchanged_and_broken_ones_are_refused() {
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
    assert_snapshot!(Parameters::from_bytes(&plain, Path::new("plain")).unwrap_err(), @"`plain`: has no `sage` header, which says what network its tensors belong to");
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
    for selection in [Sampling::TopK, Sampling::Nms { radius: 4.0 }] {
        assert_eq!(modes(selection, 1), modes(selection, 2));
    }
    assert_eq!(modes(Sampling::Gumbel, 1), modes(Sampling::Gumbel, 1));
    assert_ne!(modes(Sampling::Gumbel, 1), modes(Sampling::Gumbel, 2));
}
