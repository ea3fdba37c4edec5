//! Proposers of trajectories from the observation up to *now*.
//!
//! In tables, each generator encodes a scene itself, because inputs differ: `sage` uses fewer goals, `most-likely` all,
//! `random` no forecast of the ego.

mod all_goals;
mod cat_goals;
mod mixed_experts;
mod most_likely;
mod random_goals;

use std::sync::Arc;

use sage_backbones::{Backbone, backbone::finite, encoding::Encoding, features::EdgeKinds};
use sage_core::{Error, generator::Observation, geometry::Point, scene::Scene};

pub use all_goals::AllGoals;
pub use cat_goals::CatGoals;
pub use mixed_experts::{MixedExperts, Prior, ProposalOptions};
pub use most_likely::MostLikely;
pub use random_goals::RandomGoals;

/// Number of candidates, and of modes from which they are taken; modes that no car can follow are skipped.
#[derive(Clone, Copy)]
struct Draw {
    candidates: usize,
    modes: usize,
}

impl Draw {
    /// The draw for a network, with its default number of candidates or a given one. Networks that see road
    /// boundaries alone have the 32 candidates of the paper's protocol.
    fn of(candidates: Option<usize>, edges: EdgeKinds) -> Self {
        let (default, modes_per_candidate) = match edges {
            EdgeKinds::Boundaries => (32, 3),
            EdgeKinds::All => (48, 2),
        };
        let candidates = candidates.unwrap_or(default);
        Self { candidates, modes: modes_per_candidate * candidates }
    }
}

/// The adversary's encoding by the prior, without a forecast.
fn encoded(prior: &dyn Backbone, now: &Observation) -> Result<Encoding, sage_backbones::Error> {
    let adversary = now.scene().adversary_index()?;
    prior.encode(Arc::new(prior.features(now, adversary, None)?))
}

/// End of a mode in the world frame.
fn goal(encoding: &Encoding, end: [f32; 2]) -> Point {
    encoding.features().frame.world_from_frame(end.map(f64::from))
}

/// Negative log-likelihood of modes under a prior, up to a shared constant; `None` unless requested.
fn nll(
    prior: &dyn Backbone,
    encoding: &Encoding,
    modes: &[usize],
    is_requested: bool,
) -> Result<Vec<Option<f64>>, sage_backbones::Error> {
    if !is_requested {
        return Ok(vec![None; modes.len()]);
    }
    let log_probs: Vec<f64> = finite(&prior.relative_log_probs(encoding, modes)?)?;
    Ok(log_probs.into_iter().map(|log_prob| Some(-log_prob)).collect())
}

/// Converts a network's error to an error of the scene.
fn in_scene(scene: &Scene, error: impl Into<crate::Error>) -> Error {
    match error.into() {
        crate::Error::Core(error) | crate::Error::Network(sage_backbones::Error::Core(error)) => error,
        other => Error::Scene { scene: scene.id.clone(), problem: other.to_string() },
    }
}

/// Checks the number of candidates, if it is given.
fn check_candidates(candidates: Option<usize>) -> Result<(), String> {
    match candidates.filter(|count| !(1..=1024).contains(count)) {
        None => Ok(()),
        Some(count) => Err(format!("`candidates` is {count}; expected 1 to 1024")),
    }
}
