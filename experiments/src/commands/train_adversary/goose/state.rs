//! The file from which an interrupted training resumes: networks, optimisers and the actions so far.

use std::{collections::BTreeMap, path::Path};

use anyhow::{Context as _, Result, ensure};
use candle_core::{Device, Tensor};
use sage_backbones::{Parameters, parameters::Header};
use sage_baselines::goose::networks::ACTION;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::training::{Losses, Training};

/// Key of the record in the header.
const KEY: &str = "training";
const LEARNER: &str = "learner.";
const ENCODER: &str = "encoder.";
const ACTIONS: &str = "actions";

#[derive(Serialize, Deserialize)]
struct Record {
    run: Value,
    updates: u64,
    encoder_steps: u64,
    losses: Vec<Losses>,
}

/// Writes the state.
///
/// *Errors*: as the system.
pub(super) fn save(training: &Training, run: &Value, path: &Path) -> Result<()> {
    let mut all = Parameters::default();
    for tensor in training.learner().tensors() {
        let values = Tensor::from_slice(tensor.numbers, tensor.shape, &Device::Cpu)?;
        all.insert(format!("{LEARNER}{}", tensor.name), values);
    }
    let (encoder, encoder_steps) = training.encoder().state()?;
    for (name, tensor) in encoder.iter() {
        all.insert(format!("{ENCODER}{name}"), tensor.clone());
    }
    let actions: Vec<f64> = training.actions().iter().flatten().copied().collect();
    let shape = (actions.len() / ACTION, ACTION);
    all.insert(ACTIONS, Tensor::from_vec(actions, shape, &Device::Cpu)?);
    let updates = training.learner().updates();
    let record = Record { run: run.clone(), updates, encoder_steps, losses: training.losses().to_vec() };
    let notes = [(KEY.to_owned(), serde_json::to_string(&record)?)].into();
    all.save(&Header { notes, ..Header::default() }, path)?;
    Ok(())
}

/// Resumes a training from its file, if that exists.
///
/// *Errors*: a file that is damaged or of another run, with the remedy.
pub(super) fn resume(training: &mut Training, run: &Value, path: &Path) -> Result<()> {
    if !path.exists() {
        return Ok(());
    }
    resumed(training, run, path)
        .with_context(|| format!("cannot resume from `{}`; give --force to start again", path.display()))
}

fn resumed(training: &mut Training, run: &Value, path: &Path) -> Result<()> {
    let (all, header) = Parameters::load(path)?;
    let text = header.notes.get(KEY).context("it holds no training")?;
    let record: Record = serde_json::from_str(text).context("its record is damaged")?;
    ensure!(record.run == *run, "it is of another run");
    let actions = all.get(ACTIONS).context("tensor `actions` is missing")?.to_vec2::<f64>()?;
    let actions: Vec<[f64; ACTION]> = actions
        .into_iter()
        .map(|row| row.try_into().ok().context("tensor `actions` has rows of another length"))
        .collect::<Result<_>>()?;
    let of = |prefix: &str| {
        let named = all.iter().filter_map(|(name, tensor)| Some((name.strip_prefix(prefix)?, tensor)));
        named.map(|(name, tensor)| (name.to_owned(), tensor.clone())).collect::<Vec<_>>()
    };
    let mut learner: BTreeMap<String, Vec<f32>> = BTreeMap::new();
    for (name, tensor) in of(LEARNER) {
        learner.insert(name, tensor.flatten_all()?.to_vec1()?);
    }
    let encoder: Parameters = of(ENCODER).into_iter().collect();
    training.resume(&actions, record.losses, |own, own_encoder| {
        own.set_tensors(&learner, record.updates).map_err(anyhow::Error::msg)?;
        Ok(own_encoder.set_state(&encoder, record.encoder_steps)?)
    })
}
