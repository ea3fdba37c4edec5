//! Properties of every merger, on networks with random weights.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use sage_backbones::{
    Backbone, Parameters, backbones,
    candle::{Device, Tensor},
    parameters::Header,
};
use sage_core::{
    generator::{Mixture, Observation},
    scene::SceneIndex,
    seed::Rng,
};
use sage_data::procedural::{Kind, generate};
use sage_merging::{ADVERSARIAL, ExpertSet, InterpolatedModel, Merger, REALISTIC, merged_weights, mergers};

fn prior(name: &str) -> Arc<dyn Backbone> {
    backbones().unwrap().build(name, &serde_json::json!({"hidden": 16})).unwrap().into()
}

/// The prior with noise on the tensors that fine-tuning changes.
fn tuned(prior: &dyn Backbone, seed: u64) -> Parameters {
    let perturbed = |(name, tensor): (&str, &Tensor)| {
        if !prior.parameter_group(name).is_finetuned() {
            return (name.to_owned(), tensor.clone());
        }
        let mut rng = Rng::new(seed, name, "noise");
        let values: Vec<f32> = tensor.flatten_all().unwrap().to_vec1().unwrap();
        let values = values.into_iter().map(|x| x + 0.1 * rng.normal() as f32).collect();
        (name.to_owned(), Tensor::from_vec(values, tensor.dims(), &Device::Cpu).unwrap())
    };
    prior.parameters().iter().map(perturbed).collect()
}

fn experts(name: &str, count: usize) -> ExpertSet {
    let prior = prior(name);
    let names = [REALISTIC, ADVERSARIAL, "lawful"];
    let tuned = (1..).zip(names).take(count).map(|(seed, name)| (name.to_owned(), tuned(&*prior, seed)));
    ExpertSet::new(prior.clone(), tuned.collect()).unwrap()
}

fn merger(name: &str) -> Box<dyn Merger> {
    mergers().unwrap().build_default(name).unwrap()
}

fn merged(name: &str, set: &ExpertSet, weights: &[f64]) -> Parameters {
    let merger = merger(name);
    merged_weights(merger.tensors().unwrap(), set, &Mixture::new(weights.to_vec()), 0).unwrap()
}

fn bytes(parameters: &Parameters) -> Vec<u8> {
    parameters.to_bytes(&Header::default()).unwrap()
}

fn numbers(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

const NETWORKS: [&str; 2] = ["densetnt", "query-transformer"];
/// Mergers whose corners are the experts.
const INTERPOLATING: [&str; 2] = ["linear", "preference-vector"];

#[test]
fn the_corners_are_the_experts_bit_for_bit() {
    for name in NETWORKS {
        let set = experts(name, 3);
        for merger in INTERPOLATING {
            for (k, (_, expert)) in set.experts().iter().enumerate() {
                let mut corner = [0.0; 3];
                corner[k] = 1.0;
                assert_eq!(bytes(&merged(merger, &set, &corner)), bytes(expert), "{merger}, expert {k}");
            }
        }
    }
}

#[test]
fn tensors_that_fine_tuning_does_not_change_stay_the_priors_for_every_merger() {
    for name in NETWORKS {
        let set = experts(name, 2);
        for entry in mergers().unwrap().entries() {
            let half = merged(entry.name, &set, &[0.63, 0.37]);
            for (name, tensor) in half.iter() {
                if !set.prior().parameter_group(name).is_finetuned() {
                    let own = set.prior().parameters().get(name).unwrap();
                    assert_eq!(numbers(tensor), numbers(own), "{}: {name}", entry.name);
                }
            }
        }
    }
}

#[test]
fn preference_vectors_equal_linear_on_the_simplex() {
    let set = experts("densetnt", 3);
    for weights in [[0.1, 0.9, 0.0], [0.5, 0.3, 0.2], [0.2, 0.2, 0.6]] {
        let [a, b] = INTERPOLATING.map(|merger| merged(merger, &set, &weights));
        for ((name, a), (_, b)) in a.iter().zip(b.iter()) {
            for (x, y) in numbers(a).iter().zip(numbers(b)) {
                assert!((x - y).abs() <= 1e-6 * x.abs().max(0.1), "{name}: {x} and {y}");
            }
        }
    }
}

#[test]
fn a_soup_of_three_is_their_mean_and_linear_at_the_middle_is_too() {
    let set = experts("densetnt", 3);
    let soup = merged("uniform-soup", &set, &[1.0, 0.0, 0.0]);
    let third = 1.0 / 3.0;
    let linear = merged("linear", &set, &[third, third, third]);
    for ((name, a), (_, b)) in soup.iter().zip(linear.iter()) {
        let of = |k: usize| numbers(set.experts()[k].1.get(name).unwrap());
        let all = [of(0), of(1), of(2)];
        for (k, (x, y)) in numbers(a).iter().zip(numbers(b)).enumerate() {
            let mean = all.iter().map(|expert| f64::from(expert[k])).sum::<f64>() / 3.0;
            assert!((f64::from(*x) - mean).abs() <= 1e-7 * mean.abs().max(0.1), "{name}: {x} for {mean}");
            assert!((x - y).abs() <= 1e-6 * x.abs().max(0.1), "{name}: {x} and {y}");
        }
    }
}

#[test]
fn the_interpolated_model_computes_what_a_merged_model_does() {
    let scene = generate(Kind::FourWay, 3, 0).unwrap();
    let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone())).unwrap();
    for name in NETWORKS {
        let set = experts(name, 2);
        for kind in mergers().unwrap().entries() {
            let merger = merger(kind.name);
            let mut model = InterpolatedModel::new(&set, merger.tensors().unwrap(), 0).unwrap();
            let features = model.network().features(&now, scene.adversary.unwrap(), None).unwrap();
            let features = Arc::new(features);
            // One encoding for all mixtures.
            let encoding = model.network().encode(features.clone()).unwrap();
            for lambda in [0.0, 0.5, 1.0, 0.25, 0.0] {
                let at = set.between(lambda).unwrap();
                model.set(&at).unwrap();
                let fresh = merger.merge(&set, &at, 0).unwrap();
                let expected = fresh.log_probs(&fresh.encode(features.clone()).unwrap()).unwrap();
                let found = model.network().log_probs(&encoding).unwrap();
                assert_eq!(numbers(&found), numbers(&expected), "{name}, {} at {lambda}", kind.name);
            }
        }
    }
}

#[test]
fn mismatching_mixtures_and_experts_are_refused() {
    let set = experts("densetnt", 2);
    let linear = merger("linear");
    for lambda in [-0.1, 1.1, f64::NAN] {
        let error = linear.merge(&set, &Mixture::between(lambda), 0).err().unwrap().to_string();
        assert!(error.contains("expected 0 (realistic) to 1 (adversarial)"), "{error}");
    }
    let error = linear.merge(&set, &Mixture::new(vec![0.2, 0.3, 0.5]), 0).err().unwrap().to_string();
    assert!(error.contains("3 weights for 2 experts"), "{error}");
    let three = experts("densetnt", 3);
    let error = linear.merge(&three, &Mixture::new(vec![0.7, 0.7, -0.4]), 0).err().unwrap().to_string();
    assert!(error.contains("0 or more that sum to 1"), "{error}");
    let error = set.mixture(&[("lawful", 1.0)]).err().unwrap().to_string();
    assert_eq!(error, "no expert `lawful`; there are realistic, adversarial");

    let [ours, other] = NETWORKS.map(prior);
    let set_of = |prior: &Arc<dyn Backbone>, experts: [&Arc<dyn Backbone>; 2]| {
        let named = [REALISTIC, ADVERSARIAL].into_iter().zip(experts);
        let named = named.map(|(name, of)| (name.to_owned(), of.parameters().clone())).collect();
        ExpertSet::new(prior.clone(), named)
    };
    let error = set_of(&ours, [&other, &ours]).err().unwrap().to_string();
    assert!(error.starts_with("the realistic expert: tensor `"), "{error}");
    // The same network from another prior.
    let foreign =
        backbones().unwrap().build("densetnt", &serde_json::json!({"hidden": 16, "seed": 9})).unwrap();
    let error = set_of(&ours, [&ours, &foreign.into()]).err().unwrap().to_string();
    assert!(
        error.starts_with("the adversarial expert: ") && error.contains("tuned from another one"),
        "{error}"
    );
    let twice =
        vec![("a".to_owned(), ours.parameters().clone()), ("a".to_owned(), ours.parameters().clone())];
    assert!(ExpertSet::new(ours.clone(), twice).err().unwrap().to_string().contains("two experts `a`"));
    assert!(ExpertSet::new(ours, Vec::new()).is_err());
}
