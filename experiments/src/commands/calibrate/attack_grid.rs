//! Attack rates over λ and μ, all attacks or believable ones, from which a dial is fitted.

use anyhow::Result;
use sage_core::{
    generator::OperatingPoint,
    objective::{Context, ContextOptions, Situation, is_believable},
    scene::SceneData,
    statistics,
};
use sage_generators::{Aggression, GeneratorInputs, GeneratorKind, Rate};
use sage_run::scenes::Scenes;

/// Whether the attack that a generator selects hits the ego feasibly, and whether a person would believe it.
#[derive(Clone, Copy)]
struct Selected {
    hits: bool,
    believable: bool,
}

/// The attacks of a generator in every scene at several λ and μ.
pub(crate) struct AttackGrid {
    lambdas: Vec<f64>,
    mus: Vec<f64>,
    /// By scene, λ and μ.
    selected: Vec<Vec<Vec<Selected>>>,
}

/// The attacks at some λ and μ.
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
    /// Attacks all scenes at several λ, and at many μ if the selection depends on it. Calls `done` after each scene.
    ///
    /// *Errors*: the first scene that fails.
    pub(crate) fn of(
        scenes: &Scenes,
        generator: &dyn GeneratorKind,
        inputs: &GeneratorInputs,
        lambdas: Vec<f64>,
        done: impl FnMut(),
    ) -> Result<Self> {
        let objective = &inputs.selection;
        let mus = if objective.spec().depends_on_mu() { mu_grid() } else { vec![1.0] };
        let built = generator.build(inputs)?;
        let experts = inputs.experts("sage")?;
        let mixtures =
            lambdas.iter().map(|lambda| experts.between(*lambda)).collect::<Result<Vec<_>, _>>()?;
        let one = |data: &SceneData| -> Result<Vec<Vec<Selected>>> {
            let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
            let mut all = Vec::with_capacity(mixtures.len());
            for mixture in &mixtures {
                let at = |mu: &f64| OperatingPoint { mixture: mixture.clone(), mu: *mu };
                let points: Vec<OperatingPoint> = mus.iter().map(at).collect();
                let selected = built.attacks(&ctx, &points, inputs.seed)?.into_iter().map(|attack| {
                    let candidate = ctx.candidate(attack.trajectory().clone());
                    Selected {
                        hits: objective.evaluate(&candidate, &ctx).is_attack(),
                        believable: is_believable(&Situation::new(&candidate, ctx.ego(), &ctx)),
                    }
                });
                all.push(selected.collect());
            }
            Ok(all)
        };
        let selected = scenes.map(one, done)?;
        Ok(Self { lambdas, mus, selected })
    }

    /// The attacks at λ and μ; `None` for values that were not evaluated.
    pub fn attacks(&self, lambda: f64, mu: f64) -> Option<Attacks> {
        let position =
            |values: &[f64], value: f64| values.iter().position(|known| (known - value).abs() < 1e-9);
        let (l, m) = (position(&self.lambdas, lambda)?, position(&self.mus, mu)?);
        let count = |is: fn(&Selected) -> bool| {
            self.selected.iter().map(|scene| f64::from(u8::from(is(&scene[l][m])))).collect()
        };
        Some(Attacks {
            hits: count(|selected| selected.hits),
            believable: count(|selected| selected.believable),
        })
    }

    /// Fits the dial for these scenes: the rate rises linearly over `steps` aggressions. The λ must be evenly spaced; if the
    /// objective depends on μ, they are the aggressions.
    ///
    /// *Errors*: fewer than two λ.
    pub fn fit(&self, rate: Rate, steps: usize) -> Result<Aggression> {
        let at = |lambda: f64, mu: f64| self.attacks(lambda, mu).map_or(0.0, |attacks| attacks.rate(rate));
        if self.mus.len() == 1 {
            let rates: Vec<f64> = self.lambdas.iter().map(|lambda| at(*lambda, 1.0)).collect();
            return Ok(Aggression::fit_lambda(&rates, steps)?);
        }
        let rates: Vec<Vec<f64>> =
            self.lambdas.iter().map(|l| self.mus.iter().map(|mu| at(*l, *mu)).collect()).collect();
        Ok(Aggression::fit(&self.mus, &rates)?)
    }
}

/// Values of μ from which a dial is fitted. The steps are small near 0, where the attack rate rises.
fn mu_grid() -> Vec<f64> {
    let fine = (0..50).map(|k| f64::from(k) * 0.002);
    let middle = (0..40).map(|k| 0.1 + f64::from(k) * 0.005);
    let coarse = (0..=7).map(|k| 0.3 + f64::from(k) * 0.1);
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
