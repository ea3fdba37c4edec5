//! Mergers against mergekit's own output on three small models; `data/make_mergekit_golden.py` made it.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::{collections::BTreeMap, sync::Arc};

use sage_backbones::{Backbone, backbones};
use sage_merging::{ADVERSARIAL, ExpertSet, REALISTIC, TensorSet, mergers};
use serde::Deserialize;

type Model = BTreeMap<String, Vec<f32>>;

#[derive(Deserialize)]
struct Golden {
    models: BTreeMap<String, Model>,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    merger: String,
    options: serde_json::Value,
    weights: Vec<f64>,
    out: Model,
}

/// A set with the names of the experts: the rules under test need no more of it.
fn named() -> ExpertSet {
    let prior: Arc<dyn Backbone> =
        backbones().unwrap().build("densetnt", &serde_json::json!({"hidden": 16})).unwrap().into();
    let same = [REALISTIC, ADVERSARIAL].map(|name| (name.to_owned(), prior.parameters().clone()));
    ExpertSet::new(prior, same.to_vec()).unwrap()
}

#[test]
fn mergers_equal_mergekit() {
    let golden: Golden = serde_json::from_str(include_str!("data/mergekit.json")).unwrap();
    let set = named();
    for case in &golden.cases {
        let merger = mergers().unwrap().build(&case.merger, &case.options).unwrap();
        let rule = merger.tensors().unwrap().prepare(&set, 0).unwrap();
        for (name, prior) in &golden.models["prior"] {
            let experts = [REALISTIC, ADVERSARIAL].map(|expert| golden.models[expert][name].clone());
            let mut out = vec![0.0; prior.len()];
            rule.merge(&TensorSet { name, prior, experts: &experts }, &case.weights, &mut out);
            for (k, (found, expected)) in out.iter().zip(&case.out[name]).enumerate() {
                let gap = (found - expected).abs();
                assert!(
                    gap <= 2e-6 * expected.abs().max(1.0),
                    "{} {}, {name}[{k}]: {found} for {expected}",
                    case.merger,
                    case.options
                );
            }
        }
    }
    assert_eq!(golden.cases.len(), 8);
}
