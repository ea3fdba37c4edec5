//! Access of layers to their tensors. The same constructor of a network lists its parameters and loads them.

use std::{cell::RefCell, rc::Rc};

use candle_core::{DType, Device, Result, Tensor};

use super::{Init, ParameterSpec, Parameters};

enum Source {
    /// Records each requested tensor.
    Listing(RefCell<Vec<ParameterSpec>>),
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
    source: Rc<Source>,
    prefix: String,
}

impl Scope {
    /// The root over given parameters.
    pub fn of(parameters: &Parameters) -> Self {
        Self { source: Rc::new(Source::Loading(parameters.clone())), prefix: String::new() }
    }

    /// All tensors that a constructor requests, sorted by name.
    ///
    /// *Errors*: those of the constructor.
    pub fn list<N>(build: impl FnOnce(&Self) -> Result<N>) -> Result<Vec<ParameterSpec>> {
        let source = Rc::new(Source::Listing(RefCell::default()));
        build(&Self { source: source.clone(), prefix: String::new() })?;
        let Source::Listing(specs) = &*source else { return Ok(Vec::new()) };
        let mut specs = specs.take();
        specs.sort_by(|a, b| a.name.cmp(&b.name));
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
                specs.borrow_mut().push(ParameterSpec { name, shape: shape.to_vec(), init });
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
}
