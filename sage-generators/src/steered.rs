//! SAGE: candidates of a steered network, and the best of them.
//!
//! Over the prior itself it is the row of a table that tells how much the choice does without steering.

use std::sync::Arc;

use sage_backbones::{
    Backbone,
    backbone::to_world,
    candidates::{Selection, choose},
    candle::DType,
};
use sage_core::{
    Error,
    generator::{Attack, Generator, Proposed},
    objective::Context,
    seed::Rng,
};

use crate::choice::{Judge, drivable};

/// Modes looked at for each candidate: those that no car could drive are passed over.
pub(crate) const SPARE: usize = 3;

/// The generator over one network.
pub struct Steered {
    /// Name for tables.
    pub name: String,
    /// The steered network.
    pub network: Arc<dyn Backbone>,
    /// The prior, for surprise; it must have the steered network's frozen part.
    pub prior: Arc<dyn Backbone>,
    /// Number of candidates.
    pub candidates: usize,
    /// How they are taken from the network's modes.
    pub selection: Selection,
    /// Who chooses among them.
    pub judge: Judge,
}

impl Generator for Steered {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn generate(&self, ctx: &Context, seed: u64) -> Result<Attack, Error> {
        self.attack(ctx, seed).map_err(|error| in_scene(ctx, &error))
    }
}

impl Steered {
    fn attack(&self, ctx: &Context, seed: u64) -> Result<Attack, sage_backbones::Error> {
        let scene = ctx.scene();
        let target = scene.adversary_index()?;
        let features = self.network.features(scene, ctx.index(), target)?;
        let encoding = self.network.encode(Arc::new(features))?;
        let numbers = |network: &dyn Backbone| -> Result<Vec<f32>, sage_backbones::Error> {
            Ok(network.log_probs(&encoding)?.to_dtype(DType::F32)?.to_vec1()?)
        };
        let log_probs = numbers(&*self.network)?;
        let under_prior = numbers(&*self.prior)?;
        let ends = self.network.mode_ends(&encoding)?;
        let mut rng = Rng::new(seed, &scene.id, "candidates");
        let modes = choose(&log_probs, &ends, SPARE * self.candidates, self.selection, &mut rng);
        let paths = to_world(&self.network.trajectories(&encoding, &modes)?, encoding.features())?;
        let kept = drivable(&paths, self.candidates, ctx);
        let modes: Vec<usize> = kept.iter().map(|&k| modes[k]).collect();
        let paths: Vec<_> = kept.iter().map(|&k| paths[k].clone()).collect();
        let judge = |(path, &mode): (_, &usize)| self.judge.judge(path, -f64::from(under_prior[mode]), ctx);
        let judged: Vec<_> = paths.iter().zip(&modes).map(judge).collect();
        let (chosen, note) = self.judge.choose(&judged);
        let proposed = |(trajectory, &mode): (_, &usize)| Proposed {
            trajectory,
            log_prob: Some(f64::from(log_probs[mode])),
            goal: Some(encoding.features().frame.to_world(ends[mode].map(f64::from))),
        };
        let candidates = paths.into_iter().zip(&modes).map(proposed).collect();
        Ok(Attack { candidates, chosen, note })
    }
}

/// A network's error as one of its scene.
pub(crate) fn in_scene(ctx: &Context, error: &sage_backbones::Error) -> Error {
    match error {
        sage_backbones::Error::Core(error) => error.clone(),
        other => Error::Scene { scene: ctx.scene().id.clone(), problem: other.to_string() },
    }
}
