//! Named tensors: the weights of a network.

mod file;
mod init;
mod parameter_spec;
mod scope;

use std::collections::BTreeMap;

use candle_core::{DType, Device, Tensor, Var};

use crate::Error;

pub use file::{Header, LIMIT};
pub use init::Init;
pub use parameter_spec::ParameterSpec;
pub use scope::Scope;

/// The weights of a network, sorted by name.
///
/// ```
/// use std::path::Path;
///
/// use sage_backbones::{
///     Parameters,
///     candle::{Device, Tensor},
///     parameters::Header,
/// };
///
/// let bias = Tensor::new(&[0.5_f32, -1.0], &Device::Cpu)?;
/// let parameters = Parameters::from_iter([("bias".to_owned(), bias)]);
/// let mut bytes = parameters.to_bytes(&Header::default())?;
/// let (read, _) = Parameters::from_bytes(&bytes, Path::new("weights.safetensors"))?;
/// assert_eq!(read.hash()?, parameters.hash()?);
/// // The file holds a hash of its content: one changed bit is noticed.
/// *bytes.last_mut().ok_or("no bytes")? ^= 1;
/// assert!(Parameters::from_bytes(&bytes, Path::new("weights.safetensors")).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Parameters(BTreeMap<String, Tensor>);

impl Parameters {
    /// The tensor of a name.
    pub fn get(&self, name: &str) -> Option<&Tensor> {
        self.0.get(name)
    }

    /// Adds or replaces a tensor.
    pub fn insert(&mut self, name: impl Into<String>, tensor: Tensor) {
        self.0.insert(name.into(), tensor);
    }

    /// Names and tensors in the order of the names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Tensor)> {
        self.0.iter().map(|(name, tensor)| (name.as_str(), tensor))
    }

    /// Number of tensors.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Number type of the tensors, `f32` if there is none.
    pub fn dtype(&self) -> DType {
        self.0.values().next().map_or(DType::F32, Tensor::dtype)
    }

    /// Where the tensors are, the CPU if there is none.
    pub fn device(&self) -> &Device {
        self.0.values().next().map_or(&Device::Cpu, Tensor::device)
    }

    /// Copies on another device, without gradients to the originals.
    ///
    /// *Errors*: those of the device.
    pub fn to_device(&self, device: &Device) -> Result<Self, Error> {
        let copy =
            |(name, tensor): (&str, &Tensor)| Ok((name.to_owned(), tensor.detach().to_device(device)?));
        Ok(Self(self.iter().map(copy).collect::<candle_core::Result<_>>()?))
    }

    /// Number of elements of all tensors.
    pub fn numbers(&self) -> usize {
        self.0.values().map(Tensor::elem_count).sum()
    }

    /// Copies in another number type, without gradients to the originals.
    ///
    /// *Errors*: none on a CPU.
    pub fn to_dtype(&self, dtype: DType) -> Result<Self, Error> {
        let convert =
            |(name, tensor): (&str, &Tensor)| Ok((name.to_owned(), tensor.detach().to_dtype(dtype)?));
        Ok(Self(self.iter().map(convert).collect::<candle_core::Result<_>>()?))
    }

    /// The same storage, but no gradient flows back into it.
    pub fn detached(&self) -> Self {
        Self(self.0.iter().map(|(name, tensor)| (name.clone(), tensor.detach())).collect())
    }

    /// Parameters in which the tensors that `trained` accepts are variables, and these variables. Setting a
    /// variable changes the results of every network built from these parameters.
    ///
    /// *Errors*: none on a CPU.
    pub fn variables(&self, trained: impl Fn(&str) -> bool) -> Result<(Self, Variables), Error> {
        let mut all = self.detached();
        let mut variables = BTreeMap::new();
        for (name, tensor) in &mut all.0 {
            if trained(name) {
                let variable = Var::from_tensor(&tensor.copy()?)?;
                *tensor = variable.as_tensor().clone();
                variables.insert(name.clone(), variable);
            }
        }
        Ok((all, Variables(variables)))
    }

    /// Hash over names, shapes and bits: equal weights have equal hashes.
    ///
    /// *Errors*: none on a CPU.
    pub fn hash(&self) -> Result<String, Error> {
        let mut hasher = blake3::Hasher::new();
        for (name, tensor) in self.iter() {
            hasher.update(name.as_bytes()).update(&[0]);
            for size in tensor.dims() {
                hasher.update(&(*size as u64).to_le_bytes());
            }
            for x in tensor.flatten_all()?.to_dtype(DType::F64)?.to_vec1::<f64>()? {
                hasher.update(&x.to_le_bytes());
            }
        }
        Ok(hasher.finalize().to_hex()[..16].to_owned())
    }
}

impl FromIterator<(String, Tensor)> for Parameters {
    fn from_iter<I: IntoIterator<Item = (String, Tensor)>>(items: I) -> Self {
        Self(items.into_iter().collect())
    }
}

/// Parameters that training changes, sorted by name.
#[derive(Clone, Debug)]
pub struct Variables(BTreeMap<String, Var>);

impl Variables {
    /// Names and variables in the order of the names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Var)> {
        self.0.iter().map(|(name, variable)| (name.as_str(), variable))
    }

    /// Number of variables.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}
