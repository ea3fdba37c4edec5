//! Mergers of experts whose encoder was tuned too: scores are their own, modes and trajectories the prior's.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use sage_backbones::{
    Backbone, MotionModel, Parameters,
    backbone::ParameterGroup,
    backbones,
    candle::{Device, Tensor},
    training::Tunes,
};
use sage_core::{generator::Observation, scene::SceneIndex, seed::Rng};
use sage_data::procedural::{Kind, generate};
use sage_merging::{ADVERSARIAL, ExpertSet, Merger, REALISTIC, mergers};

const NETWORKS: [&str; 2] = ["densetnt", "query-transformer"];

fn prior(name: &str) -> Arc<dyn Backbone> {
    backbones().unwrap().build(name, &serde_json::json!({"hidden": 16})).unwrap().into()
}

fn merger(name: &str) -> Box<dyn Merger> {
    mergers().unwrap().build_default(name).unwrap()
}

fn numbers(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

/// Experts of which the encoder was tuned too.
fn with_own_encoders(name: &str) -> ExpertSet {
    let prior = prior(name);
    let noisy = |seed: u64| -> Parameters {
        let one = |(name, tensor): (&str, &Tensor)| {
            let mut rng = Rng::new(seed, name, "noise of all");
            // Not the interaction head: it would read the network's own trajectories below.
            let is_tuned =
                matches!(prior.parameter_group(name), ParameterGroup::Prior | ParameterGroup::Scoring);
            let noise = if is_tuned { 0.05 } else { 0.0 };
            let values = numbers(tensor).into_iter().map(|x| x + noise * rng.normal() as f32).collect();
            (name.to_owned(), Tensor::from_vec(values, tensor.dims(), &Device::Cpu).unwrap())
        };
        prior.parameters().iter().map(one).collect()
    };
    let experts = vec![(REALISTIC.to_owned(), noisy(1)), (ADVERSARIAL.to_owned(), noisy(2))];
    ExpertSet::new(prior.clone(), experts.clone()).map(|_| ()).unwrap_err();
    ExpertSet::tuned(prior.clone(), experts, Tunes::All).unwrap()
}

#[test]
fn experts_with_own_encoders_score_the_priors_modes() {
    let scene = generate(Kind::FourWay, 3, 0).unwrap();
    let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone())).unwrap();
    for name in NETWORKS {
        let set = with_own_encoders(name);
        let features = Arc::new(set.prior().features(&now, scene.adversary.unwrap(), None).unwrap());
        let encoding = set.prior().encode(features.clone()).unwrap();
        for kind in ["linear", "ties", "logit", "trajectory"] {
            let merger = merger(kind);
            let at = |lambda: f64| merger.merge(&set, &set.between(lambda).unwrap(), 0).unwrap();
            let end = at(1.0);
            // The expert itself, with its own encoding of the same features.
            if kind == "linear" {
                let (_, weights) = &set.experts()[1];
                let expert = set.prior().with_parameters(weights.clone()).unwrap();
                let own = expert.log_probs(&expert.encode(features.clone()).unwrap()).unwrap();
                assert_eq!(numbers(&end.log_probs(&encoding).unwrap()), numbers(&own), "{name}");
                let by_prior = expert.log_probs(&encoding).unwrap();
                assert_ne!(numbers(&by_prior), numbers(&own), "{name}: the encoder matters");
            }
            // Ends and trajectories are the prior's.
            if merger.keeps_modes() {
                let middle = at(0.5);
                let [a, b] = [&*middle, &**set.prior() as &dyn MotionModel]
                    .map(|model| numbers(&model.trajectories(&encoding, &[0, 3]).unwrap()));
                assert_eq!(a, b, "{name}, {kind}");
                let sum: f32 = numbers(&middle.log_probs(&encoding).unwrap()).iter().map(|p| p.exp()).sum();
                assert!((sum - 1.0).abs() < 1e-4, "{name}, {kind}: {sum}");
            }
        }
    }
}
