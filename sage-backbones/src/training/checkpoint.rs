//! Checkpoint of a training run: the state from which the run resumes with the same bits.

use std::path::Path;

use candle_core::{Device, Tensor};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    Error, Parameters,
    nn::{AdamW, AdamWConfig, Moments},
    parameters::Header,
};

/// Results of one epoch of pretraining.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpochRow {
    /// Number of the epoch, from 1.
    pub epoch: u32,
    /// Steps of the optimiser so far.
    pub steps: u64,
    /// Mean goal loss in training.
    pub goal: f64,
    /// Mean trajectory loss in training.
    pub trajectory: f64,
    /// Mean norm of the gradient before clipping.
    pub gradient: f64,
    /// Learning rate of its last step.
    pub rate: f64,
    /// Validation: mean least end distance of six goals after non-maximum suppression, metres.
    pub min_fde6: f64,
    /// Validation: mean negative log-likelihood of the goal nearest to the recorded end point; the mean loss, if the network has a
    /// likelihood of trajectories.
    pub nll: f64,
    /// Duration, seconds.
    pub seconds: f64,
}

/// State after an epoch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint<Row = EpochRow> {
    /// Identity of the run: a run resumes only from a checkpoint of equal identity.
    pub identity: serde_json::Value,
    /// Rows so far.
    pub rows: Vec<Row>,
    /// Steps of the optimiser.
    pub steps: u64,
}

const FIRST: &str = "first moment/";
const SECOND: &str = "second moment/";
const NOTE: &str = "checkpoint";

impl<Row: Serialize + DeserializeOwned> Checkpoint<Row> {
    /// Writes weights and state of the optimiser as one file.
    ///
    /// *Errors*: [`Error::Io`].
    pub fn save(
        &self,
        weights: &Parameters,
        adam: &AdamW,
        header: &Header,
        path: &Path,
    ) -> Result<(), Error> {
        let mut all = weights.clone();
        for (name, moments) in &adam.moments {
            for (kind, values) in [(FIRST, &moments.first), (SECOND, &moments.second)] {
                let tensor = Tensor::from_slice(values, values.len(), &Device::Cpu)?;
                all.insert(format!("{kind}{name}"), tensor);
            }
        }
        let json = serde_json::to_string(self).map_err(|e| Error::Write(e.to_string()))?;
        let mut header = header.clone();
        header.notes.insert(NOTE.to_owned(), json);
        all.save(&header, path)
    }

    /// Reads what [`Checkpoint::save`] wrote.
    ///
    /// *Errors*: [`Error::Io`], [`Error::Format`].
    pub fn load(path: &Path, config: AdamWConfig) -> Result<(Self, Parameters, AdamW), Error> {
        let (all, header) = Parameters::load(path)?;
        let fail = |problem: String| Error::Format { path: path.to_owned(), problem };
        let json =
            header.notes.get(NOTE).ok_or_else(|| fail("holds weights but no training state".to_owned()))?;
        let state: Self = serde_json::from_str(json).map_err(|e| fail(format!("has a broken state: {e}")))?;
        let mut weights = Parameters::default();
        let mut adam = AdamW::new(config);
        adam.steps = state.steps;
        for (name, tensor) in all.iter() {
            let mut moments = |name: &str, set: fn(&mut Moments, Vec<f32>)| -> Result<(), Error> {
                set(adam.moments.entry(name.to_owned()).or_default(), tensor.to_vec1()?);
                Ok(())
            };
            if let Some(name) = name.strip_prefix(FIRST) {
                moments(name, |m, values| m.first = values)?;
            } else if let Some(name) = name.strip_prefix(SECOND) {
                moments(name, |m, values| m.second = values)?;
            } else {
                weights.insert(name, tensor.clone());
            }
        }
        for (name, moments) in &adam.moments {
            let expected = weights.get(name).map(Tensor::elem_count);
            if expected != Some(moments.first.len()) || expected != Some(moments.second.len()) {
                return Err(fail(format!("the moments of tensor `{name}` do not fit it")));
            }
        }
        Ok((state, weights, adam))
    }
}
