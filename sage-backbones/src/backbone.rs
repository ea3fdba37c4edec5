//! Traits of motion prediction networks: [`MotionModel`] gives modes and trajectories of an encoded scene,
//! [`Backbone`] adds parameters, features and the encoder, [`Trainable`] adds a training loss.

use std::sync::Arc;

use candle_core::{DType, Tensor};
use sage_core::{
    generator::Observation,
    geometry::Point,
    motion::{HORIZON, Trajectory},
    seed::Rng,
};
use serde_json::Value;

use crate::{
    Error, Parameters,
    encoding::{Encoding, NetworkTag},
    features::{EdgeKinds, EgoForecast, Features},
    parameters::ParameterSpec,
};

pub use crate::{definition::Definition, parameter_group::ParameterGroup};

/// A probabilistic motion model of one target agent: modes with probabilities and trajectories. Proposers
/// need only this trait. A mixture of several networks' outputs is also a motion model.
///
/// Implementations are pure: the same parameters and features give the same bits on any thread.
/// If a parameter tensor is a variable, results carry gradients to it.
pub trait MotionModel: Send + Sync {
    /// Log-probabilities of all modes.
    ///
    /// *Shapes*: (modes); they sum to 1 as probabilities.
    /// *Errors*: an encoding of another network.
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error>;

    /// Log-probabilities of some modes, up to a constant that all modes of the encoding share. They suffice
    /// to compare modes and often cost far less.
    ///
    /// *Shapes*: (selected).
    /// *Errors*: an encoding of another network.
    fn relative_log_probs(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        Ok(of_modes(&self.log_probs(encoding)?, modes)?)
    }

    /// End point of each mode, metres, target frame. Non-maximum suppression compares these points.
    ///
    /// *Errors*: an encoding of another network.
    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error>;

    /// Trajectories of some modes.
    ///
    /// *Shapes*: (selected, 80, 2), metres, target frame.
    /// *Errors*: an encoding of another network.
    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error>;

    /// The prior's mode that each of some modes stands for, to find its likelihood under the prior. The default
    /// is the same mode.
    ///
    /// *Errors*: an encoding of another network.
    fn modes_of_prior(&self, _encoding: &Encoding, modes: &[usize]) -> Result<Vec<usize>, Error> {
        Ok(modes.to_vec())
    }

    /// Log-probabilities of some modes with `points` in place of the model's own trajectories. They differ
    /// from [`MotionModel::log_probs`] only if scores depend on the trajectory.
    ///
    /// *Shapes*: `points` (selected, 20, 2), every fourth step, metres, target frame; `log_probs` (modes)
    /// are those of [`MotionModel::log_probs`]; result (selected).
    /// *Errors*: an encoding of another network.
    fn log_probs_along(
        &self,
        _encoding: &Encoding,
        log_probs: &Tensor,
        modes: &[usize],
        _points: &Tensor,
    ) -> Result<Tensor, Error> {
        Ok(of_modes(log_probs, modes)?)
    }
}

/// A motion model with a name, options and parameters.
///
/// From features to probabilities and trajectories of the modes, by a network with its initial weights:
///
/// ```
/// use sage_backbones::{backbone::finite, backbones};
/// use sage_core::{generator::Observation, scene::SceneIndex};
/// use sage_data::procedural::{Kind, generate};
/// use serde_json::json;
///
/// let scene = generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?;
/// let now = Observation::of(&scene, &SceneIndex::new(scene.map.clone()))?;
/// let network = backbones()?.build("densetnt", &json!({"hidden": 8}))?;
/// let encoding = network.encode(network.features(&now, scene.adversary_index()?, None)?.into())?;
///
/// let log_probs: Vec<f64> = finite(&network.log_probs(&encoding)?)?;
/// assert!((log_probs.iter().map(|log_prob| log_prob.exp()).sum::<f64>() - 1.0).abs() < 1e-4);
/// // 80 positions (x, y) of each asked mode, in metres.
/// assert_eq!(network.trajectories(&encoding, &[0, 5])?.dims(), [2, 80, 2]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Backbone: MotionModel {
    /// Its name, options and parameters.
    fn definition(&self) -> &Definition;

    /// Name in the registry.
    fn name(&self) -> &'static str {
        self.definition().name
    }

    /// Its options, as given to the registry.
    fn options(&self) -> &Value {
        &self.definition().options
    }

    /// Names, shapes and initial values of its parameters, sorted by name.
    fn parameter_specs(&self) -> &[ParameterSpec] {
        &self.definition().specs
    }

    /// Its parameters.
    fn parameters(&self) -> &Parameters {
        &self.definition().parameters
    }

    /// The same network with other parameters, which must fit [`Backbone::parameter_specs`].
    ///
    /// *Errors*: [`Error::Tensor`] if they do not.
    fn with_parameters(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error>;

    /// Name and options, which tag its encodings.
    fn tag(&self) -> NetworkTag<'_> {
        NetworkTag { name: self.name(), options: self.options() }
    }

    /// Features of a target: a track of the observation that is valid *now*. `ego` is a forecast of the ego.
    /// Without one, the ego follows its lane under several acceleration profiles. The default is
    /// [`Features::of`] with road boundaries as edges; a network may define its own features.
    ///
    /// *Errors*: [`Error::Core`] if the target is not valid *now*.
    fn features(
        &self,
        now: &Observation,
        target: usize,
        ego: Option<&EgoForecast>,
    ) -> Result<Features, Error> {
        Features::of(now, target, ego, EdgeKinds::default())
    }

    /// Encodes the features once; scores and trajectories are computed from the encoding.
    ///
    /// *Errors*: [`Error::Tensor`] for features of another network.
    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error>;

    /// What its experts share with their prior.
    fn shared(&self) -> Shared {
        Shared::Trajectories
    }

    /// Its training interface; `None` if it has no parameters to train.
    fn trainable(&self) -> Option<&dyn Trainable> {
        None
    }

    /// The same network with other parameters, after a check of their names and shapes.
    ///
    /// *Errors*: [`Error::Weights`] with every missing, extra and misshapen tensor; `what` names
    /// their source.
    fn load_parameters(&self, parameters: Parameters, what: &str) -> Result<Box<dyn Backbone>, Error> {
        let problems = parameters.mismatches(self.parameter_specs());
        if problems.is_empty() {
            self.with_parameters(parameters)
        } else {
            Err(Error::Weights { what: what.to_owned(), problems })
        }
    }

    /// Group of a parameter; [`ParameterGroup::Unused`] if the backbone is not trainable.
    fn parameter_group(&self, name: &str) -> ParameterGroup {
        self.trainable().map_or(ParameterGroup::Unused, |trainable| trainable.group_of(name))
    }
}

/// What the experts of a network share with their prior: what depends on [`ParameterGroup::Prior`] alone, so that
/// it stays valid when fine-tuning or λ changes the other parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Shared {
    /// Nothing: each expert encodes the features for itself.
    Nothing,
    /// Encodings. Each expert has modes of its own, as many as the prior.
    Encodings,
    /// Encodings, mode ends and trajectories: experts differ in probabilities alone.
    Trajectories,
}

/// A backbone with a training loss.
///
/// Law, tested for every backbone of this crate: what [`Backbone::shared`] says depends on [`ParameterGroup::Prior`] alone.
pub trait Trainable: Backbone {
    /// Group of a parameter.
    fn group_of(&self, name: &str) -> ParameterGroup;

    /// Features of a target with its recorded end point after 8 s (metres, world frame), so that
    /// [`Trainable::loss`] can decode the trajectory to that point. The default is
    /// [`Backbone::features`].
    ///
    /// *Errors*: as [`Backbone::features`].
    fn labelled_features(&self, now: &Observation, target: usize, _end: Point) -> Result<Features, Error> {
        self.features(now, target, None)
    }

    /// Features of the mirrored scene (left and right swapped), if the network's features can be mirrored.
    /// Their frame must have y to the left, because training mirrors futures by the sign of y.
    fn mirrored(&self, _features: &Features) -> Option<Features> {
        None
    }

    /// The loss that pretraining minimises. Random numbers, such as noise, come from `rng`, which is that of the sample
    /// in its epoch and step, so that the same seed gives the same bits, also after an interruption.
    ///
    /// *Errors*: features of another network.
    fn loss(&self, sample: &Sample, rng: &mut Rng) -> Result<Loss, Error>;

    /// What preference tuning compares trajectories by; `None` for the log-probabilities of modes, whose trajectories are the
    /// prior's.
    fn trajectory_likelihood(&self) -> Option<&dyn TrajectoryLikelihood> {
        None
    }
}

/// How likely a network holds given trajectories: what preference tuning changes in a network whose experts have trajectories of
/// their own.
///
/// Its loss is `−ln σ(kl_beta · ((l(better) − l(worse)) − (l_ref(better) − l_ref(worse))))`, with l of the network and l_ref of the
/// frozen prior; the trajectories are drawn from the prior.
pub trait TrajectoryLikelihood {
    /// Log-likelihoods of trajectories up to a constant that all share, or what stands for them, such as the negative errors of
    /// denoising. For the better and the worse trajectories of the same pairs, and for network and prior, `rng` begins alike:
    /// noise that is drawn from it is the same.
    ///
    /// *Shapes*: `trajectories` (n, 80, 2), metres, target frame; result (n).
    /// *Errors*: an encoding of another network.
    fn log_likelihoods(
        &self,
        encoding: &Encoding,
        trajectories: &Tensor,
        rng: &mut Rng,
    ) -> Result<Tensor, Error>;
}

/// A training sample: features and recorded future of one target.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Features of the target.
    pub features: Arc<Features>,
    /// Positions at the 80 steps, metres, target frame; arbitrary where not valid.
    pub future: Vec<[f32; 2]>,
    /// Whether each step was recorded.
    pub valid: Vec<bool>,
}

/// A loss and its terms.
pub struct Loss {
    /// Sum of the terms: the scalar to differentiate.
    pub total: Tensor,
    /// Terms by name.
    pub parts: Vec<(&'static str, f64)>,
}

impl Loss {
    /// The sum of named scalar terms.
    ///
    /// *Errors*: [`Error::Tensor`] if a term is not a scalar.
    pub fn of(parts: Vec<(&'static str, Tensor)>) -> Result<Self, Error> {
        let mut total: Option<Tensor> = None;
        let mut values = Vec::with_capacity(parts.len());
        for (name, part) in parts {
            values.push((name, part.to_dtype(DType::F64)?.to_scalar::<f64>()?));
            total = Some(match total {
                Some(total) => (total + part)?,
                None => (part.zeros_like()? + part)?,
            });
        }
        match total {
            Some(total) => Ok(Self { total, parts: values }),
            None => Err(Error::NothingToTrain("a loss without terms".to_owned())),
        }
    }
}

/// The rows of some modes.
///
/// *Shapes*: `x` (modes, …); result (selected, …).
/// *Errors*: a mode that there is not.
pub fn of_modes(x: &Tensor, modes: &[usize]) -> candle_core::Result<Tensor> {
    x.index_select(&Tensor::from_iter(modes.iter().map(|&mode| mode as u32), x.device())?, 0)
}

/// Log-probabilities as numbers of 32 or 64 bits.
///
/// *Errors*: [`Error::NotFinite`] with the first mode whose log-probability is not finite, because such values
/// cannot rank modes.
pub fn finite<T: candle_core::WithDType + Into<f64>>(log_probs: &Tensor) -> Result<Vec<T>, Error> {
    let values = log_probs.detach().to_dtype(T::DTYPE)?.flatten_all()?.to_vec1::<T>()?;
    match values.iter().position(|x| !Into::<f64>::into(*x).is_finite()) {
        Some(mode) => Err(Error::NotFinite(format!(
            "mode {mode} has log-probability {}; the weights or the scene are broken",
            Into::<f64>::into(values[mode])
        ))),
        None => Ok(values),
    }
}

/// Trajectories converted from the target frame to the world frame.
///
/// *Shapes*: `trajectories` (n, 80, 2).
/// *Errors*: [`Error::Core`] if a position is not finite, which means broken weights.
pub fn trajectories_in_world(trajectories: &Tensor, features: &Features) -> Result<Vec<Trajectory>, Error> {
    let numbers = trajectories.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?;
    let convert = |(k, local): (usize, &[f64])| {
        let (points, _) = local.as_chunks::<2>();
        let world = points.iter().map(|p| features.frame.world_from_frame(*p)).collect();
        Ok(Trajectory::new(&format!("predicted trajectory {k}"), world)?)
    };
    numbers.chunks_exact(2 * HORIZON).enumerate().map(convert).collect()
}
