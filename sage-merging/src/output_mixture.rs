//! A model whose log-probabilities combine those of several experts. Trajectories are the prior's where fine-tuning does not
//! change them; else the model has the modes of all experts.

use std::sync::Arc;

use sage_backbones::{
    Backbone, Error as NetworkError, MotionModel,
    backbone::{Shared, finite},
    candle::{Device, Tensor},
    encoding::{Encoding, ModelId},
};
use sage_core::generator::Mixture;

use crate::{Error, ExpertSet};

/// How the log-probabilities of one mode combine.
pub(crate) trait Combination: Send + Sync + Copy + 'static {
    /// The combined log-probability, up to a constant; each expert has a weight above 0.
    fn combine(weights: &[f64], log_probs: &[f64]) -> f64;
}

/// The experts that take part in a mixture.
pub(crate) struct Members {
    pub(crate) prior: Arc<dyn Backbone>,
    pub(crate) models: Vec<Arc<dyn MotionModel>>,
    pub(crate) weights: Vec<f64>,
}

impl Members {
    /// The experts with a weight above 0.
    ///
    /// *Errors*: none for a checked set.
    pub(crate) fn of(experts: &ExpertSet, at: &Mixture) -> Result<Self, Error> {
        let (mut models, mut weights) = (Vec::new(), Vec::new());
        for ((_, parameters), weight) in experts.experts().iter().zip(at.weights()) {
            if *weight > 0.0 {
                models.push(experts.model(parameters.clone())?);
                weights.push(*weight);
            }
        }
        Ok(Self { prior: experts.prior().clone(), models, weights })
    }
}

/// The model at a corner of the simplex: the expert itself.
///
/// *Errors*: none for a checked set.
pub(crate) fn at_corner(experts: &ExpertSet, at: &Mixture) -> Result<Option<Arc<dyn MotionModel>>, Error> {
    let Some(corner) = at.corner() else { return Ok(None) };
    Ok(Some(experts.model(experts.experts()[corner].1.clone())?))
}

/// Experts whose log-probabilities are combined.
pub(crate) struct OutputMixture<C> {
    id: ModelId,
    members: Members,
    combination: std::marker::PhantomData<C>,
}

impl<C: Combination> OutputMixture<C> {
    /// The model at a mixture on the simplex.
    ///
    /// *Errors*: none for a checked set.
    pub(crate) fn model(experts: &ExpertSet, at: &Mixture) -> Result<Arc<dyn MotionModel>, Error> {
        if let Some(expert) = at_corner(experts, at)? {
            return Ok(expert);
        }
        let members = Members::of(experts, at)?;
        if experts.prior().shared() != Shared::Trajectories {
            return Ok(Arc::new(AllModes(members)));
        }
        Ok(Arc::new(Self { id: ModelId::unique(), members, combination: std::marker::PhantomData }))
    }

    /// Combined log-probabilities from those of each expert, without renormalisation.
    fn combined(&self, all: &[Vec<f64>]) -> Vec<f64> {
        let weights = &self.members.weights;
        let of_mode = |mode: usize| -> f64 {
            let log_probs: Vec<f64> = all.iter().map(|log_probs| log_probs[mode]).collect();
            C::combine(weights, &log_probs)
        };
        (0..all[0].len()).map(of_mode).collect()
    }

    /// Log-probabilities of each expert, computed once per encoding.
    fn own(&self, encoding: &Encoding) -> Result<Arc<Vec<Tensor>>, NetworkError> {
        let of = |model: &Arc<dyn MotionModel>| model.log_probs(encoding);
        encoding.keep(self.id, || self.members.models.iter().map(of).collect())
    }
}

fn numbers(tensors: &[Tensor]) -> Result<Vec<Vec<f64>>, NetworkError> {
    tensors.iter().map(finite::<f64>).collect()
}

impl<C: Combination> MotionModel for OutputMixture<C> {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, NetworkError> {
        let combined = self.combined(&numbers(&self.own(encoding)?)?);
        let total = log_sum_exp(&combined);
        tensor(combined.iter().map(|log_prob| log_prob - total))
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, NetworkError> {
        self.members.prior.mode_ends(encoding)
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, NetworkError> {
        self.members.prior.trajectories(encoding, modes)
    }

    fn log_probs_along(
        &self,
        encoding: &Encoding,
        log_probs: &Tensor,
        modes: &[usize],
        points: &Tensor,
    ) -> Result<Tensor, NetworkError> {
        let own = self.own(encoding)?;
        let experts = self.members.models.iter().zip(&*own);
        let along = experts.map(|(model, own)| model.log_probs_along(encoding, own, modes, points));
        let along = self.combined(&numbers(&along.collect::<Result<Vec<_>, _>>()?)?);
        let plain = self.combined(&numbers(&own)?);
        // Both are up to the same constant, which the given log-probabilities have without.
        let given = finite::<f64>(log_probs)?;
        tensor(modes.iter().zip(along).map(|(&mode, along)| given[mode] + along - plain[mode]))
    }
}

/// The mixture of experts that have modes of their own: the modes of all, each expert's with the share that is its weight.
struct AllModes(Members);

impl AllModes {
    /// Modes of each expert by their numbers, from modes of all.
    fn by_expert(&self, encoding: &Encoding, modes: &[usize]) -> Result<Vec<(usize, usize)>, NetworkError> {
        let mut starts = vec![0];
        for model in &self.0.models {
            starts.push(starts[starts.len() - 1] + model.mode_ends(encoding)?.len());
        }
        let of = |&mode: &usize| {
            let expert = starts.partition_point(|start| *start <= mode) - 1;
            (expert, mode - starts[expert])
        };
        Ok(modes.iter().map(of).collect())
    }
}

impl MotionModel for AllModes {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, NetworkError> {
        let mut all = Vec::new();
        for (model, weight) in self.0.models.iter().zip(&self.0.weights) {
            let own = finite::<f64>(&model.log_probs(encoding)?)?;
            all.extend(own.into_iter().map(|log_prob| log_prob + weight.ln()));
        }
        tensor(all.into_iter())
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, NetworkError> {
        let all = self.0.models.iter().map(|model| model.mode_ends(encoding));
        Ok(all.collect::<Result<Vec<_>, _>>()?.concat())
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, NetworkError> {
        let one = |(expert, mode): (usize, usize)| self.0.models[expert].trajectories(encoding, &[mode]);
        let all = self.by_expert(encoding, modes)?.into_iter().map(one).collect::<Result<Vec<_>, _>>()?;
        Ok(Tensor::cat(&all, 0)?)
    }

    fn modes_of_prior(&self, encoding: &Encoding, modes: &[usize]) -> Result<Vec<usize>, NetworkError> {
        Ok(self.by_expert(encoding, modes)?.into_iter().map(|(_, mode)| mode).collect())
    }
}

/// Numbers as a tensor.
pub(crate) fn tensor(numbers: impl Iterator<Item = f64>) -> Result<Tensor, NetworkError> {
    let numbers: Vec<f32> = numbers.map(|x| x as f32).collect();
    let count = numbers.len();
    Ok(Tensor::from_vec(numbers, count, &Device::Cpu)?)
}

/// `ln Σ exp x`.
pub(crate) fn log_sum_exp(numbers: &[f64]) -> f64 {
    let largest = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest + numbers.iter().map(|x| (x - largest).exp()).sum::<f64>().ln()
}
