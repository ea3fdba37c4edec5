//! Choice by the learned score: the mean of the predicted collision and of the predicted change of the ego's path.

use std::sync::Arc;

use sage_core::{
    Error,
    generator::Proposal,
    motion::Trajectory,
    objective::{Context, EgoPath},
};
use sage_generators::selector::{Choice, Selector};

use super::path::relative_paths;
use crate::seal::networks::{CriticalityNetwork, SealWeights};

/// Selects the proposal of the highest score, summed over the paths of the ego; the first of equals.
pub(super) struct CriticalitySelector(pub Arc<SealWeights>);

impl Selector for CriticalitySelector {
    fn select(&self, proposals: &[Proposal], ctx: &Context, _: f64) -> Result<Choice, Error> {
        let plans: Vec<&Trajectory> = proposals.iter().map(|proposal| &proposal.trajectory).collect();
        let scores = learned_scores(&self.0.criticality, &plans, ctx, ctx.egos()).map_err(|error| {
            Error::Scene { scene: ctx.scene().id.clone(), problem: format!("learned score: {error}") }
        })?;
        let best = (0..scores.len()).rev().max_by(|a, b| scores[*a].total_cmp(&scores[*b]));
        Ok(Choice { chosen: best.unwrap_or(0), note: None })
    }
}

/// Scores of plans, summed over paths of the ego: the mean of the network's two outputs, in [0, 1] for one path.
///
/// *Errors*: [`sage_backbones::Error::NotFinite`].
pub fn learned_scores(
    network: &CriticalityNetwork,
    plans: &[&Trajectory],
    ctx: &Context,
    egos: &[EgoPath],
) -> Result<Vec<f64>, sage_backbones::Error> {
    let paths =
        plans.iter().flat_map(|plan| relative_paths(ctx.scene(), ctx.adversary(), plan.points(), egos));
    let scores = network.scores(&paths.collect::<Vec<_>>())?;
    let of_plan = |scores: &[[f64; 2]]| scores.iter().map(|[a, b]| 0.5 * (a + b)).sum();
    Ok(scores.chunks(egos.len().max(1)).map(of_plan).collect())
}
