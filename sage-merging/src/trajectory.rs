//! Trajectory mixing: candidates of the experts are paired, and the weighted mean of a pair is a candidate of the
//! mixture.
//!
//! Each expert's candidates are its likeliest modes with a minimum spacing, in the order of their
//! probability. They are paired by rank, or each candidate of the expert with the largest weight with the
//! nearest free one of every other expert. The log-probability of a pair is the weighted mean of those that the
//! experts give to the mean trajectory, renormalised over all pairs. Property: at a corner it is the expert, bit for bit.

use std::sync::Arc;

use sage_backbones::{
    Error as NetworkError, MotionModel,
    backbone::finite,
    candidates::{Sampling, select},
    candle::Tensor,
    encoding::{Encoding, ModelId},
    features::STRIDE,
    smooth_path,
};
use sage_core::{generator::Mixture, registry::Entry, seed::Rng};
use serde::{Deserialize, Serialize};

use crate::{
    Error, ExpertSet, Merger, Range,
    output_mixture::{Members, at_corner, log_sum_exp, tensor},
};

/// Options of [`TrajectoryMixing`].
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrajectoryOptions {
    /// Number of candidates of each expert.
    pub candidates: usize,
    /// Least distance between the ends of an expert's candidates, metres.
    pub apart: f32,
    /// How candidates are paired.
    pub pairs: Pairs,
}

impl Default for TrajectoryOptions {
    fn default() -> Self {
        Self { candidates: 96, apart: 3.0, pairs: Pairs::Rank }
    }
}

/// How candidates of the experts are paired.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pairs {
    /// The k-th likeliest of each.
    Rank,
    /// The nearest end points.
    End,
}

/// Weighted means of the experts' trajectories.
#[derive(Clone, Copy)]
pub struct TrajectoryMixing(TrajectoryOptions);

impl Merger for TrajectoryMixing {
    fn range(&self) -> Range {
        Range::Simplex
    }

    fn keeps_modes(&self) -> bool {
        false
    }

    fn model(&self, experts: &ExpertSet, at: &Mixture, _: u64) -> Result<Arc<dyn MotionModel>, Error> {
        if let Some(expert) = at_corner(experts, at)? {
            return Ok(expert);
        }
        let (members, options) = (Members::of(experts, at)?, self.0);
        Ok(Arc::new(MeanTrajectories { id: ModelId::unique(), members, options }))
    }
}

struct MeanTrajectories {
    id: ModelId,
    members: Members,
    options: TrajectoryOptions,
}

/// Paired candidates of one encoding.
struct Paired {
    /// Log-probabilities of each expert.
    own: Vec<Tensor>,
    /// For each expert, its mode in each pair.
    modes: Vec<Vec<usize>>,
    /// Log-probability of each pair.
    log_probs: Vec<f64>,
    /// What the renormalisation subtracts.
    total: f64,
    /// Mean end of each pair, metres, target frame.
    ends: Vec<[f32; 2]>,
}

impl MeanTrajectories {
    fn paired(&self, encoding: &Encoding) -> Result<Arc<Paired>, NetworkError> {
        encoding.keep(self.id, || self.pair(encoding))
    }

    fn pair(&self, encoding: &Encoding) -> Result<Paired, NetworkError> {
        let Members { models, weights, .. } = &self.members;
        let TrajectoryOptions { candidates, apart, pairs } = self.options;
        let ends: Vec<_> = models.iter().map(|model| model.mode_ends(encoding)).collect::<Result<_, _>>()?;
        let own = models.iter().map(|model| model.log_probs(encoding)).collect::<Result<Vec<_>, _>>()?;
        let chosen = |(log_probs, ends): (&Tensor, &Vec<[f32; 2]>)| -> Result<Vec<usize>, NetworkError> {
            // Suppression draws nothing.
            let mut rng = Rng::new(0, "trajectory mixing", "none");
            let policy = finite::<f32>(log_probs)?;
            Ok(select(&policy, ends, candidates, Sampling::Nms { radius: apart }, &mut rng))
        };
        let ranked = own.iter().zip(&ends).map(chosen).collect::<Result<Vec<_>, _>>()?;
        let modes = match pairs {
            Pairs::Rank => ranked,
            Pairs::End => by_end(ranked, weights, &ends),
        };
        let count = modes.iter().map(Vec::len).min().unwrap_or(0);
        // Each expert scores the mean trajectory in place of its own.
        let all: Vec<usize> = (0..count).collect();
        let points = smooth_path::every(&self.mean_trajectories(encoding, &modes, &all)?, STRIDE)?;
        let means = self.mean_log_probs(encoding, &own, &modes, &all, &points)?;
        let total = log_sum_exp(&means);
        let end = |pair: usize| {
            [0, 1].map(|axis| {
                let terms = (0..weights.len()).map(|k| weights[k] * f64::from(ends[k][modes[k][pair]][axis]));
                terms.sum::<f64>() as f32
            })
        };
        Ok(Paired {
            log_probs: means.iter().map(|mean| mean - total).collect(),
            ends: (0..count).map(end).collect(),
            own,
            modes,
            total,
        })
    }
}

impl MeanTrajectories {
    /// Mean trajectories of some pairs; `modes` are each expert's modes by pair.
    fn mean_trajectories(
        &self,
        encoding: &Encoding,
        modes: &[Vec<usize>],
        pairs: &[usize],
    ) -> Result<Tensor, NetworkError> {
        let Members { models, weights, .. } = &self.members;
        let mut mean: Option<Tensor> = None;
        for ((own, weight), model) in modes.iter().zip(weights).zip(models) {
            let own: Vec<usize> = pairs.iter().map(|&pair| own[pair]).collect();
            let part = (model.trajectories(encoding, &own)? * *weight)?;
            mean = Some(match mean {
                None => part,
                Some(mean) => (mean + part)?,
            });
        }
        mean.ok_or_else(|| NetworkError::Mismatch("a mixture of no trajectories".to_owned()))
    }

    /// Mean log-probabilities of some pairs along points, without renormalisation.
    fn mean_log_probs(
        &self,
        encoding: &Encoding,
        own: &[Tensor],
        modes: &[Vec<usize>],
        pairs: &[usize],
        points: &Tensor,
    ) -> Result<Vec<f64>, NetworkError> {
        let Members { models, weights, .. } = &self.members;
        let mut mean = vec![0.0; pairs.len()];
        for (k, model) in models.iter().enumerate() {
            let members: Vec<usize> = pairs.iter().map(|&pair| modes[k][pair]).collect();
            let along = finite::<f64>(&model.log_probs_along(encoding, &own[k], &members, points)?)?;
            mean.iter_mut().zip(along).for_each(|(mean, along)| *mean += weights[k] * along);
        }
        Ok(mean)
    }
}

/// Reorders the candidates of all experts but the heaviest, so that each is near its partner's end.
fn by_end(ranked: Vec<Vec<usize>>, weights: &[f64], ends: &[Vec<[f32; 2]>]) -> Vec<Vec<usize>> {
    let heaviest = (0..weights.len()).rev().max_by(|a, b| weights[*a].total_cmp(&weights[*b])).unwrap_or(0);
    let leading = ranked[heaviest].clone();
    let gap = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let partners = |(k, mut free): (usize, Vec<usize>)| {
        if k == heaviest {
            return free;
        }
        let nearest = |lead: &usize| {
            let away = |at: &usize| gap(ends[k][free[*at]], ends[heaviest][*lead]);
            let at = (0..free.len()).min_by(|a, b| away(a).total_cmp(&away(b)))?;
            Some(free.remove(at))
        };
        leading.iter().filter_map(nearest).collect()
    };
    ranked.into_iter().enumerate().map(partners).collect()
}

impl MotionModel for MeanTrajectories {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, NetworkError> {
        tensor(self.paired(encoding)?.log_probs.iter().copied())
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, NetworkError> {
        Ok(self.paired(encoding)?.ends.clone())
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, NetworkError> {
        self.mean_trajectories(encoding, &self.paired(encoding)?.modes, modes)
    }

    fn log_probs_along(
        &self,
        encoding: &Encoding,
        _: &Tensor,
        modes: &[usize],
        points: &Tensor,
    ) -> Result<Tensor, NetworkError> {
        let paired = self.paired(encoding)?;
        let means = self.mean_log_probs(encoding, &paired.own, &paired.modes, modes, points)?;
        tensor(means.into_iter().map(|mean| mean - paired.total))
    }

    /// The prior's mode that ends nearest to the mean end.
    fn modes_of_prior(&self, encoding: &Encoding, modes: &[usize]) -> Result<Vec<usize>, NetworkError> {
        let (ends, paired) = (self.members.prior.mode_ends(encoding)?, self.paired(encoding)?);
        let nearest = |&pair: &usize| {
            let [x, y] = paired.ends[pair];
            let gap = |mode: &usize| (ends[*mode][0] - x).hypot(ends[*mode][1] - y);
            (0..ends.len()).min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap_or(0)
        };
        Ok(modes.iter().map(nearest).collect())
    }
}

impl Entry<dyn Merger> for TrajectoryMixing {
    const NAME: &'static str = "trajectory";
    const SUMMARY: &'static str =
        "weighted means of the experts' trajectories, paired by rank or by end point";
    const SOURCE: &'static str = "SAGE (ICLR 2026): the baseline of output-space mixing";
    type Options = TrajectoryOptions;

    fn build(options: TrajectoryOptions) -> Result<Box<dyn Merger>, String> {
        if !(1..=1024).contains(&options.candidates) {
            return Err(format!("`candidates` is {}; expected 1 to 1024", options.candidates));
        }
        if !(0.0..=100.0).contains(&options.apart) {
            return Err(format!("`apart` is {}; expected 0 to 100 metres", options.apart));
        }
        Ok(Box::new(Self(options)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_free_candidates_become_partners() {
        let ends = [(); 2].map(|()| vec![[0.0, 0.0], [10.0, 0.0], [1.0, 0.0], [9.0, 0.0]]);
        // The second expert is heavier: its modes 2 and 3 take the nearest of 1 and 0.
        let modes = by_end(vec![vec![1, 0], vec![2, 3]], &[0.4, 0.6], &ends);
        assert_eq!(modes, [[0, 1], [2, 3]]);
    }
}
