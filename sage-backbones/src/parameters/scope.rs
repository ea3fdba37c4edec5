//! Access of layers to their tensors. The same constructor of a network lists its parameters and loads them.

use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{DType, Device, Result, Shape, Tensor};
use candle_nn::{VarBuilder, var_builder::SimpleBackend};

use super::{Init, ParameterSpec, Parameters};

enum Source {
    /// Records each requested tensor.
    Listing(Mutex<Vec<ParameterSpec>>),
    /// Returns the given tensors.
    Loading(Parameters),
}

/// A node in the tree of names, from which a layer takes its tensors.
///
/// A layer asks its node for tensors. The same constructor lists what it needs and loads it:
///
/// ```
/// use sage_backbones::{
///     Parameters,
///     candle::{Result, Tensor},
///     parameters::{Init, Scope},
/// };
///
/// fn linear(scope: &Scope) -> Result<Tensor> {
///     scope.at("head").tensor("weight", &[2, 3], Init::Uniform { fan_in: 3 })
/// }
///
/// let specs = Scope::list(linear)?;
/// assert_eq!((specs[0].name.as_str(), &specs[0].shape[..]), ("head.weight", &[2, 3][..]));
/// // Initial values depend on seed and name alone.
/// let parameters = Parameters::start(&specs, 1)?;
/// assert_eq!(linear(&Scope::of(&parameters))?.dims(), [2, 3]);
/// # Ok::<(), sage_backbones::candle::Error>(())
/// ```
#[derive(Clone)]
pub struct Scope {
    source: Arc<Source>,
    prefix: String,
}

impl Scope {
    /// The root over given parameters.
    pub fn of(parameters: &Parameters) -> Self {
        Self { source: Arc::new(Source::Loading(parameters.clone())), prefix: String::new() }
    }

    /// All tensors that a constructor requests, sorted by name.
    ///
    /// *Errors*: those of the constructor.
    pub fn list<N>(build: impl FnOnce(&Self) -> Result<N>) -> Result<Vec<ParameterSpec>> {
        let source = Arc::new(Source::Listing(Mutex::default()));
        build(&Self { source: source.clone(), prefix: String::new() })?;
        let Source::Listing(specs) = &*source else { return Ok(Vec::new()) };
        let mut specs = std::mem::take(&mut *specs.lock().unwrap_or_else(PoisonError::into_inner));
        specs.sort_by(|a, b| a.name.cmp(&b.name));
        // Two layers may share a tensor.
        specs.dedup_by(|a, b| a.name == b.name && a.shape == b.shape);
        Ok(specs)
    }

    /// The child node of this name.
    pub fn at(&self, name: impl std::fmt::Display) -> Self {
        let prefix =
            if self.prefix.is_empty() { name.to_string() } else { format!("{}.{name}", self.prefix) };
        Self { source: self.source.clone(), prefix }
    }

    /// The tensor of a name at this node.
    ///
    /// *Errors*: the tensor is missing or has another shape.
    pub fn tensor(&self, name: &str, shape: &[usize], init: Init) -> Result<Tensor> {
        let name = self.at(name).prefix;
        match &*self.source {
            Source::Listing(specs) => {
                specs.lock().unwrap_or_else(PoisonError::into_inner).push(ParameterSpec {
                    name,
                    shape: shape.to_vec(),
                    init,
                });
                Tensor::zeros(shape, DType::F32, &Device::Cpu)
            }
            Source::Loading(parameters) => match parameters.get(&name) {
                Some(tensor) if tensor.dims() == shape => Ok(tensor.clone()),
                Some(tensor) => {
                    candle_core::bail!("tensor `{name}` is {:?}, expected {shape:?}", tensor.dims())
                }
                None => candle_core::bail!("tensor `{name}` is missing"),
            },
        }
    }

    /// From what a layer of candle-nn or candle-transformers takes its tensors at this node:
    ///
    /// ```
    /// use sage_backbones::{
    ///     candle::Result,
    ///     candle_nn::{self, Linear},
    ///     parameters::Scope,
    /// };
    ///
    /// fn layer(scope: &Scope) -> Result<Linear> {
    ///     candle_nn::linear(3, 2, scope.at("head").var_builder())
    /// }
    /// assert_eq!(Scope::list(layer)?[1].name, "head.weight");
    /// # Ok::<(), sage_backbones::candle::Error>(())
    /// ```
    pub fn var_builder(&self) -> VarBuilder<'static> {
        let (dtype, device) = match &*self.source {
            Source::Listing(_) => (DType::F32, Device::Cpu),
            Source::Loading(parameters) => (parameters.dtype(), parameters.device().clone()),
        };
        VarBuilder::from_backend(Box::new(self.clone()), dtype, device)
    }
}

/// Names that candle joined are those of this node's children.
impl SimpleBackend for Scope {
    fn get(
        &self,
        shape: Shape,
        name: &str,
        init: candle_nn::Init,
        dtype: DType,
        device: &Device,
    ) -> Result<Tensor> {
        self.tensor(name, shape.dims(), Init::of_candle(init, &shape))?.to_dtype(dtype)?.to_device(device)
    }

    fn get_unchecked(&self, name: &str, dtype: DType, device: &Device) -> Result<Tensor> {
        let name = self.at(name).prefix;
        match &*self.source {
            Source::Loading(parameters) => match parameters.get(&name) {
                Some(tensor) => tensor.to_dtype(dtype)?.to_device(device),
                None => candle_core::bail!("tensor `{name}` is missing"),
            },
            Source::Listing(_) => candle_core::bail!("tensor `{name}` is asked for without a shape"),
        }
    }

    fn contains_tensor(&self, name: &str) -> bool {
        let name = self.at(name).prefix;
        match &*self.source {
            Source::Loading(parameters) => parameters.get(&name).is_some(),
            // What a layer asks for only if it is there is not a parameter.
            Source::Listing(_) => false,
        }
    }
}
