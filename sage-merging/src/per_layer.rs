//! A λ of its own for each layer: weights `w_i^p`, renormalised, with a power `p` by tensor name.
//!
//! A power above 1 lets a layer follow its largest weight more closely, one below 1 evens the weights out; in
//! all cases the corners are the experts. Properties: with all powers 1 it is [`crate::Linear`], with the same
//! bits; the order of the experts does not matter.

use std::collections::BTreeMap;

use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};

use crate::{Error, ExpertSet, Linear, Merger, TensorMerger, TensorRule, TensorSet};

/// Options of [`PerLayer`].
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PerLayerOptions {
    /// Power by the beginning of the tensor's name; the longest beginning counts, and 1 without any.
    pub powers: BTreeMap<String, f64>,
}

/// Interpolation with a λ for each layer.
#[derive(Clone)]
pub struct PerLayer(PerLayerOptions);

impl TensorMerger for PerLayer {
    fn prepare(&self, experts: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        let tuned = experts.tuned_tensors()?;
        for start in self.0.powers.keys() {
            if !tuned.iter().any(|tensor| tensor.name.starts_with(start)) {
                let known = tuned.iter().map(|tensor| tensor.name.to_string()).collect();
                return Err(Error::NoTensor { start: start.clone(), known });
            }
        }
        Ok(Box::new(self.clone()))
    }
}

impl TensorRule for PerLayer {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        let beginnings = self.0.powers.iter().filter(|(start, _)| tensor.name.starts_with(&***start));
        let power = beginnings.max_by_key(|(start, _)| start.len()).map_or(1.0, |(_, power)| *power);
        if power == 1.0 {
            return Linear.merge(tensor, at, out);
        }
        // Relative to the largest weight, so that a high power does not round all of them to 0.
        let largest = at.iter().copied().fold(0.0, f64::max);
        let raised: Vec<f64> = at.iter().map(|weight| (weight / largest).powf(power)).collect();
        let sum: f64 = raised.iter().sum();
        let weights: Vec<f64> = raised.iter().map(|weight| weight / sum).collect();
        Linear.merge(tensor, &weights, out);
    }
}

impl Entry<dyn Merger> for PerLayer {
    const NAME: &'static str = "per-layer";
    const SUMMARY: &'static str = "weight interpolation with a lambda of its own for each layer";
    const SOURCE: &'static str = "this project";
    type Options = PerLayerOptions;

    fn build(options: PerLayerOptions) -> Result<Box<dyn Merger>, String> {
        match options.powers.iter().find(|(_, power)| !(**power > 0.0 && power.is_finite())) {
            Some((start, power)) => {
                Err(format!("the power of `{start}` is {power}; expected a finite number above 0"))
            }
            None => Ok(Box::new(Self(options))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_beginning_counts() {
        let powers = BTreeMap::from([("head".to_owned(), 2.0), ("head.out".to_owned(), 1.0)]);
        let rule = PerLayer(PerLayerOptions { powers });
        let experts = [vec![0.0f32], vec![1.0]];
        let merged = |name| {
            let mut out = [0.0f32];
            rule.merge(&TensorSet { name, prior: &[0.0], experts: &experts }, &[0.25, 0.75], &mut out);
            out[0]
        };
        // 0.75² / (0.25² + 0.75²) = 0.9.
        assert_eq!([merged("head.in"), merged("head.out"), merged("other")], [0.9, 0.75, 0.75]);
    }
}
