//! The greedy soup: experts are added to a uniform mean in the order of their own value, as long as the value of the
//! mean does not fall (Wortsman et al. 2022).
//!
//! The value of a mixture is the mean value of the attacks that SAGE selects with it.

use std::path::PathBuf;

use advsage::{Registries, generators::Generators, part::Part, selection::Selection};
use anyhow::{Context as _, Result};
use sage_core::{
    generator::{Mixture, OperatingPoint},
    objective::{Context, ContextOptions},
    scene::SceneData,
};
use sage_merging::ExpertSet;
use sage_run::{
    progress::{self, Progress},
    scenes::Scenes,
};

/// What a soup is selected by.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Search {
    /// Files and folders of scenes, none of which should be used for a test.
    pub(super) scenes: Vec<String>,
    /// Objective of the selection.
    pub(super) selection: String,
    /// Weight μ of the selection.
    pub(super) mu: f64,
}

/// A step of the search.
pub(super) struct Step {
    /// Name of the expert that was tried.
    pub(super) expert: String,
    /// Its own value, and that of the soup with it.
    pub(super) own: f64,
    pub(super) with_it: f64,
    pub(super) is_kept: bool,
}

impl Search {
    /// The weights of the soup, in the order of the set, the steps that led to it, and how many scenes failed.
    ///
    /// *Errors*: no scene can be attacked; those of the networks.
    pub(super) fn run(
        &self,
        paths: &[PathBuf],
        experts: &ExpertSet,
        registries: &Registries,
        seed: u64,
    ) -> Result<(Mixture, Vec<Step>, usize)> {
        let selection = Selection::of(registries, &self.selection, None)?;
        let scenes = Scenes::under(paths)?.attackable()?;
        let generators = Generators::new(registries, &Part::named("linear"), &selection, seed)?;
        let sage = Part::named("sage").build(&registries.generators)?;
        let generator = sage.build(generators.with_experts(experts).inputs())?;
        let values = |mixtures: &[Mixture]| -> Result<Vec<f64>> {
            let points: Vec<OperatingPoint> = mixtures
                .iter()
                .map(|mixture| OperatingPoint { mixture: mixture.clone(), mu: self.mu })
                .collect();
            let one = |data: &SceneData| -> Result<Vec<f64>> {
                let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
                let attacks = generator.attacks(&ctx, &points, seed)?;
                let value = |attack: &sage_core::generator::Attack| {
                    let candidate = ctx.candidate(attack.trajectory().clone());
                    let candidate = candidate.with_nll(attack.candidates[attack.chosen].nll);
                    let evaluation = selection.objective.evaluate(&candidate, &ctx);
                    selection.objective.value(&evaluation, self.mu) - evaluation.cost()
                };
                Ok(attacks.iter().map(value).collect())
            };
            let all = scenes.map(one, || {})?;
            Ok((0..points.len()).map(|k| all.iter().map(|v| v[k]).sum::<f64>() / all.len() as f64).collect())
        };
        let names = experts.names();
        let alone = |k: usize| of_members(names.len(), &[k]);
        let own = values(&(0..names.len()).map(alone).collect::<Vec<_>>())?;
        let mut progress = Progress::new("tried", names.len());
        let found = greedy(&own, |members| {
            progress.step();
            Ok(values(&[of_members(names.len(), members)])?[0])
        })?;
        progress.finish(&format!("{} in the soup", progress::count(found.members.len(), "expert")));
        let step = |(expert, with_it, is_kept): &(usize, f64, bool)| Step {
            expert: names[*expert].to_owned(),
            own: own[*expert],
            with_it: *with_it,
            is_kept: *is_kept,
        };
        let soup = of_members(names.len(), &found.members);
        Ok((soup, found.steps.iter().map(step).collect(), scenes.failure_count()))
    }
}

/// Equal weights of some experts.
fn of_members(experts: usize, members: &[usize]) -> Mixture {
    let share = 1.0 / members.len() as f64;
    Mixture::new((0..experts).map(|k| if members.contains(&k) { share } else { 0.0 }).collect())
}

/// The result of a search.
struct Found {
    members: Vec<usize>,
    /// Index of an expert, value of the soup with it, whether it stayed.
    steps: Vec<(usize, f64, bool)>,
}

/// Adds experts from the best to the worst and keeps each that does not lower the value.
fn greedy(own: &[f64], mut value: impl FnMut(&[usize]) -> Result<f64>) -> Result<Found> {
    let mut order: Vec<usize> = (0..own.len()).collect();
    order.sort_by(|a, b| own[*b].total_cmp(&own[*a]));
    let first = *order.first().context("a soup needs an expert")?;
    let mut found = Found { members: vec![first], steps: vec![(first, own[first], true)] };
    let mut best = own[first];
    for &expert in &order[1..] {
        let tried = [&found.members[..], &[expert]].concat();
        let with_it = value(&tried)?;
        let is_kept = with_it >= best;
        found.steps.push((expert, with_it, is_kept));
        if is_kept {
            (found.members, best) = (tried, with_it);
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_expert_stays_if_the_value_does_not_fall() {
        // The best is 1. With 2 the soup falls, with 0 it stays the same.
        let value = |members: &[usize]| {
            Ok(match members {
                [1, 2] => 2.0,
                [1, 0] => 3.0,
                _ => panic!("{members:?} was not to be tried"),
            })
        };
        let found = greedy(&[1.0, 3.0, 2.0], value).unwrap();
        assert_eq!(found.members, [1, 0]);
        assert_eq!(found.steps, [(1, 3.0, true), (2, 2.0, false), (0, 3.0, true)]);
        assert_eq!(of_members(3, &found.members).weights(), [0.5, 0.5, 0.0]);
        assert!(greedy(&[], |_| Ok(0.0)).is_err());
    }
}
