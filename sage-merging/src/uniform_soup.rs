//! Uniform soup: the mean of all experts, for any mixture. Property: the order of the experts does not
//! matter, except for rounding.

use sage_core::registry::{Entry, NoOptions};

use crate::{Error, ExpertSet, Merger, TensorMerger, TensorRule, TensorSet};

/// The mean of all experts.
#[derive(Clone, Copy)]
pub struct UniformSoup;

impl TensorMerger for UniformSoup {
    fn prepare(&self, _: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        Ok(Box::new(*self))
    }
}

impl TensorRule for UniformSoup {
    fn merge(&self, tensor: &TensorSet, _: &[f64], out: &mut [f32]) {
        for (k, out) in out.iter_mut().enumerate() {
            let sum: f64 = tensor.experts.iter().map(|expert| f64::from(expert[k])).sum();
            *out = (sum / tensor.experts.len() as f64) as f32;
        }
    }
}

impl Entry<dyn Merger> for UniformSoup {
    const NAME: &'static str = "uniform-soup";
    const SUMMARY: &'static str = "the mean of all experts, for any mixture";
    const SOURCE: &'static str = "Wortsman et al. 2022 (model soups)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self))
    }
}
