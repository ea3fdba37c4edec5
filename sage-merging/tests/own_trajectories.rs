//! Mergers of experts that have trajectories of their own, as those of a diffusion network.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use sage_backbones::{
    Backbone, MotionModel, Parameters, backbones,
    candle::{Device, Tensor},
    encoding::Encoding,
};
use sage_core::{generator::Observation, scene::SceneIndex, seed::Rng};
use sage_data::procedural::{Kind, generate};
use sage_merging::{ADVERSARIAL, ExpertSet, REALISTIC, mergers};

const SAMPLES: usize = 12;

fn experts() -> ExpertSet {
    let options = serde_json::json!({"hidden": 16, "samples": SAMPLES, "steps": 3});
    let prior: Arc<dyn Backbone> = backbones().unwrap().build("diffusion", &options).unwrap().into();
    let noisy = |seed: u64| -> Parameters {
        let one = |(name, tensor): (&str, &Tensor)| {
            let mut rng = Rng::new(seed, name, "noise of an expert");
            let noise = if prior.parameter_group(name).is_finetuned() { 0.1 } else { 0.0 };
            let values: Vec<f32> = tensor.flatten_all().unwrap().to_vec1().unwrap();
            let values = values.into_iter().map(|x| x + noise * rng.normal() as f32).collect();
            (name.to_owned(), Tensor::from_vec(values, tensor.dims(), &Device::Cpu).unwrap())
        };
        prior.parameters().iter().map(one).collect()
    };
    let experts = vec![(REALISTIC.to_owned(), noisy(1)), (ADVERSARIAL.to_owned(), noisy(2))];
    ExpertSet::new(prior.clone(), experts).unwrap()
}

/// Trajectories of all modes.
fn paths(model: &dyn MotionModel, encoding: &Encoding) -> Vec<f32> {
    let modes: Vec<usize> = (0..model.mode_ends(encoding).unwrap().len()).collect();
    model.trajectories(encoding, &modes).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

#[test]
fn every_merger_mixes_them_and_none_takes_the_trajectories_of_the_prior() {
    let scene = generate(Kind::FourWay, 3, 0).unwrap();
    let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone())).unwrap();
    let set = experts();
    let features = Arc::new(set.prior().features(&now, scene.adversary.unwrap(), None).unwrap());
    let encoding = set.prior().encode(features).unwrap();
    let of_prior = paths(&**set.prior(), &encoding);
    let own = [0, 1].map(|expert| {
        let network = set.prior().with_parameters(set.experts()[expert].1.clone()).unwrap();
        paths(&*network, &encoding)
    });
    assert!(own[0] != own[1] && own.iter().all(|own| *own != of_prior));
    let mergers = mergers().unwrap();
    for entry in mergers.entries() {
        let name = entry.name;
        let merger = mergers.build_default(name).unwrap();
        let at = |lambda: f64| merger.merge(&set, &set.between(lambda).unwrap(), 0).unwrap();
        let middle = at(0.5);
        let between = paths(&*middle, &encoding);
        assert_ne!(between, of_prior, "{name}");
        assert_eq!(between, paths(&*at(0.5), &encoding), "{name}: the same bits again");
        let log_probs: Vec<f32> = middle.log_probs(&encoding).unwrap().to_vec1().unwrap();
        let sum: f32 = log_probs.iter().map(|log_prob| log_prob.exp()).sum();
        assert!((sum - 1.0).abs() < 1e-4, "{name}: {sum}");
        let modes: Vec<usize> = (0..log_probs.len()).collect();
        let of_prior = middle.modes_of_prior(&encoding, &modes).unwrap();
        assert!(of_prior.iter().all(|mode| *mode < SAMPLES), "{name}");
        // At its ends a merger of outputs is the expert.
        if merger.tensors().is_none() {
            for (expert, lambda) in [(0, 0.0), (1, 1.0)] {
                assert_eq!(paths(&*at(lambda), &encoding), own[expert], "{name}");
            }
        }
    }
}

#[test]
fn a_mixture_of_outputs_has_the_futures_of_both_experts_by_their_weights() {
    let scene = generate(Kind::Curve, 3, 0).unwrap();
    let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone())).unwrap();
    let set = experts();
    let features = Arc::new(set.prior().features(&now, scene.adversary.unwrap(), None).unwrap());
    let encoding = set.prior().encode(features).unwrap();
    let merger = mergers().unwrap().build_default("probability").unwrap();
    let model = merger.merge(&set, &set.between(0.25).unwrap(), 0).unwrap();
    let log_probs: Vec<f32> = model.log_probs(&encoding).unwrap().to_vec1().unwrap();
    assert_eq!(log_probs.len(), 2 * SAMPLES);
    let [realistic, adversarial] = [0, SAMPLES].map(|mode| f64::from(log_probs[mode].exp()) * SAMPLES as f64);
    assert!((realistic - 0.75).abs() < 1e-6 && (adversarial - 0.25).abs() < 1e-6);
    let one = |expert: usize| {
        let network = set.prior().with_parameters(set.experts()[expert].1.clone()).unwrap();
        network.trajectories(&encoding, &[3]).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap()
    };
    let mixed = model.trajectories(&encoding, &[3, SAMPLES + 3]).unwrap();
    assert_eq!(mixed.flatten_all().unwrap().to_vec1::<f32>().unwrap(), [one(0), one(1)].concat());
}
