//! What tuning changed: means over scenes before and after.

use std::sync::Arc;

use anyhow::{Context as _, Result};
use rayon::prelude::*;
use sage_backbones::{
    Backbone, MotionModel, Parameters,
    training::{Expectation, FinetuneOptions, Measures, PreparedScene, preference_margin},
};
use sage_bench::estimate::Samples;
use sage_core::{metric::Aggregate, objective::Objective, scene::SceneData, statistics::Estimate};
use sage_merging::ExpertSet;
use sage_run::progress;
use serde_json::{Value, json};

/// An expert after its tuning.
pub(super) struct Tuned<'a> {
    pub prior: &'a Arc<dyn Backbone>,
    pub weights: Parameters,
    pub options: &'a FinetuneOptions,
    pub objective: &'a Objective,
}

impl Tuned<'_> {
    /// Of an expert that scores the prior's modes: expectations over them.
    ///
    /// *Errors*: those of the networks.
    pub fn by_modes(self, name: &str, train: &[PreparedScene], dev: &[PreparedScene]) -> Result<Vec<Value>> {
        let experts = vec![(name.to_owned(), self.weights.clone())];
        let tuned = ExpertSet::tuned(self.prior.clone(), experts, self.options.tunes)?.model(self.weights)?;
        let mut reports = Vec::new();
        for (set, scenes) in [("train", train), ("dev", dev)] {
            if let Some(before) = expectation(&**self.prior, scenes)? {
                let after = expectation(&*tuned, scenes)?.context("no scene")?;
                reports.push(said(name, set, scenes.len(), [&before, &after]));
            }
        }
        Ok(reports)
    }

    /// Of an expert that has trajectories of its own: expectations over what each network draws, and how much more than the prior it
    /// prefers the better of two that the prior draws.
    ///
    /// *Errors*: those of the networks.
    pub fn by_own_samples(
        self,
        name: &str,
        dev: &[SceneData],
        of_prior: &[PreparedScene],
        measures: &Measures,
    ) -> Result<Vec<Value>> {
        let Some(before) = expectation(&**self.prior, of_prior)? else { return Ok(Vec::new()) };
        let tuned = self.prior.with_parameters(self.weights)?;
        let own = PreparedScene::all(&*tuned, dev, false, measures, |_, _| ())?;
        let after = expectation(&*tuned, &own)?.context("no scene")?;
        let objective = measures.expert(self.objective)?;
        let margin = |scene| preference_margin(&*tuned, &**self.prior, scene, &objective, self.options);
        let margins: Vec<_> = of_prior.par_iter().with_max_len(1).map(margin).collect();
        let margins = margins.into_iter().collect::<Result<Vec<_>, _>>()?;
        let margins: Vec<f64> = margins.into_iter().flatten().collect();
        let mut reports = vec![said(name, "dev", of_prior.len(), [&before, &after])];
        let samples = Samples::of(margins.iter().copied().map(Some));
        if let Some(Estimate { value, low, high, .. }) = samples.estimate(Aggregate::Mean, "margin") {
            progress::say(&format!(
                "{name} on dev, by how much more than the prior it prefers the better of two futures: {value:.2} [{low:.2}, {high:.2}] ({} scenes)",
                margins.len()
            ));
            reports.push(json!({"expert": name, "set": "dev", "margins": margins}));
        }
        Ok(reports)
    }
}

/// Prints expectations before and after, and gives the report.
fn said(name: &str, set: &str, scenes: usize, [before, after]: [&Expectation; 2]) -> Value {
    progress::say(&format!(
        "{name} on {set} ({scenes} role assignments), prior → expert: feasible {:.2} → {:.2}, feasible hits {:.3} → {:.3}, believable {:.3} → {:.3}, R_adv {:.2} → {:.2}, P_real {:.2} → {:.2}",
        before.feasible,
        after.feasible,
        before.attack,
        after.attack,
        before.believable,
        after.believable,
        before.reward,
        after.reward,
        before.penalty,
        after.penalty,
    ));
    json!({"expert": name, "set": set, "role_assignments": scenes, "prior": before, "tuned": after})
}

/// Mean expectations of a policy; `None` without scenes.
fn expectation(policy: &dyn MotionModel, scenes: &[PreparedScene]) -> Result<Option<Expectation>> {
    let all: Vec<_> = scenes.par_iter().with_max_len(1).map(|scene| scene.expectation(policy)).collect();
    Ok(Expectation::mean(&all.into_iter().collect::<Result<Vec<_>, _>>()?))
}
