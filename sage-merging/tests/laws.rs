//! What every merger must obey, on networks with weights of chance.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use sage_backbones::{
    Backbone, Parameters, backbones,
    candle::{Device, Tensor},
    parameters::Header,
};
use sage_core::{scene::SceneIndex, seed::Rng};
use sage_data::procedural::{Kind, generate};
use sage_merging::{Dial, Experts, mergers};

fn prior(name: &str) -> Box<dyn Backbone> {
    backbones().unwrap().build(name, &serde_json::json!({"hidden": 16})).unwrap()
}

/// The prior with noise on what fine-tuning moves.
fn tuned(prior: &dyn Backbone, seed: u64) -> Parameters {
    let stir = |(name, tensor): (&str, &Tensor)| {
        if !prior.role(name).is_finetuned() {
            return (name.to_owned(), tensor.clone());
        }
        let mut rng = Rng::new(seed, name, "noise");
        let values: Vec<f32> = tensor.flatten_all().unwrap().to_vec1().unwrap();
        let values = values.into_iter().map(|x| x + 0.1 * rng.normal() as f32).collect();
        (name.to_owned(), Tensor::from_vec(values, tensor.dims(), &Device::Cpu).unwrap())
    };
    prior.parameters().iter().map(stir).collect()
}

fn experts(name: &str) -> Experts {
    let prior = prior(name);
    let [realistic, adversarial] = [1, 2].map(|seed| tuned(&*prior, seed));
    Experts::new(prior, realistic, adversarial).unwrap()
}

fn bytes(parameters: &Parameters) -> Vec<u8> {
    parameters.to_bytes(&Header::default()).unwrap()
}

const NETWORKS: [&str; 2] = ["densetnt", "query-transformer"];

#[test]
fn the_ends_are_the_experts_bit_for_bit_and_what_they_share_stays() {
    for name in NETWORKS {
        let experts = experts(name);
        for entry in mergers().unwrap().entries() {
            let merger = mergers().unwrap().build_default(entry.name).unwrap();
            assert_eq!(bytes(&merger.merge(&experts, 0.0).unwrap()), bytes(experts.realistic()));
            assert_eq!(bytes(&merger.merge(&experts, 1.0).unwrap()), bytes(experts.adversarial()));
            let half = merger.merge(&experts, 0.37).unwrap();
            for (name, tensor) in half.iter() {
                if !experts.prior().role(name).is_finetuned() {
                    let shared = experts.realistic().get(name).unwrap();
                    let numbers = |t: &Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
                    assert_eq!(numbers(tensor), numbers(shared), "{name}");
                }
            }
        }
    }
}

#[test]
fn the_vector_form_is_the_same_line() {
    let experts = experts("densetnt");
    let registry = mergers().unwrap();
    let [linear, vector] = ["linear", "preference-vector"].map(|name| registry.build_default(name).unwrap());
    for lambda in [0.1, 0.5, 0.9] {
        let [a, b] = [&linear, &vector].map(|merger| merger.merge(&experts, lambda).unwrap());
        for ((name, a), (_, b)) in a.iter().zip(b.iter()) {
            let [a, b] = [a, b].map(|t| t.flatten_all().unwrap().to_vec1::<f32>().unwrap());
            for (x, y) in a.iter().zip(&b) {
                assert!((x - y).abs() <= 1e-6 * x.abs().max(0.1), "{name}: {x} and {y}");
            }
        }
    }
}

#[test]
fn a_turned_dial_computes_what_a_freshly_built_network_does() {
    let scene = generate(Kind::FourWay, 3, 0).unwrap();
    let index = SceneIndex::new(scene.map.clone());
    for name in NETWORKS {
        let experts = experts(name);
        let registry = mergers().unwrap();
        let linear = registry.build_default("linear").unwrap();
        let mut dial = Dial::new(&experts, registry.build_default("linear").unwrap()).unwrap();
        let features = Arc::new(dial.network().features(&scene, &index, scene.adversary.unwrap()).unwrap());
        // One encoding, kept while the dial turns.
        let kept = dial.network().encode(features.clone()).unwrap();
        for lambda in [0.0, 0.5, 1.0, 0.25, 0.0] {
            dial.turn(lambda).unwrap();
            assert_eq!(dial.lambda(), lambda);
            let fresh = experts.prior().rebuilt(linear.merge(&experts, lambda).unwrap()).unwrap();
            let encoding = fresh.encode(features.clone()).unwrap();
            let numbers = |t: Tensor| t.to_vec1::<f32>().unwrap();
            let expected = numbers(fresh.log_probs(&encoding).unwrap());
            assert!(numbers(dial.network().log_probs(&kept).unwrap()) == expected, "{name} at {lambda}");
        }
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let networks = experts("densetnt");
    let linear = mergers().unwrap().build_default("linear").unwrap();
    for lambda in [-0.1, 1.1, f64::NAN] {
        let error = linear.merge(&networks, lambda).err().unwrap().to_string();
        assert!(error.contains("expected 0 (realistic) to 1 (adversarial)"), "{error}");
    }
    let [ours, other] = NETWORKS.map(prior);
    let error = Experts::new(prior("densetnt"), other.parameters().clone(), ours.parameters().clone());
    assert!(error.err().unwrap().to_string().starts_with("the realistic expert: tensor `"));
    // The same network from another prior.
    let stranger =
        backbones().unwrap().build("densetnt", &serde_json::json!({"hidden": 16, "seed": 9})).unwrap();
    let error = Experts::new(prior("densetnt"), ours.parameters().clone(), stranger.parameters().clone());
    let error = error.err().unwrap().to_string();
    assert!(
        error.starts_with("the adversarial expert: ") && error.contains("tuned from another one"),
        "{error}"
    );
}
