//! What every motion prediction network offers to the parts above it: [`MotionModel`] proposes,
//! [`Backbone`] has parameters, [`Trainable`] learns.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor};
use sage_core::{
    generator::Observation,
    geometry::Point,
    motion::{HORIZON, Trajectory},
};
use serde_json::Value;

use crate::{
    Error, Parameters,
    encoding::{Encoding, NetworkTag},
    features::{EgoForecast, Features, Table},
    parameters::ParameterSpec,
};

pub use crate::parameter_group::ParameterGroup;

/// A probabilistic motion model of one target agent: modes with probabilities and trajectories. Proposers need
/// no more; a mixture of several networks' outputs is a motion model too.
///
/// Implementations are pure: the same parameters and features give the same bits on any thread.
/// Where a tensor of the parameters is a variable, results carry gradients back to it.
pub trait MotionModel: Send + Sync {
    /// Features of a target, a track of the observation that is valid *now*. `ego` is a forecast of the ego;
    /// without one the ego is assumed to keep to its lane at several accelerations. The default is our features;
    /// a network may bring its own.
    ///
    /// *Errors*: [`Error::Core`] if the target is not valid *now*.
    fn features(
        &self,
        now: &Observation,
        target: usize,
        ego: Option<&EgoForecast>,
    ) -> Result<Features, Error> {
        Features::of(now, target, ego)
    }

    /// Encodes the features once; scores and trajectories are computed from the encoding.
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

    /// End point of each mode, metres, target frame: what non-maximum suppression compares.
    ///
    /// *Errors*: an encoding of another network.
    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error>;

    /// Trajectories of some modes.
    ///
    /// *Shapes*: (chosen, 80, 2), metres, target frame.
    /// *Errors*: an encoding of another network.
    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error>;

    /// Log-probabilities (chosen) of some modes with other trajectories than the model's own. They differ from
    /// [`MotionModel::log_probs`] only where a score depends on the trajectory.
    ///
    /// *Shapes*: `points` (chosen, 20, 2), every fourth step, metres, target frame; `log_probs` (modes)
    /// are those of [`MotionModel::log_probs`].
    /// *Errors*: an encoding of another network.
    fn log_probs_along(
        &self,
        _encoding: &Encoding,
        log_probs: &Tensor,
        modes: &[usize],
        _points: &Tensor,
    ) -> Result<Tensor, Error> {
        Ok(log_probs.index_select(&indices(modes)?, 0)?)
    }
}

/// A motion model with a name, options and parameters.
pub trait Backbone: MotionModel {
    /// Name in the registry.
    fn name(&self) -> &'static str;

    /// Its options, as the registry takes them.
    fn options(&self) -> &Value;

    /// Names, shapes and first values of its parameters, sorted by name.
    fn parameter_specs(&self) -> &[ParameterSpec];

    /// Its parameters.
    fn parameters(&self) -> &Parameters;

    /// The same network with other parameters, which fit [`Backbone::parameter_specs`].
    ///
    /// *Errors*: [`Error::Tensor`] if they do not.
    fn with_parameters(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error>;

    /// Name and options, which mark its encodings.
    fn tag(&self) -> NetworkTag<'_> {
        NetworkTag { name: self.name(), options: self.options() }
    }

    /// How it is trained; `None` for one that has nothing to learn.
    fn trainable(&self) -> Option<&dyn Trainable> {
        None
    }

    /// The same network with other parameters, which are checked first.
    ///
    /// *Errors*: [`Error::Weights`] with every missing, extra and misshapen tensor; `what` names
    /// where they come from.
    fn load_parameters(&self, parameters: Parameters, what: &str) -> Result<Box<dyn Backbone>, Error> {
        let problems = parameters.mismatches(self.parameter_specs());
        if problems.is_empty() {
            self.with_parameters(parameters)
        } else {
            Err(Error::Weights { what: what.to_owned(), problems })
        }
    }

    /// Group of a parameter; [`ParameterGroup::Unused`] if there is nothing to train.
    fn parameter_group(&self, name: &str) -> ParameterGroup {
        self.trainable().map_or(ParameterGroup::Unused, |trainable| trainable.group_of(name))
    }
}

/// What training asks of a backbone beside its results.
///
/// Law, tested for every backbone: encodings, mode ends and trajectories depend on [`ParameterGroup::Prior`] alone, so
/// they stay valid while fine-tuning, or λ, changes the rest.
pub trait Trainable: Backbone {
    /// Group of a parameter.
    fn group_of(&self, name: &str) -> ParameterGroup;

    /// Features of a target with its recorded end point after 8 s (metres, world frame), so that
    /// [`Trainable::loss`] can decode the trajectory to that point. By default those of
    /// [`MotionModel::features`].
    ///
    /// *Errors*: as [`MotionModel::features`].
    fn labelled_features(&self, now: &Observation, target: usize, _end: Point) -> Result<Features, Error> {
        self.features(now, target, None)
    }

    /// Features of the mirrored scene (left and right swapped), if the network's features can be mirrored.
    /// Their frame must have y to the left, because training mirrors futures so.
    fn mirrored(&self, _features: &Features) -> Option<Features> {
        None
    }

    /// The loss that pretraining minimises.
    ///
    /// *Errors*: features of another network.
    fn loss(&self, sample: &Sample) -> Result<Loss, Error>;
}

/// A recorded future to learn from.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Features of the target.
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
/// selected by it means anything.
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

/// Trajectories (n, 80, 2) in the target frame, converted to the world frame.
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
