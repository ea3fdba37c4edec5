//! TIES: each task vector is trimmed to its largest values, the experts elect a sign for each value, and those
//! that agree are averaged.
//!
//! A value that one expert alone changed counts in full whatever its weight, so the result jumps where a weight
//! becomes 0. Properties: at density 1 a corner is its expert (to rounding); experts with the same weights merge to
//! them; the order of the experts does not matter.

use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};

use crate::{
    Error, ExpertSet, Merger, Range, TensorMerger, TensorRule, TensorSet,
    task_arithmetic::{Consensus, SparseRule, Sparsify, TaskArithmetic, check},
};

/// Options of [`Ties`].
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TiesOptions {
    /// Share of the values of each tensor that are kept, the largest ones.
    pub density: f64,
    /// Factor of the merged task vector.
    pub scale: f64,
}

impl Default for TiesOptions {
    fn default() -> Self {
        Self { density: 0.5, scale: 1.0 }
    }
}

/// Trim, elect sign, merge.
#[derive(Clone, Copy)]
pub struct Ties(TiesOptions);

impl TensorMerger for Ties {
    fn range(&self) -> Range {
        Range::Beyond
    }

    fn prepare(&self, _: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        Ok(Box::new(SparseRule::new(*self)))
    }
}

impl Sparsify for Ties {
    fn sparsify(&self, _: &TensorSet, vectors: &mut [Vec<f64>]) {
        vectors.iter_mut().for_each(|vector| trim(vector, self.0.density));
    }

    fn arithmetic(&self) -> TaskArithmetic {
        TaskArithmetic { consensus: Consensus::Sum, normalizes: true, scale: self.0.scale }
    }
}

/// Keeps the largest values, at least one. Of equal values the first are kept.
fn trim(vector: &mut [f64], density: f64) {
    let count = ((density * vector.len() as f64) as usize).max(1);
    if count >= vector.len() {
        return;
    }
    let mut order: Vec<usize> = (0..vector.len()).collect();
    let larger = |a: &usize, b: &usize| vector[*b].abs().total_cmp(&vector[*a].abs()).then(a.cmp(b));
    order.select_nth_unstable_by(count - 1, larger);
    for &k in &order[count..] {
        vector[k] = 0.0;
    }
}

impl Entry<dyn Merger> for Ties {
    const NAME: &'static str = "ties";
    const SUMMARY: &'static str = "the largest differences from the prior, averaged where their signs agree";
    const SOURCE: &'static str = "Yadav et al. 2023 (TIES-Merging), as in mergekit";
    type Options = TiesOptions;

    fn build(options: TiesOptions) -> Result<Box<dyn Merger>, String> {
        check(options.density, options.scale)?;
        Ok(Box::new(Self(options)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_values_stay() {
        let mut vector = [1.0, -4.0, 3.0, -2.0, 2.0];
        trim(&mut vector, 0.6);
        assert_eq!(vector, [0.0, -4.0, 3.0, -2.0, 0.0]);
        trim(&mut vector, 0.01);
        assert_eq!(vector, [0.0, -4.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn a_case_worked_by_hand() {
        // Vectors (2, −1, 0.1) and (1, 3, −0.2); density 2/3 drops the last of each.
        let experts = [vec![3.0f32, 0.0, 1.1], vec![2.0, 4.0, 0.8]];
        let tensor = TensorSet { name: "w", prior: &[1.0, 1.0, 1.0], experts: &experts };
        let mut out = [0.0f32; 3];
        SparseRule::new(Ties(TiesOptions { density: 0.67, scale: 1.0 })).merge(
            &tensor,
            &[0.5, 0.5],
            &mut out,
        );
        // Column 2: −0.5 against 1.5, so 3 alone.
        assert_eq!(out, [2.5, 4.0, 1.0]);
    }
}
