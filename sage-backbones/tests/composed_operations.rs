//! The operations for other devices than the CPU, taken on the CPU: predictions, losses and gradients of whole networks.
//!
//! A program of its own, for what [`compose_on_cpu`] turns on stays on.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod fixtures;

use candle_core::{DType, Device, Tensor};
use sage_backbones::{
    Backbone,
    nn::compose_on_cpu,
    training::{recorded_sample, trainable},
};
use sage_core::seed::Rng;
use sage_data::procedural::Kind;

use fixtures::{features, network, scene};

fn numbers(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// The network in double precision, with noise, so that no layer is without effect.
fn noisy(name: &str) -> Box<dyn Backbone> {
    let network = network(name);
    let add_noise = |(name, tensor): (&str, &Tensor)| {
        let mut rng = Rng::new(3, name, "noise");
        let values: Vec<f64> = numbers(tensor).into_iter().map(|x| x + 0.05 * rng.normal()).collect();
        (name.to_owned(), Tensor::from_vec(values, tensor.dims(), &Device::Cpu).unwrap())
    };
    network.with_parameters(network.parameters().iter().map(add_noise).collect()).unwrap()
}

/// What a network computes, by name: predictions, the loss, its gradients.
fn results(network: &dyn Backbone) -> Vec<(String, Vec<f64>)> {
    let data = scene(Kind::FourWay);
    let encoding = network.encode(features(network, &data)).unwrap();
    let log_probs = network.log_probs(&encoding).unwrap();
    let trajectories = network.trajectories(&encoding, &[0, 3]).unwrap();
    let mut found = vec![("log-probabilities", log_probs), ("trajectories", trajectories)];

    let (parameters, variables) =
        network.parameters().variables(|name| network.parameter_group(name).is_pretrained()).unwrap();
    let traced = network.with_parameters(parameters).unwrap();
    let traced = trainable(&*traced).unwrap();
    let sample = recorded_sample(&data, data.scene.adversary.unwrap(), traced).unwrap();
    let loss = traced.loss(&sample, &mut Rng::new(0, "", "loss")).unwrap().total;
    let gradients = loss.backward().unwrap();
    found.push(("loss", loss));
    found.extend(variables.iter().map(|(name, variable)| (name, gradients.get(variable).unwrap().clone())));
    found.into_iter().map(|(name, tensor)| (name.to_owned(), numbers(&tensor))).collect()
}

#[test]
fn networks_compute_the_same_with_the_operations_for_other_devices() {
    let networks = ["densetnt", "query-transformer", "diffusion"].map(noisy);
    let all = || networks.iter().map(|network| results(&**network)).collect::<Vec<_>>();
    let fast = all();
    compose_on_cpu();
    let composed = all();
    assert_ne!(fast, composed, "the composed operations were not taken");
    for ((network, fast), composed) in networks.iter().zip(&fast).zip(&composed) {
        for ((name, fast), (_, composed)) in fast.iter().zip(composed) {
            let scale = fast.iter().fold(1e-3_f64, |most, x| most.max(x.abs()));
            for (a, b) in fast.iter().zip(composed) {
                assert!((a - b).abs() < 1e-5 * scale, "{}, {name}: {a} {b}", network.name());
            }
        }
    }
}
