//! Properties of every merger, on networks with random weights.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use insta::assert_snapshot;
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
use sage_merging::{ADVERSARIAL, ExpertSet, Merger, REALISTIC, merged_weights, mergers};

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
/// Mergers of weights whose corners are the experts, bit for bit.
const INTERPOLATING: [&str; 6] =
    ["linear", "preference-vector", "per-layer", "slerp", "vector-extrapolation", "direct-extrapolation"];
/// Mergers of outputs.
const OUTPUTS: [&str; 3] = ["logit", "probability", "trajectory"];

/// The names of the mergers of weights.
fn weight_mergers() -> Vec<&'static str> {
    let all = mergers().unwrap();
    let names: Vec<&str> = all.entries().iter().map(|entry| entry.name).collect();
    names.into_iter().filter(|name| merger(name).tensors().is_some()).collect()
}

fn built(name: &str, options: serde_json::Value) -> Box<dyn Merger> {
    mergers().unwrap().build(name, &options).unwrap()
}

fn merged_by(merger: &dyn Merger, set: &ExpertSet, weights: &[f64]) -> Parameters {
    merged_weights(merger.tensors().unwrap(), set, &Mixture::new(weights.to_vec()), 0).unwrap()
}

/// Largest difference relative to the size of the values.
fn difference(a: &Parameters, b: &Parameters) -> f32 {
    let pairs = a.iter().zip(b.iter()).flat_map(|((_, a), (_, b))| numbers(a).into_iter().zip(numbers(b)));
    pairs.map(|(x, y)| (x - y).abs() / x.abs().max(0.1)).fold(0.0, f32::max)
}

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
        for merger in weight_mergers() {
            let half = merged(merger, &set, &[0.63, 0.37]);
            for (name, tensor) in half.iter() {
                if !set.prior().parameter_group(name).is_finetuned() {
                    let own = set.prior().parameters().get(name).unwrap();
                    assert_eq!(numbers(tensor), numbers(own), "{merger}: {name}");
                }
            }
        }
    }
}

#[test]
fn at_density_1_the_corners_of_ties_and_dare_are_the_experts() {
    let set = experts("densetnt", 3);
    for merger in ["ties", "dare"] {
        let whole = built(merger, serde_json::json!({"density": 1.0}));
        for (k, (_, expert)) in set.experts().iter().enumerate() {
            let mut corner = [0.0; 3];
            corner[k] = 1.0;
            let found = difference(&merged_by(&*whole, &set, &corner), expert);
            assert!(found <= 1e-6, "{merger}, expert {k}: {found}");
        }
    }
}

#[test]
fn copies_of_one_model_merge_to_it_bit_for_bit() {
    for network in NETWORKS {
        let prior = prior(network);
        let copy = tuned(&*prior, 5);
        let names = [REALISTIC, ADVERSARIAL];
        let same = names.map(|name| (name.to_owned(), copy.clone())).to_vec();
        let set = ExpertSet::new(prior, same).unwrap();
        for merger in weight_mergers() {
            let options = match merger {
                "ties" | "dare" => serde_json::json!({"density": 1.0}),
                _ => serde_json::json!({}),
            };
            let merger_built = built(merger, options);
            for lambda in [0.0, 0.3, 0.5, 0.9, 1.0] {
                let found = merged_by(&*merger_built, &set, &[1.0 - lambda, lambda]);
                assert!(bytes(&found) == bytes(&copy), "{network}, {merger} at {lambda}");
            }
        }
    }
}

#[test]
fn the_order_of_the_experts_does_not_matter() {
    let set = experts("densetnt", 3);
    let turned: Vec<_> = [2, 0, 1].into_iter().map(|k| set.experts()[k].clone()).collect();
    let turned = ExpertSet::new(set.prior().clone(), turned).unwrap();
    for merger in weight_mergers() {
        // SLERP mixes two at a time.
        let weights = if merger == "slerp" { [0.3, 0.7, 0.0] } else { [0.2, 0.5, 0.3] };
        let [a, b, c] = weights;
        let found = difference(&merged(merger, &set, &weights), &merged(merger, &turned, &[c, a, b]));
        assert!(found <= 1e-6, "{merger}: {found}");
    }
}

#[test]
fn without_phi_extrapolation_is_interpolation_and_beyond_it_follows_the_vectors() {
    let set = experts("densetnt", 2);
    for lambda in [0.0, 0.2, 0.5, 1.0] {
        let weights = [1.0 - lambda, lambda];
        let linear = bytes(&merged("linear", &set, &weights));
        for merger in ["vector-extrapolation", "direct-extrapolation", "per-layer"] {
            assert!(bytes(&merged(merger, &set, &weights)) == linear, "{merger} at {lambda}");
        }
    }
    // Direct extrapolation is vector extrapolation with the steps (φ, −φ) from λ = 1.
    let direct = merged("direct-extrapolation", &set, &[-0.4, 1.4]);
    let steps = serde_json::json!({"phi": {"adversarial": 0.4, "realistic": -0.4}});
    let vector = merged_by(&*built("vector-extrapolation", steps), &set, &[0.0, 1.0]);
    assert!(difference(&direct, &vector) <= 1e-6);
    let shifted =
        merged_by(&*built("direct-extrapolation", serde_json::json!({"phi": 0.4})), &set, &[0.0, 1.0]);
    assert!(difference(&direct, &shifted) <= 1e-6);
    // λ = 1.4 is φ = 0.4 of the adversarial expert; the prior as a base with both vectors is their sum.
    let beyond = merged("vector-extrapolation", &set, &[-0.4, 1.4]);
    let phi = serde_json::json!({"base": "adversarial", "phi": {"adversarial": 0.4}});
    assert!(difference(&beyond, &merged_by(&*built("vector-extrapolation", phi), &set, &[0.5, 0.5])) <= 1e-6);
    let from_prior = serde_json::json!({"base": "prior", "phi": {"adversarial": 0.3, "realistic": 0.7}});
    let from_prior = merged_by(&*built("vector-extrapolation", from_prior), &set, &[0.5, 0.5]);
    assert!(difference(&from_prior, &merged("preference-vector", &set, &[0.7, 0.3])) <= 1e-6);
    let unknown = built("vector-extrapolation", serde_json::json!({"phi": {"lawful": 1.0}}));
    let error = unknown.merge(&set, &set.between(0.5).unwrap(), 0).err().unwrap();
    assert_snapshot!(error, @"no expert `lawful`; there are realistic, adversarial");
}

/// The mixture of a merger on a scene, and the probabilities of its experts.
fn outputs(network: &str, name: &str, weights: &[f64]) -> (Vec<f64>, Vec<Vec<f64>>) {
    let scene = generate(Kind::FourWay, 3, 0).unwrap();
    let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone())).unwrap();
    let set = experts(network, weights.len());
    let features = Arc::new(set.prior().features(&now, scene.adversary.unwrap(), None).unwrap());
    let encoding = set.prior().encode(features).unwrap();
    let log_probs = |model: &dyn sage_backbones::MotionModel| -> Vec<f64> {
        numbers(&model.log_probs(&encoding).unwrap()).into_iter().map(f64::from).collect()
    };
    let own = set
        .experts()
        .iter()
        .map(|(_, expert)| log_probs(&*set.prior().with_parameters(expert.clone()).unwrap()));
    let own = own.collect();
    let mixture = merger(name).merge(&set, &Mixture::new(weights.to_vec()), 0).unwrap();
    (log_probs(&*mixture), own)
}

#[test]
fn logits_and_probabilities_mix_as_by_hand() {
    for network in NETWORKS {
        let weights = [0.2, 0.5, 0.3];
        let (logit, own) = outputs(network, "logit", &weights);
        let (probability, _) = outputs(network, "probability", &weights);
        let sum =
            |mode: usize, of: fn(f64) -> f64| -> f64 { (0..3).map(|k| weights[k] * of(own[k][mode])).sum() };
        let total: f64 = (0..logit.len()).map(|mode| sum(mode, |x| x).exp()).sum::<f64>().ln();
        for mode in 0..logit.len() {
            assert!((logit[mode] - (sum(mode, |x| x) - total)).abs() < 1e-4, "{network}, logit {mode}");
            assert!((probability[mode] - sum(mode, f64::exp).ln()).abs() < 1e-4, "{network}, {mode}");
        }
        for mixed in [logit, probability] {
            assert!((mixed.iter().map(|x| x.exp()).sum::<f64>() - 1.0).abs() < 1e-4);
        }
    }
}

#[test]
fn corners_of_output_mergers_are_the_experts_bit_for_bit() {
    for network in NETWORKS {
        for name in OUTPUTS {
            for (k, weights) in [[1.0, 0.0], [0.0, 1.0]].into_iter().enumerate() {
                let (mixed, own) = outputs(network, name, &weights);
                assert_eq!(mixed, own[k], "{network}, {name}, expert {k}");
            }
        }
    }
}

#[test]
fn mixed_trajectories_lie_between_those_of_the_experts() {
    let scene = generate(Kind::FourWay, 3, 0).unwrap();
    let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone())).unwrap();
    let set = experts("densetnt", 2);
    let features = Arc::new(set.prior().features(&now, scene.adversary.unwrap(), None).unwrap());
    for pairs in ["rank", "end"] {
        let merger = built("trajectory", serde_json::json!({"pairs": pairs, "candidates": 8}));
        let encoding = set.prior().encode(features.clone()).unwrap();
        let model = merger.merge(&set, &set.between(0.25).unwrap(), 0).unwrap();
        let log_probs = numbers(&model.log_probs(&encoding).unwrap());
        let ends = model.mode_ends(&encoding).unwrap();
        assert_eq!((log_probs.len(), ends.len()), (8, 8));
        let all: Vec<usize> = (0..8).collect();
        let trajectories = numbers(&model.trajectories(&encoding, &all).unwrap());
        for (pair, end) in ends.iter().enumerate() {
            let last = 160 * pair + 158;
            for axis in 0..2 {
                assert!((trajectories[last + axis] - end[axis]).abs() < 0.5, "{pairs}, pair {pair}");
            }
        }
        let stands_for = model.modes_of_prior(&encoding, &all).unwrap();
        assert!(stands_for.iter().all(|mode| *mode < set.prior().mode_ends(&encoding).unwrap().len()));
    }
}

#[test]
fn preference_vectors_equal_linear_on_the_simplex() {
    let set = experts("densetnt", 3);
    for weights in [[0.1, 0.9, 0.0], [0.5, 0.3, 0.2], [0.2, 0.2, 0.6]] {
        let [a, b] = ["linear", "preference-vector"].map(|merger| merged(merger, &set, &weights));
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
fn a_shorter_mixture_gives_the_other_experts_no_weight() {
    let (two, three) = (experts("densetnt", 2), experts("densetnt", 3));
    for kind in ["linear", "slerp", "ties", "dare"] {
        assert_eq!(
            bytes(&merged(kind, &two, &[0.3, 0.7])),
            bytes(&merged(kind, &three, &[0.3, 0.7])),
            "{kind}"
        );
    }
    let only = three.only(&[ADVERSARIAL, REALISTIC]).unwrap();
    assert_eq!(only.names(), [ADVERSARIAL, REALISTIC]);
    assert_eq!(bytes(&merged("linear", &only, &[0.7, 0.3])), bytes(&merged("linear", &two, &[0.3, 0.7])));
    assert!(three.only(&["calm"]).is_err());
}

#[test]
fn mismatching_mixtures_and_experts_are_refused() {
    let set = experts("densetnt", 2);
    let linear = merger("linear");
    let three = experts("densetnt", 3);
    let merged = |set, mixture| linear.merge(set, &mixture, 0).err().unwrap();
    assert_snapshot!(merged(&set, Mixture::between(-0.1)), @"lambda is -0.1; expected 0 (realistic) to 1 (adversarial): this merger does not go beyond the experts");
    assert_snapshot!(merged(&set, Mixture::between(1.1)), @"lambda is 1.1; expected 0 (realistic) to 1 (adversarial): this merger does not go beyond the experts");
    assert_snapshot!(merged(&set, Mixture::between(f64::NAN)), @"lambda is NaN; expected 0 (realistic) to 1 (adversarial): this merger does not go beyond the experts");
    assert_snapshot!(merged(&set, Mixture::new(vec![0.2, 0.3, 0.5])), @"a mixture of 3 weights for 2 experts");
    assert_snapshot!(merged(&three, Mixture::new(vec![0.7, 0.7, -0.4])), @"the mixture is [0.7, 0.7, -0.4]; expected weights of 0 or more that sum to 1");
    assert_snapshot!(set.mixture(&[("lawful", 1.0)]).err().unwrap(), @"no expert `lawful`; there are realistic, adversarial");

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
    assert_snapshot!(set_of(&ours, [&ours, &foreign.into()]).err().unwrap(), @"the adversarial expert: tensor `decoder.goals_2D_cross_attention.key.bias` differs from the prior's: it was tuned from another one; tensor `decoder.goals_2D_decoder.fc.bias` differs from the prior's: it was tuned from another one; tensor `decoder.goals_2D_mlps.0.linear.bias` differs from the prior's: it was tuned from another one; tensor `decoder.goals_2D_mlps.0.linear.weight` differs from the prior's: it was tuned from another one; tensor `decoder.goals_2D_mlps.1.linear.bias` differs from the prior's: it was tuned from another one; tensor `decoder.goals_2D_mlps.1.linear.weight` differs from the prior's: it was tuned from another one; and 60 more like these");
    let twice =
        vec![("a".to_owned(), ours.parameters().clone()), ("a".to_owned(), ours.parameters().clone())];
    assert_snapshot!(ExpertSet::new(ours.clone(), twice).err().unwrap(), @"there are two experts `a`");
    assert!(ExpertSet::new(ours, Vec::new()).is_err());
}

#[test]
fn log_probs_along_the_own_trajectories_are_the_log_probs() {
    let scene = generate(Kind::FourWay, 3, 0).unwrap();
    let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone())).unwrap();
    let steps: Vec<u32> = (1..=20).map(|step| 4 * step - 1).collect();
    let steps = Tensor::from_vec(steps, 20, &Device::Cpu).unwrap();
    for network in NETWORKS {
        let set = experts(network, 3);
        let features = Arc::new(set.prior().features(&now, scene.adversary.unwrap(), None).unwrap());
        let encoding = set.prior().encode(features).unwrap();
        for name in OUTPUTS {
            let at = Mixture::new(vec![0.2, 0.5, 0.3]);
            let model = merger(name).merge(&set, &at, 0).unwrap();
            let log_probs = model.log_probs(&encoding).unwrap();
            let modes: Vec<usize> = (0..numbers(&log_probs).len()).step_by(7).collect();
            let points = model.trajectories(&encoding, &modes).unwrap().index_select(&steps, 1).unwrap();
            let along = numbers(&model.log_probs_along(&encoding, &log_probs, &modes, &points).unwrap());
            let plain = numbers(&log_probs);
            for (mode, along) in modes.iter().zip(along) {
                assert!((along - plain[*mode]).abs() < 2e-3, "{network}, {name}, mode {mode}: {along}");
            }
        }
    }
}

#[test]
fn high_powers_of_a_layer_do_not_round_to_nothing() {
    let set = experts("densetnt", 2);
    let sharp = built("per-layer", serde_json::json!({"powers": {"": 5000.0}}));
    let half = merged_by(&*sharp, &set, &[0.5, 0.5]);
    assert!(difference(&half, &merged("linear", &set, &[0.5, 0.5])) <= 1e-6);
    let huge = built("direct-extrapolation", serde_json::json!({"phi": 1e39}));
    let at = set.between(0.5).unwrap();
    let error = merged_weights(huge.tensors().unwrap(), &set, &at, 0).err().unwrap().to_string();
    assert!(error.contains("tensor `") && error.contains("would hold"), "{error}");
}
