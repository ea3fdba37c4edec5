//! A driver learnt by TD3, from a file of `sage train-ego`.

use std::path::PathBuf;

use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};

use super::EgoPolicy;
use crate::rl::{parse_policy, read_policy};

/// The policy `td3`.
pub struct Td3;

/// Options of [`Td3`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Td3PolicyOptions {
    /// File of a policy; the one trained on procedural scenes without attacks if empty.
    pub file: PathBuf,
}

impl Entry<dyn EgoPolicy> for Td3 {
    const NAME: &'static str = "td3";
    const SUMMARY: &'static str =
        "a driver learnt by TD3 or PPO: the shipped one, or td3:FILE of `sage train-ego`";
    const SOURCE: &'static str = "Fujimoto et al. 2018; CAT and SAGE train it";
    type Options = Td3PolicyOptions;

    fn build(options: Td3PolicyOptions) -> Result<Box<dyn EgoPolicy>, String> {
        let (network, card) = if options.file.as_os_str().is_empty() {
            parse_policy(sage_weights::TD3).map_err(|problem| format!("the shipped policy: {problem}"))?
        } else {
            read_policy(&options.file)?
        };
        Ok(Box::new(card.policy(network)))
    }
}
