//! DARE: values of each task vector are dropped at random, the others scaled up by the share that stays.
//!
//! Which values are dropped depends on the seed, the tensor and the expert's name, so neither λ nor the order
//! of the experts changes it. Properties: at density 1 a corner is its expert (to rounding); the expectation
//! over seeds is task arithmetic.

use sage_core::{registry::Entry, seed::Rng};
use serde::{Deserialize, Serialize};

use crate::{
    Error, ExpertSet, Merger, Range, TensorMerger, TensorRule, TensorSet,
    task_arithmetic::{Consensus, SparseRule, Sparsify, TaskArithmetic, check},
};

/// Options of [`Dare`].
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DareOptions {
    /// Share of the values that stay.
    pub density: f64,
    /// How the experts agree on signs: `none` is mergekit's `dare_linear`, `sum` its `dare_ties`.
    pub consensus: Consensus,
    /// Factor of the merged task vector.
    pub scale: f64,
}

impl Default for DareOptions {
    fn default() -> Self {
        Self { density: 0.5, consensus: Consensus::None, scale: 1.0 }
    }
}

/// Drop and rescale.
#[derive(Clone, Copy)]
pub struct Dare(DareOptions);

impl TensorMerger for Dare {
    fn range(&self) -> Range {
        Range::Beyond
    }

    fn prepare(&self, experts: &ExpertSet, seed: u64) -> Result<Box<dyn TensorRule>, Error> {
        let names = experts.names().into_iter().map(str::to_owned).collect();
        Ok(Box::new(SparseRule::new(Drops { options: self.0, names, seed })))
    }
}

struct Drops {
    options: DareOptions,
    /// Names of the experts.
    names: Vec<String>,
    seed: u64,
}

impl Sparsify for Drops {
    fn sparsify(&self, tensor: &TensorSet, vectors: &mut [Vec<f64>]) {
        let density = self.options.density;
        if density >= 1.0 {
            return;
        }
        for (vector, name) in vectors.iter_mut().zip(&self.names) {
            let mut rng = Rng::new(self.seed, &format!("{name} {}", tensor.name), "dare");
            for value in vector {
                *value = if rng.uniform(0.0, 1.0) < density { *value / density } else { 0.0 };
            }
        }
    }

    fn arithmetic(&self) -> TaskArithmetic {
        let DareOptions { consensus, scale, .. } = self.options;
        TaskArithmetic { consensus, normalizes: false, scale }
    }
}

impl Entry<dyn Merger> for Dare {
    const NAME: &'static str = "dare";
    const SUMMARY: &'static str =
        "differences from the prior, a random part of them dropped, the others scaled up";
    const SOURCE: &'static str = "Yu et al. 2024 (DARE), as in mergekit";
    type Options = DareOptions;

    fn build(options: DareOptions) -> Result<Box<dyn Merger>, String> {
        check(options.density, options.scale)?;
        Ok(Box::new(Self(options)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_over_seeds_is_the_weighted_sum() {
        let experts = [vec![3.0f32, 1.0, 0.5], vec![-1.0, 2.0, 0.0]];
        let tensor = TensorSet { name: "w", prior: &[0.25, 0.0, 0.0], experts: &experts };
        let names = vec!["realistic".to_owned(), "adversarial".to_owned()];
        let options = DareOptions { density: 0.3, ..DareOptions::default() };
        let mut mean = [0.0f64; 3];
        for seed in 0..4000 {
            let mut out = [0.0f32; 3];
            SparseRule::new(Drops { options, names: names.clone(), seed }).merge(
                &tensor,
                &[0.4, 0.6],
                &mut out,
            );
            out.iter().zip(&mut mean).for_each(|(x, mean)| *mean += f64::from(*x) / 4000.0);
        }
        // 0.25 + 0.4 × 2.75 − 0.6 × 1.25; 0.4 + 1.2; 0.2. A value has a deviation of up to 2.
        for (found, expected) in mean.iter().zip([0.6, 1.6, 0.2]) {
            assert!((found - expected).abs() < 0.12, "{found} for {expected}");
        }
    }
}
