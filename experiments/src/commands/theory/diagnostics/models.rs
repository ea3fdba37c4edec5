//! The models on the path between two experts and beyond the adversarial expert, and what they are worth in a scene.

use std::sync::Arc;

use anyhow::Result;
use rayon::prelude::*;
use sage_backbones::{Backbone, MotionModel, training::PreparedScene};
use sage_bench::curve::Point as Measure;
use sage_core::scene::SceneData;
use sage_merging::{ADVERSARIAL, ExpertSet, Geometry, Linear, Merger};
use serde_json::{Value, json};

use super::weight_and_output::{self, COMPARED, Comparison};

/// Steps of λ along the path.
const STEPS: usize = 20;
/// Steps of an extrapolation, and their length as a share of the distance between the experts.
const BEYOND: usize = 12;
const STEP: f64 = 0.125;

/// Where models are evaluated.
pub(super) struct Points {
    /// λ along the path.
    pub(super) lambdas: Vec<f64>,
    /// Lengths of the extrapolations, as shares of the distance between the experts.
    pub(super) steps: Vec<f64>,
}

impl Default for Points {
    fn default() -> Self {
        Self {
            lambdas: (0..=STEPS).map(|k| k as f64 / STEPS as f64).collect(),
            steps: (0..=BEYOND).map(|k| STEP * k as f64).collect(),
        }
    }
}

/// Measures of one scene.
pub(super) struct Measured {
    pub(super) path: Vec<Measure>,
    /// Along the adversarial vector, and along the line through the experts.
    pub(super) beyond: [Vec<Measure>; 2],
    /// Weight against output mixing at each compared λ; `None` without a whole log.
    pub(super) mixing: Option<[Comparison; 3]>,
}

/// All models that are evaluated.
pub(super) struct Models {
    path: Vec<Arc<dyn MotionModel>>,
    beyond: [Vec<Arc<dyn MotionModel>>; 2],
    /// The realistic and the adversarial expert, and the mixtures that are compared with their outputs.
    ends: [Arc<dyn MotionModel>; 2],
    compared: Vec<Arc<dyn MotionModel>>,
}

/// Models on the path, and beyond the adversarial expert at equal step lengths, which are shares of the distance
/// between the experts.
pub(super) fn models(experts: &ExpertSet, geometry: &Geometry, at: &Points, seed: u64) -> Result<Models> {
    let Points { lambdas, steps } = at;
    let along = |lambda: &f64| -> Result<Arc<dyn MotionModel>> {
        Ok((&Linear as &dyn Merger).merge(experts, &experts.between(*lambda)?, seed)?)
    };
    let mergers = sage_merging::mergers()?;
    let step = |name: &str, options: Value| -> Result<Arc<dyn MotionModel>> {
        Ok(mergers.build(name, &options)?.merge(experts, &experts.between(1.0)?, seed)?)
    };
    let of_vector = geometry.norm(&[-1.0, 1.0]) / geometry.norm(&[0.0, 1.0]);
    let vector = |s: &f64| step("vector-extrapolation", json!({"phi": {ADVERSARIAL: s * of_vector}}));
    let direct = |s: &f64| step("direct-extrapolation", json!({"phi": s}));
    Ok(Models {
        path: lambdas.iter().map(along).collect::<Result<_>>()?,
        beyond: [
            steps.iter().map(vector).collect::<Result<_>>()?,
            steps.iter().map(direct).collect::<Result<_>>()?,
        ],
        ends: [along(&0.0)?, along(&1.0)?],
        compared: COMPARED.iter().map(along).collect::<Result<_>>()?,
    })
}

impl Models {
    /// Number of models.
    pub(super) fn len(&self) -> usize {
        self.path.len() + self.beyond[0].len() + self.beyond[1].len()
    }

    /// Measures all models in a scene.
    ///
    /// *Errors*: those of the networks.
    pub(super) fn measure(
        &self,
        data: &SceneData,
        prior: &dyn Backbone,
        prepared: &PreparedScene,
    ) -> Result<Measured> {
        let measured = |models: &[Arc<dyn MotionModel>]| -> Result<Vec<Measure>> {
            let one = |model: &Arc<dyn MotionModel>| Ok(prepared.expectation(&**model)?.into());
            models.par_iter().map(one).collect()
        };
        Ok(Measured {
            path: measured(&self.path)?,
            beyond: [measured(&self.beyond[0])?, measured(&self.beyond[1])?],
            mixing: weight_and_output::compare(data, prior, prepared, &self.ends, &self.compared)?,
        })
    }
}
