//! `sage` with your own merger for any number of experts. Each weight comes from the expert that changed it
//! most.
//!
//! ```sh
//! cargo run --release -p experiments --example own_merger -- generate examples/crossing.pkl \
//!     --weights procedural --merger strongest --lambda 0.5 --out strongest
//! ```

use std::process::ExitCode;

use sage_core::registry::{Entry, NoOptions};
use sage_merging::{Error, ExpertSet, Merger, TensorMerger, TensorRule, TensorSet};

/// Takes each parameter from the expert with the largest weighted difference from the prior.
struct Strongest;

impl TensorMerger for Strongest {
    fn prepare(&self, _: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        Ok(Box::new(Self))
    }
}

impl TensorRule for Strongest {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        for (k, out) in out.iter_mut().enumerate() {
            let difference =
                |expert: usize| f64::from(tensor.experts[expert][k] - tensor.prior[k]) * at[expert];
            let largest = (0..at.len()).max_by(|a, b| difference(*a).abs().total_cmp(&difference(*b).abs()));
            *out = tensor.prior[k] + largest.map_or(0.0, difference) as f32;
        }
    }
}

impl Entry<dyn Merger> for Strongest {
    const NAME: &'static str = "strongest";
    const SUMMARY: &'static str = "each weight from the expert that changed it most";
    const SOURCE: &'static str = "this example";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self))
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.mergers = registries.parts.mergers.with::<Strongest>()?;
        Ok(registries)
    })
}
