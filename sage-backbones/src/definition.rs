//! What all networks hold beside their layers.

use std::sync::Arc;

use candle_core::{DType, Device, Shape, Tensor, WithDType};
use sage_core::registry::Entry;
use serde_json::Value;

use crate::{
    Backbone, Error, Parameters,
    features::Table,
    parameters::{ParameterSpec, Scope},
};

/// A network but for its layers: name and options in the registry, and parameters.
#[derive(Clone, Debug)]
pub struct Definition {
    /// Name in the registry.
    pub name: &'static str,
    /// Options, as given to the registry.
    pub options: Value,
    /// Names, shapes and initial values of the parameters, sorted by name.
    pub specs: Arc<[ParameterSpec]>,
    /// The parameters.
    pub parameters: Parameters,
}

impl Definition {
    /// The network of a registry entry with initial parameters: those that the constructor of its layers asks for.
    ///
    /// *Errors*: [`Error::Tensor`] by the constructor.
    pub fn of<N: Entry<dyn Backbone>, L>(
        options: &N::Options,
        seed: u64,
        layers: impl FnOnce(&Scope) -> candle_core::Result<L>,
    ) -> Result<Self, Error> {
        let specs = Scope::list(layers)?;
        let parameters = Parameters::start(&specs, seed)?;
        let options = serde_json::to_value(options).map_err(candle_core::Error::wrap)?;
        Ok(Self { name: N::NAME, options, specs: specs.into(), parameters })
    }

    /// The same network with other parameters.
    pub fn with(&self, parameters: Parameters) -> Self {
        Self { parameters, ..self.clone() }
    }

    /// The root of the names, from which layers take their parameters.
    pub fn scope(&self) -> Scope {
        Scope::of(&self.parameters)
    }

    /// A table in the number type and on the device of the parameters.
    ///
    /// *Shapes*: (rows, columns).
    /// *Errors*: those of the device.
    pub fn tensor(&self, table: &Table) -> candle_core::Result<Tensor> {
        self.constant(&table.values[..], (table.rows(), table.columns))
    }

    /// Numbers in the number type and on the device of the parameters.
    ///
    /// *Errors*: numbers that do not fill the shape; those of the device.
    pub fn constant<T: WithDType>(
        &self,
        numbers: &[T],
        shape: impl Into<Shape>,
    ) -> candle_core::Result<Tensor> {
        Tensor::from_slice(numbers, shape.into(), self.device())?.to_dtype(self.dtype())
    }

    /// Where the parameters are.
    pub fn device(&self) -> &Device {
        self.parameters.device()
    }

    /// Number type of the parameters.
    pub fn dtype(&self) -> DType {
        self.parameters.dtype()
    }
}
