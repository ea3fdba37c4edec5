//! What every motion prediction network offers to the parts above it.

use std::sync::{Arc, OnceLock};

use candle_core::{DType, Device, Tensor};
use sage_core::{
    geometry::Point,
    motion::{HORIZON, Trajectory},
    registry::Registry,
    scene::{Scene, SceneIndex},
};
use serde_json::Value;

use crate::{
    Error, Parameters,
    densetnt::{Cat, DenseTnt},
    features::{Features, Table},
    lane_graph::LaneGraph,
    parameters::Wanted,
    query_transformer::QueryTransformer,
};

/// What a parameter is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Part of the prior that fine-tuning leaves alone: encoder and decoder of paths.
    Prior,
    /// Scores modes: pretraining moves it, and fine-tuning too.
    Scoring,
    /// Zero in the prior; fine-tuning alone moves it.
    Steering,
    /// Read, but without effect on any result: its gradient is rounding.
    WithoutEffect,
    /// Kept for the sake of files, read by nothing.
    Unused,
}

impl Role {
    /// Whether pretraining moves it.
    pub fn is_pretrained(self) -> bool {
        matches!(self, Self::Prior | Self::Scoring)
    }

    /// Whether fine-tuning moves it.
    pub fn is_finetuned(self) -> bool {
        matches!(self, Self::Scoring | Self::Steering)
    }
}

/// A probabilistic motion model of one target agent: modes with probabilities, and a path for each.
///
/// Implementations are pure: the same parameters and features give the same bits on any thread.
/// Where a tensor of the parameters is a variable, results carry gradients back to it.
pub trait Backbone: Send + Sync {
    /// Name in the registry.
    fn name(&self) -> &'static str;

    /// Its options, as the registry takes them.
    fn options(&self) -> &Value;

    /// Names, shapes and first values of its parameters, sorted by name.
    fn wanted(&self) -> &[Wanted];

    /// Its parameters.
    fn parameters(&self) -> &Parameters;

    /// The same network over other parameters, which have been checked against [`Backbone::wanted`].
    ///
    /// *Errors*: [`Error::Tensor`] if they do not fit.
    fn rebuilt(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error>;

    /// What a parameter is for.
    fn role(&self, name: &str) -> Role;

    /// Looks around a target, a track of the scene that is valid *now*.
    ///
    /// *Errors*: [`Error::Core`] if it is not.
    fn features(&self, scene: &Scene, index: &SceneIndex, target: usize) -> Result<Features, Error>;

    /// The same for a target whose end after 8 s is known (metres, world frame), so that
    /// [`Backbone::loss`] can decode the way to just there. Without need for it, as above.
    ///
    /// *Errors*: as [`Backbone::features`].
    fn labelled_features(
        &self,
        scene: &Scene,
        index: &SceneIndex,
        target: usize,
        _end: Point,
    ) -> Result<Features, Error> {
        self.features(scene, index, target)
    }

    /// What the target would see if left and right changed places, where the network's features know
    /// it. Their frame must have y to the left: training mirrors futures so.
    fn mirrored(&self, _features: &Features) -> Option<Features> {
        None
    }

    /// Reads the surroundings once; scores and paths come from what it gives.
    ///
    /// *Errors*: [`Error::Tensor`] for features of another network.
    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error>;

    /// Log-probabilities of all modes.
    ///
    /// *Shapes*: (modes); they sum to 1 as probabilities.
    /// *Errors*: an encoding of another network.
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error>;

    /// Log-probabilities (chosen) of some modes, up to one number that all modes of the encoding share:
    /// enough to compare them, and often far less work.
    ///
    /// *Errors*: an encoding of another network.
    fn relative_log_probs(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        Ok(self.log_probs(encoding)?.index_select(&indices(modes)?, 0)?)
    }

    /// Where each mode ends, metres, target frame: what suppression compares.
    ///
    /// *Errors*: an encoding of another network.
    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error>;

    /// Paths of some modes.
    ///
    /// *Shapes*: (chosen, 80, 2), metres, target frame.
    /// *Errors*: an encoding of another network.
    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error>;

    /// Log-probabilities (chosen) of some modes if they were driven along given places instead of the
    /// network's own paths: where a score depends on the path itself, it is that of these paths.
    ///
    /// *Shapes*: `places` (chosen, 20, 2), every fourth step, metres, target frame; `log_probs` (modes)
    /// are those of [`Backbone::log_probs`].
    /// *Errors*: an encoding of another network.
    fn log_probs_along(
        &self,
        _encoding: &Encoding,
        log_probs: &Tensor,
        modes: &[usize],
        _places: &Tensor,
    ) -> Result<Tensor, Error> {
        Ok(log_probs.index_select(&indices(modes)?, 0)?)
    }

    /// What pretraining makes small.
    ///
    /// *Errors*: features of another network.
    fn loss(&self, sample: &Sample) -> Result<Loss, Error>;

    /// The same network over other parameters.
    ///
    /// *Errors*: [`Error::Weights`] with every missing, extra and misshapen tensor; `what` names
    /// where they come from.
    fn with_parameters(&self, parameters: Parameters, what: &str) -> Result<Box<dyn Backbone>, Error> {
        let problems = parameters.faults(self.wanted());
        if problems.is_empty() {
            self.rebuilt(parameters)
        } else {
            Err(Error::Weights { what: what.to_owned(), problems })
        }
    }
}

/// The backbones this crate ships. Add a line here to make a new one known everywhere.
///
/// *Errors*: [`sage_core::Error::Duplicate`] if two bear one name.
pub fn backbones() -> Result<Registry<dyn Backbone>, sage_core::Error> {
    Registry::new("backbone")
        .with::<DenseTnt>()?
        .with::<QueryTransformer>()?
        .with::<LaneGraph>()?
        .with::<Cat>()
}

/// What a network keeps of one target's surroundings.
pub struct Encoding {
    features: Arc<Features>,
    states: Vec<Tensor>,
    described: OnceLock<Option<Tensor>>,
}

impl Encoding {
    /// An encoding of states that only its network knows to read.
    pub fn new(features: Arc<Features>, states: Vec<Tensor>) -> Self {
        Self { features, states, described: OnceLock::new() }
    }

    /// What was encoded.
    pub fn features(&self) -> &Features {
        &self.features
    }

    /// The network's states.
    pub fn states(&self) -> &[Tensor] {
        &self.states
    }

    /// What a steering branch sees of all modes, made by `make` when it is first asked for.
    ///
    /// *Errors*: those of `make`.
    pub fn described(
        &self,
        make: impl FnOnce() -> Result<Option<Tensor>, Error>,
    ) -> Result<Option<&Tensor>, Error> {
        if self.described.get().is_none() {
            // Two threads may both make it: the bits are the same.
            let _ = self.described.set(make()?);
        }
        Ok(self.described.get().and_then(Option::as_ref))
    }

    /// The error of a network that finds states it did not make.
    pub fn foreign(&self) -> Error {
        Error::Training("this encoding was made by another network; encode the features again".to_owned())
    }
}

/// A recorded future to learn from.
#[derive(Clone, Debug)]
pub struct Sample {
    /// What the target sees.
    pub features: Arc<Features>,
    /// Positions at the 80 steps, metres, target frame; anything where not valid.
    pub future: Vec<[f32; 2]>,
    /// Whether each step was recorded.
    pub valid: Vec<bool>,
}

/// A loss and what it is made of.
pub struct Loss {
    /// Their sum, a scalar that gradients start from.
    pub total: Tensor,
    /// Parts by name.
    pub parts: Vec<(&'static str, f64)>,
}

impl Loss {
    /// The sum of named parts, scalars.
    ///
    /// *Errors*: [`Error::Tensor`] if one is no scalar.
    pub fn of(parts: Vec<(&'static str, Tensor)>) -> Result<Self, Error> {
        let mut total = Tensor::zeros((), parts.first().map_or(DType::F32, |p| p.1.dtype()), &Device::Cpu)?;
        let mut values = Vec::with_capacity(parts.len());
        for (name, part) in parts {
            values.push((name, part.to_dtype(DType::F64)?.to_scalar::<f64>()?));
            total = (total + part)?;
        }
        Ok(Self { total, parts: values })
    }
}

/// Modes as a tensor of indices.
///
/// *Errors*: none on a CPU.
pub fn indices(modes: &[usize]) -> candle_core::Result<Tensor> {
    let modes: Vec<u32> = modes.iter().map(|&mode| mode as u32).collect();
    let count = modes.len();
    Tensor::from_vec(modes, count, &Device::Cpu)
}

/// Log-probabilities as numbers, 32 or 64 bits.
///
/// *Errors*: [`Error::Training`] with the first mode whose log-probability is not finite: nothing that is
/// chosen by it means anything.
pub fn finite<T: candle_core::WithDType + Into<f64>>(log_probs: &Tensor) -> Result<Vec<T>, Error> {
    let values = log_probs.detach().to_dtype(T::DTYPE)?.flatten_all()?.to_vec1::<T>()?;
    match values.iter().position(|x| !Into::<f64>::into(*x).is_finite()) {
        Some(mode) => Err(Error::Training(format!(
            "mode {mode} has log-probability {}; the weights or the scene are broken",
            Into::<f64>::into(values[mode])
        ))),
        None => Ok(values),
    }
}

/// A table as a tensor (rows, columns).
pub fn tensor(table: &Table, dtype: DType) -> candle_core::Result<Tensor> {
    Tensor::from_slice(&table.values, (table.rows(), table.columns), &Device::Cpu)?.to_dtype(dtype)
}

/// Paths (n, 80, 2) of the target frame as trajectories in the world.
///
/// *Errors*: [`Error::Core`] if a position is not finite: the weights are broken then.
pub fn to_world(paths: &Tensor, features: &Features) -> Result<Vec<Trajectory>, Error> {
    let numbers = paths.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?;
    let path = |(k, path): (usize, &[f64])| {
        let (points, _) = path.as_chunks::<2>();
        let world = points.iter().map(|p| features.frame.to_world(*p)).collect();
        Ok(Trajectory::new(&format!("predicted path {k}"), world)?)
    };
    numbers.chunks_exact(2 * HORIZON).enumerate().map(path).collect()
}
