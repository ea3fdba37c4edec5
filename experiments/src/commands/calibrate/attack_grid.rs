//! Attack rates over λ and μ, all attacks or believable ones, from which a dial is fitted.
//!
//! Candidates depend only on λ, and μ only selects among them. So each scene is evaluated once per λ.

use std::sync::Arc;

use anyhow::Result;
use sage_core::{
    generator::Proposal,
    objective::{Candidate, Context, ContextOptions, Evaluation, Objective, Situation, is_believable},
    scene::SceneData,
    statistics,
};
use sage_generators::{
    Aggression, GeneratorInputs, Rate,
    proposers::{MixedExperts, ProposalOptions},
    selector::best_of,
};
use sage_run::scenes::Scenes;

/// What dials are fitted for: objectives, and the λ and the candidates at which they are evaluated.
pub(crate) struct Fitted {
    pub objectives: Vec<Arc<Objective>>,
    pub lambdas: Vec<f64>,
    pub proposals: ProposalOptions,
}

/// Evaluated candidates of every scene at several λ.
pub(crate) struct AttackGrid {
    lambdas: Vec<f64>,
    objective: Arc<Objective>,
    /// By scene, then by λ.
    evaluations: Vec<Vec<Vec<Evaluation>>>,
    /// Whether each of them is a believable attack.
    believable: Vec<Vec<Vec<bool>>>,
}

/// Evaluated candidates of one scene: by objective, then by λ; and by λ which are believable attacks.
struct SceneGrid {
    by_objective: Vec<Vec<Vec<Evaluation>>>,
    believable: Vec<Vec<bool>>,
}

/// The attacks that the selection takes at some λ and μ.
pub struct Attacks {
    /// For each scene 1 if a feasible trajectory hits the ego, else 0.
    pub hits: Vec<f64>,
    /// For each scene 1 if the attack is believable, else 0.
    pub believable: Vec<f64>,
}

impl Attacks {
    /// Share of scenes attacked, or attacked believably.
    pub fn rate(&self, rate: Rate) -> f64 {
        statistics::mean(self.counted(rate)).unwrap_or(0.0)
    }

    fn counted(&self, rate: Rate) -> &[f64] {
        match rate {
            Rate::Attack => &self.hits,
            Rate::Believable => &self.believable,
        }
    }
}

impl AttackGrid {
    /// Evaluates candidates of all scenes at several λ with several objectives, one grid for each
    /// objective. The candidates do not depend on the objectives. Calls `done` after each scene.
    ///
    /// *Errors*: the first scene that fails.
    pub(crate) fn of(
        scenes: &Scenes,
        inputs: &GeneratorInputs,
        fitted: &Fitted,
        seed: u64,
        done: impl FnMut(),
    ) -> Result<Vec<Self>> {
        let Fitted { objectives, lambdas, proposals } = fitted;
        // If any objective needs the prior's likelihood, the proposer must compute it.
        let needs_prior = objectives.iter().find(|objective| objective.needs_prior());
        let selection = needs_prior.unwrap_or(&inputs.selection).clone();
        let proposer =
            MixedExperts(proposals.clone()).proposer(&GeneratorInputs { selection, ..inputs.clone() })?;
        let experts = inputs.experts("sage")?;
        let mixtures =
            lambdas.iter().map(|lambda| experts.between(*lambda)).collect::<Result<Vec<_>, _>>()?;
        let one = |data: &SceneData| -> Result<SceneGrid> {
            let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
            let prepared = proposer.prepare(&data.observe()?)?;
            let mut by_objective = vec![Vec::with_capacity(mixtures.len()); objectives.len()];
            let mut believable = Vec::with_capacity(mixtures.len());
            for mixture in &mixtures {
                let candidate = |p: Proposal| ctx.candidate(p.trajectory).with_nll(p.nll);
                let all: Vec<_> = prepared.propose(mixture, seed)?.into_iter().map(candidate).collect();
                let is_believable = |c: &Candidate| is_believable(&Situation::new(c, ctx.ego(), &ctx));
                believable.push(all.iter().map(is_believable).collect());
                for (objective, found) in objectives.iter().zip(&mut by_objective) {
                    found.push(all.iter().map(|c| compact(objective.evaluate(c, &ctx))).collect());
                }
            }
            Ok(SceneGrid { by_objective, believable })
        };
        let mut scenes = scenes.map(one, done)?;
        let of_objective = |(k, objective): (usize, &Arc<Objective>)| Self {
            lambdas: lambdas.clone(),
            objective: objective.clone(),
            evaluations: scenes.iter_mut().map(|scene| std::mem::take(&mut scene.by_objective[k])).collect(),
            believable: scenes.iter().map(|scene| scene.believable.clone()).collect(),
        };
        Ok(objectives.iter().enumerate().map(of_objective).collect())
    }

    /// The attacks that are selected at λ and μ; `None` for a λ that was not evaluated.
    pub fn attacks(&self, lambda: f64, mu: f64) -> Option<Attacks> {
        let k = self.lambdas.iter().position(|known| (known - lambda).abs() < 1e-9)?;
        let mut attacks = Attacks { hits: Vec::new(), believable: Vec::new() };
        for (scene, believable) in self.evaluations.iter().zip(&self.believable) {
            let chosen = best_of(&scene[k], &self.objective, mu).chosen;
            let selected = &scene[k][chosen];
            attacks.hits.push(f64::from(u8::from(selected.is_attack())));
            attacks.believable.push(f64::from(u8::from(believable[k][chosen])));
        }
        Some(attacks)
    }

    /// Fits the dial for these scenes: the rate rises linearly over `steps` aggressions. The λ must be evenly spaced; if the
    /// objective depends on μ, they are the aggressions.
    ///
    /// *Errors*: fewer than two λ.
    pub fn fit(&self, rate: Rate, steps: usize) -> Result<Aggression> {
        if !self.objective.spec().depends_on_mu() {
            let at = |lambda: &f64| self.attacks(*lambda, 1.0).map_or(0.0, |attacks| attacks.rate(rate));
            let rates: Vec<f64> = self.lambdas.iter().map(at).collect();
            return Ok(Aggression::fit_lambda(&rates, steps)?);
        }
        let grid = mu_grid();
        let at = |lambda: f64, mu: f64| self.attacks(lambda, mu).map_or(0.0, |attacks| attacks.rate(rate));
        let rates: Vec<Vec<f64>> =
            self.lambdas.iter().map(|l| grid.iter().map(|mu| at(*l, *mu)).collect()).collect();
        Ok(Aggression::fit(&grid, &rates)?)
    }
}

/// The evaluation with at most one violation, of the same total cost, and without names: a grid holds
/// hundreds of evaluations per scene.
fn compact(mut evaluation: Evaluation) -> Evaluation {
    let cost = evaluation.cost();
    evaluation.violations.truncate(1);
    evaluation.violations.shrink_to_fit();
    for violation in &mut evaluation.violations {
        violation.cost = cost;
        violation.with = String::new();
    }
    evaluation
}

/// Values of μ from which a dial is fitted. The steps are small near 0, where the attack rate rises.
fn mu_grid() -> Vec<f64> {
    let fine = (0..50).map(|k| f64::from(k) * 0.002);
    let middle = (0..40).map(|k| 0.1 + f64::from(k) * 0.005);
    let coarse = (0..=35).map(|k| 0.3 + f64::from(k) * 0.02);
    fine.chain(middle).chain(coarse).map(|mu| (mu * 1e6).round() / 1e6).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_of_mu_rises_from_0_to_1() {
        let grid = mu_grid();
        assert!(grid[0] == 0.0 && grid[grid.len() - 1] == 1.0 && grid.windows(2).all(|p| p[0] < p[1]));
    }
}
