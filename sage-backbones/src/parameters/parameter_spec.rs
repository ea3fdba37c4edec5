//! Specifications of a network's parameters: names, shapes and initial values.

use candle_core::{Device, Result, Tensor};

use super::{Init, Parameters};

/// Specification of one parameter of a network.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterSpec {
    /// Its full name.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its initial values.
    pub init: Init,
}

impl Parameters {
    /// Initial values of a network's parameters.
    ///
    /// *Errors*: none on a CPU.
    pub fn start(specs: &[ParameterSpec], seed: u64) -> Result<Self> {
        let start = |spec: &ParameterSpec| {
            let values = spec.init.values(spec.shape.iter().product(), seed, &spec.name);
            Ok((spec.name.clone(), Tensor::from_vec(values, spec.shape.as_slice(), &Device::Cpu)?))
        };
        specs.iter().map(start).collect()
    }

    /// Every difference in names and shapes from a network's specifications: missing, misshapen and extra
    /// tensors.
    pub fn mismatches(&self, specs: &[ParameterSpec]) -> Vec<String> {
        let mut mismatches = Vec::new();
        for spec in specs {
            match self.get(&spec.name) {
                None => mismatches.push(format!("tensor `{}` {:?} is missing", spec.name, spec.shape)),
                Some(tensor) if tensor.dims() != spec.shape => {
                    mismatches.push(format!(
                        "tensor `{}` is {:?}, expected {:?}",
                        spec.name,
                        tensor.dims(),
                        spec.shape
                    ));
                }
                Some(_) => {}
            }
        }
        for (name, tensor) in self.iter() {
            if specs.binary_search_by(|spec| spec.name.as_str().cmp(name)).is_err() {
                mismatches.push(format!(
                    "tensor `{}` {:?} is not part of this network",
                    name.escape_debug(),
                    tensor.dims()
                ));
            }
        }
        mismatches
    }
}
