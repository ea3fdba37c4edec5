//! A scene prepared for the measures of many trajectories.

use std::sync::Arc;

use crate::Result;
use sage_backbones::{Backbone, backbone::finite, features::Frame};
use sage_core::{
    generator::Attack,
    geometry::distance,
    metric::{LogMeasures, MeasuredTrajectory},
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Convention, FurtherMeasures, Naturalness, Scorer},
    scene::SceneData,
};
use sage_generators::logged_future;

/// A scene prepared for the trajectories of all generators with one prior.
pub struct MeasuredScene<'d> {
    ctx: Arc<Context>,
    release: Arc<Context>,
    further: &'d FurtherMeasures,
    likelihood: Option<PriorOfAdversary>,
    log: LogMeasures,
}

impl<'d> MeasuredScene<'d> {
    /// Prepares the `release` convention, measures of the log, and the prior's goal probabilities; `ctx` is the scene
    /// in the `paper` convention.
    ///
    /// *Errors*: the scene cannot be attacked; those of the prior.
    pub fn new(
        ctx: Arc<Context>,
        data: &SceneData,
        prior: &dyn Backbone,
        further: &'d FurtherMeasures,
    ) -> Result<Self> {
        let options = ContextOptions { convention: Convention::Release, ..ContextOptions::default() };
        let release = Arc::new(Context::new(&data.scene, &data.index, &options)?);
        let logged = logged_future(&data.scene)?;
        let natural = Naturalness::of(&ctx.candidate(logged.clone()), &ctx);
        let likelihood = PriorOfAdversary::of(data, prior)?;
        let nll = likelihood.as_ref().and_then(|prior| prior.nll(&logged));
        let log = MeasuredTrajectory::log_measures(&ctx, natural, nll);
        Ok(Self { ctx, release, further, likelihood, log })
    }

    /// Measures the selected trajectory of an attack that took some seconds.
    ///
    /// *Errors*: a trajectory that starts elsewhere or has another length than the scene's future.
    pub fn measured(&self, attack: &Attack, seconds: f64) -> Result<MeasuredTrajectory> {
        attack.check(self.ctx.scene())?;
        let trajectory = attack.trajectory();
        let candidate = self.ctx.candidate(trajectory.clone());
        let paper = Scorer::with(&self.ctx, self.further).scores(&candidate);
        Ok(MeasuredTrajectory {
            paper,
            nll: self.likelihood.as_ref().and_then(|prior| prior.nll(trajectory)),
            log: self.log,
            note: attack.note.clone(),
            extension: attack.extension.clone(),
            seconds,
            ctx: self.ctx.clone(),
            release_ctx: self.release.clone(),
            candidate,
            later: Default::default(),
        })
    }
}

/// Log-probabilities of the adversary's goals under the prior.
struct PriorOfAdversary {
    frame: Frame,
    ends: Vec<[f32; 2]>,
    log_probs: Vec<f64>,
}

impl PriorOfAdversary {
    /// `None` if the adversary is not valid *now*.
    fn of(data: &SceneData, prior: &dyn Backbone) -> Result<Option<Self>> {
        let adversary = data.scene.adversary_index()?;
        if !data.scene.tracks[adversary].is_valid(NOW) {
            return Ok(None);
        }
        let features = prior.features(&data.observe()?, adversary, None)?;
        let encoding = prior.encode(features.into())?;
        let log_probs: Vec<f64> = finite(&prior.log_probs(&encoding)?)?;
        let ends = prior.mode_ends(&encoding)?;
        Ok(Some(Self { frame: encoding.features().frame, ends, log_probs }))
    }

    /// −log p of the goal nearest to the end of a trajectory.
    fn nll(&self, trajectory: &Trajectory) -> Option<f64> {
        let end = self.frame.frame_from_world(trajectory.points()[HORIZON - 1]);
        let gap = |k: &usize| distance(self.ends[*k].map(f64::from), end);
        (0..self.ends.len()).min_by(|a, b| gap(a).total_cmp(&gap(b))).map(|k| -self.log_probs[k])
    }
}
