//! Prepared scenes for fine-tuning: encoded once, with every goal decoded and evaluated.

use std::sync::Arc;

use candle_core::{DType, Tensor};
use rayon::prelude::*;
use sage_core::{
    defect::{self, Defect},
    motion::NOW,
    objective::{Context, ContextOptions},
    scene::SceneData,
};

use super::goal_table::{Expectation, ExpertObjective, GoalTable, Measures};
use crate::{
    Error,
    backbone::{Backbone, MotionModel, finite, trajectories_in_world},
    encoding::Encoding,
    forecast::features_with_forecast,
    subsampling::Subsampling,
};

/// A scene prepared for fine-tuning. Nothing in it depends on the tuned parameters.
pub struct PreparedScene {
    pub(super) name: String,
    pub(super) encoding: Encoding,
    pub(super) ends: Vec<[f32; 2]>,
    /// Measured values of each goal.
    pub table: GoalTable,
    pub(super) reference: Vec<f64>,
}

impl PreparedScene {
    /// Encodes a scene's adversary with a prior, and decodes and evaluates all its goals. With `mirrored`,
    /// the prior encodes the mirrored scene. `None` if the scene has no adversary that is valid *now* or no
    /// ego path, or if the prior cannot encode the mirrored scene.
    ///
    /// *Errors*: those of the network.
    pub fn new(
        prior: &dyn Backbone,
        data: &SceneData,
        mirrored: bool,
        measures: &Measures,
    ) -> Result<Option<Self>, Error> {
        let Ok(adversary) = data.scene.adversary_index() else { return Ok(None) };
        let Ok(ctx) = Context::new(&data.scene, &data.index, &ContextOptions::default()) else {
            return Ok(None);
        };
        if !data.scene.tracks[adversary].is_valid(NOW) {
            return Ok(None);
        }
        let features = features_with_forecast(prior, &data.observe()?, adversary, Subsampling::NONE)?;
        let mirror = || prior.trainable().and_then(|trainable| trainable.mirrored(&features));
        let features = match mirrored.then(mirror) {
            Some(None) => return Ok(None),
            Some(Some(mirrored)) => mirrored,
            None => features,
        };
        let encoding = prior.encode(Arc::new(features))?;
        let ends = prior.mode_ends(&encoding)?;
        let modes: Vec<usize> = (0..ends.len()).collect();
        let mut trajectories = prior.trajectories(&encoding, &modes)?;
        if mirrored {
            let signs = Tensor::new(&[1.0, -1.0], trajectories.device())?.to_dtype(trajectories.dtype())?;
            trajectories = trajectories.broadcast_mul(&signs)?;
        }
        let trajectories = trajectories_in_world(&trajectories, encoding.features())
            .map_err(|error| error.of(data, adversary))?;
        let reference: Vec<f64> =
            finite(&prior.log_probs(&encoding)?).map_err(|error| error.of(data, adversary))?;
        let mut table = GoalTable::default();
        for (trajectory, log_prob) in trajectories.into_iter().zip(&reference) {
            let candidate = ctx.candidate(trajectory).with_nll(Some(-log_prob));
            table.push(&candidate, &ctx, measures);
        }
        let name = if mirrored { format!("{} mirrored", data.name) } else { data.name.clone() };
        Ok(Some(Self { name, encoding, ends, table, reference }))
    }

    /// Prepares all scenes for which [`PreparedScene::new`] gives one, in parallel; keeps their order. `broken` is told of scenes
    /// that met a defect, which are left out.
    ///
    /// *Errors*: the first error of the network.
    pub fn all(
        prior: &dyn Backbone,
        scenes: &[SceneData],
        mirrored: bool,
        measures: &Measures,
        mut broken: impl FnMut(&SceneData, Defect),
    ) -> Result<Vec<Self>, Error> {
        let one = |data| defect::caught(|| Self::new(prior, data, mirrored, measures));
        let prepared: Vec<_> = scenes.par_iter().with_max_len(1).map(one).collect();
        let told = |(prepared, data): (Result<_, Defect>, &SceneData)| {
            prepared.unwrap_or_else(|defect| {
                broken(data, defect);
                Ok(None)
            })
        };
        prepared.into_iter().zip(scenes).map(told).filter_map(Result::transpose).collect()
    }

    /// Encoding of the adversary's features.
    pub fn encoding(&self) -> &Encoding {
        &self.encoding
    }

    /// Expectations under a policy with the same encoder.
    ///
    /// *Errors*: those of the network.
    pub fn expectation(&self, policy: &dyn MotionModel) -> Result<Expectation, Error> {
        Ok(self.expectation_of(&finite::<f64>(&policy.log_probs(&self.encoding)?)?))
    }

    /// Mean value of a measured objective under a policy with the same encoder.
    ///
    /// *Errors*: those of the network.
    pub fn expected_value(&self, policy: &dyn MotionModel, expert: &ExpertObjective) -> Result<f64, Error> {
        let log_probs = finite::<f64>(&policy.log_probs(&self.encoding)?)?;
        Ok(self.table.expected_value(&log_probs, expert))
    }

    /// Expectations under a policy, from its log-probabilities.
    pub(super) fn expectation_of(&self, log_probs: &[f64]) -> Expectation {
        self.table.expectation(log_probs, &self.reference)
    }
}

/// The elements of a tensor.
pub(super) fn numbers(tensor: &Tensor) -> Result<Vec<f64>, Error> {
    Ok(tensor.detach().to_dtype(DType::F64)?.flatten_all()?.to_vec1()?)
}
