//! Attack rates over λ and μ, all attacks or believable ones, their deviation from a straight line, and the share of each in the change.
//!
//! Candidates depend only on λ, and μ only selects among them. So each scene is evaluated once per λ.

use std::sync::Arc;

use anyhow::Result;
use sage_core::{
    generator::Proposal,
    objective::{Candidate, Context, ContextOptions, Evaluation, Objective, Situation, is_believable},
    scene::SceneData,
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_generators::{
    Aggression, GeneratorInputs, ProposerKind, Rate, proposers::MixedExperts, selector::best_of,
};

use crate::scenes::Scenes;

/// Resamples of an interval.
const RESAMPLES: usize = 2000;

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
    /// Adversarial reward of each scene.
    pub rewards: Vec<f64>,
}

impl Attacks {
    /// Share of scenes attacked, or attacked believably.
    pub fn rate(&self, rate: Rate) -> f64 {
        statistics::mean(self.counted(rate)).unwrap_or(0.0)
    }

    /// Share of scenes with its 95 % interval (Wilson).
    pub fn rate_estimate(&self, rate: Rate) -> Option<Estimate> {
        let counted = self.counted(rate);
        statistics::wilson(counted.iter().filter(|one| **one > 0.0).count(), counted.len())
    }

    fn counted(&self, rate: Rate) -> &[f64] {
        match rate {
            Rate::Attack => &self.hits,
            Rate::Believable => &self.believable,
        }
    }

    /// Mean reward.
    pub fn reward(&self) -> f64 {
        statistics::mean(&self.rewards).unwrap_or(0.0)
    }

    /// Mean reward with its 95 % interval.
    pub fn reward_estimate(&self) -> Option<Estimate> {
        statistics::bootstrap_mean(&self.rewards, RESAMPLES, &mut Rng::new(0, "reward", "dial"))
    }
}

/// Deviation of attack rates from the straight line between their ends.
#[derive(Clone, Copy, Debug)]
pub struct Linearity {
    /// Root mean square of the distances from the line.
    pub rms: f64,
    /// Largest distance from the line.
    pub worst: f64,
    /// Largest drop between neighbouring rates, scenes.
    pub largest_drop: f64,
    /// Last rate minus the first.
    pub span: f64,
}

impl Linearity {
    /// Of attacks at evenly spaced operating points of a sweep.
    pub fn of(attacks: &[&Attacks], rate: Rate) -> Self {
        let rates: Vec<f64> = attacks.iter().map(|a| a.rate(rate)).collect();
        let (low, high) = (rates[0], rates[rates.len() - 1]);
        let line = |k: usize| low + (high - low) * k as f64 / (rates.len() - 1).max(1) as f64;
        let distances: Vec<f64> = rates.iter().enumerate().map(|(k, rate)| (rate - line(k)).abs()).collect();
        let scenes = attacks[0].hits.len() as f64;
        let drop = rates.windows(2).map(|pair| pair[0] - pair[1]).fold(0.0, f64::max);
        Self {
            rms: (distances.iter().map(|d| d * d).sum::<f64>() / distances.len() as f64).sqrt(),
            worst: distances.iter().copied().fold(0.0, f64::max),
            largest_drop: (drop * scenes).round(),
            span: high - low,
        }
    }
}

/// Shapley share of λ in the change of a value when λ and μ rise from 0 to 1: the mean of the changes by λ
/// at μ = 0 and at μ = 1, divided by the whole change. The rest is the share of μ. `None` if nothing changes.
pub fn shapley_of_lambda(value: impl Fn(f64, f64) -> f64) -> Option<f64> {
    let [none, lambda, mu, both] = [value(0.0, 0.0), value(1.0, 0.0), value(0.0, 1.0), value(1.0, 1.0)];
    (both != none).then(|| 0.5 * ((lambda - none) + (both - mu)) / (both - none))
}

impl AttackGrid {
    /// Evaluates SAGE's candidates of all scenes at several λ with several objectives, one grid for each
    /// objective. The candidates do not depend on the objectives. Calls `done` after each scene.
    ///
    /// *Errors*: the first scene that fails.
    pub(crate) fn of(
        scenes: &Scenes,
        inputs: &GeneratorInputs,
        objectives: &[Arc<Objective>],
        lambdas: &[f64],
        seed: u64,
        done: impl FnMut(),
    ) -> Result<Vec<Self>> {
        // If any objective needs the prior's likelihood, the proposer must compute it.
        let needs_prior = objectives.iter().find(|objective| objective.needs_prior());
        let selection = needs_prior.unwrap_or(&inputs.selection).clone();
        let proposer = MixedExperts::default().build(&GeneratorInputs { selection, ..inputs.clone() })?;
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
            lambdas: lambdas.to_vec(),
            objective: objective.clone(),
            evaluations: scenes.iter_mut().map(|scene| std::mem::take(&mut scene.by_objective[k])).collect(),
            believable: scenes.iter().map(|scene| scene.believable.clone()).collect(),
        };
        Ok(objectives.iter().enumerate().map(of_objective).collect())
    }

    /// The attacks that are selected at λ and μ; `None` for a λ that was not evaluated.
    pub fn attacks(&self, lambda: f64, mu: f64) -> Option<Attacks> {
        let k = self.lambdas.iter().position(|known| (known - lambda).abs() < 1e-9)?;
        let mut attacks = Attacks { hits: Vec::new(), believable: Vec::new(), rewards: Vec::new() };
        for (scene, believable) in self.evaluations.iter().zip(&self.believable) {
            let chosen = best_of(&scene[k], &self.objective, mu).chosen;
            let selected = &scene[k][chosen];
            attacks.hits.push(f64::from(u8::from(selected.is_attack())));
            attacks.believable.push(f64::from(u8::from(believable[k][chosen])));
            attacks.rewards.push(selected.adversarial);
        }
        Some(attacks)
    }

    /// Fits the dial for these scenes: the rate rises linearly. The λ must be evenly spaced.
    ///
    /// *Errors*: fewer than two λ.
    pub fn fit(&self, rate: Rate) -> Result<Aggression> {
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

    fn attacks(rate: f64) -> Attacks {
        let hits = (0..10).map(|k| f64::from(u8::from(f64::from(k) < 10.0 * rate - 1e-9))).collect();
        Attacks { believable: vec![0.0; 10], hits, rewards: vec![rate; 10] }
    }

    #[test]
    fn a_straight_rise_is_linear_and_a_jump_is_not() {
        let rise = [0.0, 0.2, 0.4, 0.6, 0.8].map(attacks);
        let linearity = Linearity::of(&rise.each_ref(), Rate::Attack);
        assert!(
            linearity.rms < 1e-12 && linearity.largest_drop == 0.0 && (linearity.span - 0.8).abs() < 1e-12
        );
        let jump = [0.0, 0.8, 0.7, 0.8].map(attacks);
        let jump = Linearity::of(&jump.each_ref(), Rate::Attack);
        assert!((jump.worst - (0.8 - 0.8 / 3.0)).abs() < 1e-12 && jump.largest_drop == 1.0);
    }

    #[test]
    fn shapley_shares_the_change_between_lambda_and_mu() {
        assert_eq!(shapley_of_lambda(|lambda, mu| 1.0 + lambda + 3.0 * mu), Some(0.25));
        assert_eq!(shapley_of_lambda(|lambda, mu| lambda * mu), Some(0.5));
        assert_eq!(shapley_of_lambda(|_, _| 1.0), None);
    }

    #[test]
    fn the_grid_of_mu_rises_from_0_to_1() {
        let grid = mu_grid();
        assert!(grid[0] == 0.0 && grid[grid.len() - 1] == 1.0 && grid.windows(2).all(|p| p[0] < p[1]));
    }
}
