//! How layers get their tensors: one constructor serves to list, to start and to load a network.

use std::{cell::RefCell, rc::Rc};

use candle_core::{DType, Device, Result, Tensor};

use super::{Init, Parameters};

/// A tensor that a network asks for.
#[derive(Clone, Debug, PartialEq)]
pub struct Wanted {
    /// Its full name.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// How it starts.
    pub init: Init,
}

enum Source {
    /// Note what is asked for.
    Listing(RefCell<Vec<Wanted>>),
    /// Hand out what is there.
    Loading(Parameters),
}

/// A place in the tree of names from which a layer takes its tensors.
#[derive(Clone)]
pub struct Scope {
    source: Rc<Source>,
    prefix: String,
}

impl Scope {
    /// The root over parameters that are there.
    pub fn of(parameters: &Parameters) -> Self {
        Self { source: Rc::new(Source::Loading(parameters.clone())), prefix: String::new() }
    }

    /// All tensors that a constructor asks for, sorted by name.
    ///
    /// *Errors*: those of the constructor.
    pub fn list<N>(build: impl FnOnce(&Self) -> Result<N>) -> Result<Vec<Wanted>> {
        let source = Rc::new(Source::Listing(RefCell::default()));
        build(&Self { source: source.clone(), prefix: String::new() })?;
        let Source::Listing(wanted) = &*source else { return Ok(Vec::new()) };
        let mut wanted = wanted.take();
        wanted.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(wanted)
    }

    /// The place one name further down.
    pub fn at(&self, name: impl std::fmt::Display) -> Self {
        let prefix =
            if self.prefix.is_empty() { name.to_string() } else { format!("{}.{name}", self.prefix) };
        Self { source: self.source.clone(), prefix }
    }

    /// The tensor of a name at this place.
    ///
    /// *Errors*: it is not there, or has another shape.
    pub fn tensor(&self, name: &str, shape: &[usize], init: Init) -> Result<Tensor> {
        let name = self.at(name).prefix;
        match &*self.source {
            Source::Listing(wanted) => {
                wanted.borrow_mut().push(Wanted { name, shape: shape.to_vec(), init });
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

impl Parameters {
    /// First values of what a network asks for.
    ///
    /// *Errors*: none on a CPU.
    pub fn start(wanted: &[Wanted], seed: u64) -> Result<Self> {
        let start = |w: &Wanted| {
            let values = w.init.values(w.shape.iter().product(), seed, &w.name);
            Ok((w.name.clone(), Tensor::from_vec(values, w.shape.as_slice(), &Device::Cpu)?))
        };
        wanted.iter().map(start).collect()
    }

    /// Checks names and shapes against what a network asks for, both ways; each fault is named.
    pub fn faults(&self, wanted: &[Wanted]) -> Vec<String> {
        let mut faults = Vec::new();
        for w in wanted {
            match self.get(&w.name) {
                None => faults.push(format!("tensor `{}` {:?} is missing", w.name, w.shape)),
                Some(t) if t.dims() != w.shape => {
                    faults.push(format!("tensor `{}` is {:?}, expected {:?}", w.name, t.dims(), w.shape));
                }
                Some(_) => {}
            }
        }
        for (name, tensor) in self.iter() {
            if wanted.binary_search_by(|w| w.name.as_str().cmp(name)).is_err() {
                faults.push(format!(
                    "tensor `{}` {:?} is not part of this network",
                    name.escape_debug(),
                    tensor.dims()
                ));
            }
        }
        faults
    }
}
