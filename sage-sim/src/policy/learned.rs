//! Drivers that were learnt by `sage train-ego`: the shipped ones, or one of a file.

use std::path::PathBuf;

use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};

use super::EgoPolicy;
use crate::actor::{parse_policy, read_policy};

/// The policy `ppo`.
pub struct Ppo;

/// The policy `td3`.
pub struct Td3;

/// Options of [`Ppo`] and [`Td3`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnedPolicyOptions {
    /// File of a policy, whatever trained it; the shipped one if empty.
    pub file: PathBuf,
}

impl Entry<dyn EgoPolicy> for Ppo {
    const NAME: &'static str = "ppo";
    const SUMMARY: &'static str = "a learnt driver: the shipped one, or ppo:FILE of `sage train-ego`";
    const SOURCE: &'static str = "Schulman et al. 2017; trained by this project on procedural scenes";
    type Options = LearnedPolicyOptions;

    fn build(options: LearnedPolicyOptions) -> Result<Box<dyn EgoPolicy>, String> {
        built(options, &sage_weights::PPO)
    }
}

impl Entry<dyn EgoPolicy> for Td3 {
    const NAME: &'static str = "td3";
    const SUMMARY: &'static str =
        "a driver trained as published: the shipped one, or td3:FILE of `sage train-ego`";
    const SOURCE: &'static str = "Fujimoto et al. 2018; CAT and SAGE train it";
    type Options = LearnedPolicyOptions;

    fn build(options: LearnedPolicyOptions) -> Result<Box<dyn EgoPolicy>, String> {
        built(options, &sage_weights::TD3)
    }
}

fn built(options: LearnedPolicyOptions, shipped: &[u8]) -> Result<Box<dyn EgoPolicy>, String> {
    let (network, card) = if options.file.as_os_str().is_empty() {
        parse_policy(shipped).map_err(|problem| format!("the shipped policy: {problem}"))?
    } else {
        read_policy(&options.file).map_err(|error| error.to_string())?
    };
    Ok(Box::new(card.policy(network)))
}
