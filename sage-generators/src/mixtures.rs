//! Models of an expert set, built once per mixture and shared by all threads.

use std::sync::{Arc, Mutex, PoisonError};

use sage_backbones::MotionModel;
use sage_core::generator::Mixture;
use sage_merging::{Error, ExpertSet, Merger};

/// Largest number of cached models, about 1 MB each; the oldest one is removed first.
const CACHED: usize = 128;

/// Models at mixtures of experts.
#[derive(Clone)]
pub struct Mixtures(Arc<Source>);

enum Source {
    Mixed { experts: ExpertSet, merger: Arc<dyn Merger>, seed: u64, built: Mutex<Vec<Built>> },
    Always(Arc<dyn MotionModel>),
}

type Built = (Mixture, Arc<dyn MotionModel>);

impl Mixtures {
    /// Models of experts mixed by a merger.
    pub fn new(experts: ExpertSet, merger: Arc<dyn Merger>, seed: u64) -> Self {
        Self(Arc::new(Source::Mixed { experts, merger, seed, built: Mutex::default() }))
    }

    /// One model for every mixture.
    pub fn always(model: Arc<dyn MotionModel>) -> Self {
        Self(Arc::new(Source::Always(model)))
    }

    /// The model at a mixture.
    ///
    /// *Errors*: a mixture that the merger refuses, or experts that it cannot mix.
    pub fn at(&self, mixture: &Mixture) -> Result<Arc<dyn MotionModel>, Error> {
        let (experts, merger, seed, built) = match &*self.0 {
            Source::Mixed { experts, merger, seed, built } => (experts, merger, *seed, built),
            Source::Always(model) => return Ok(model.clone()),
        };
        // After a panic in another thread the cache holds complete models only.
        let mut built = built.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, model)) = built.iter().find(|(known, _)| known == mixture) {
            return Ok(model.clone());
        }
        let model = merger.merge(experts, mixture, seed)?;
        if built.len() == CACHED {
            built.remove(0);
        }
        built.push((mixture.clone(), model.clone()));
        Ok(model)
    }
}
