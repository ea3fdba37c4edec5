//! Pretraining of the prior on recorded futures.

use std::{collections::HashMap, path::Path, sync::Arc};

use rayon::prelude::*;
use sage_core::{scene::SceneData, seed::Rng, statistics};
use serde::{Deserialize, Serialize};

use super::{
    EpochRow, Examples, Gradient, Trainer,
    epochs::{self, CheckpointFile, Epoch, LoopOptions, Task},
    samples::{Example, recorded},
    step::trainable,
};
use crate::{
    Error, Parameters,
    backbone::{Backbone, finite},
    candidates::Sampling,
    labels,
    parameters::Header,
    prediction::propose,
};

/// Options of pretraining.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PretrainOptions {
    /// Passes over the scenes.
    pub epochs: u32,
    /// Vehicles per step.
    pub batch: usize,
    /// Largest learning rate.
    pub rate: f64,
    /// Share of the steps over which the learning rate rises; after them it falls as a cosine.
    pub warm_up: f64,
    /// Maximum norm of the gradient of a step.
    pub clip: f64,
    /// Weight decay.
    pub weight_decay: f64,
    /// Maximum number of vehicles per scene and epoch, drawn anew in each epoch.
    pub per_scene: usize,
    /// Standing vehicles per epoch, as a share of the moving ones.
    pub standing: f64,
    /// Whether samples are mirrored, each with probability one half.
    pub mirror: bool,
    /// Least distance between the six goals of validation, metres.
    pub radius: f32,
    /// Seed of the order of training.
    pub seed: u64,
}

impl Default for PretrainOptions {
    fn default() -> Self {
        Self {
            epochs: 12,
            batch: 16,
            rate: 1e-3,
            warm_up: 0.05,
            clip: 5.0,
            weight_decay: 0.01,
            per_scene: 10,
            standing: 0.1,
            mirror: true,
            radius: 7.0,
            seed: 0,
        }
    }
}

impl PretrainOptions {
    /// Refuses options out of range.
    ///
    /// *Errors*: [`Error::Option`] with the option and its value.
    pub fn check(&self) -> Result<(), Error> {
        check(&[
            ("epochs", f64::from(self.epochs), 1.0, 1e6),
            ("batch", self.batch as f64, 1.0, 1e6),
            ("rate", self.rate, 0.0, 1.0),
            ("warm_up", self.warm_up, 0.0, 0.99),
            ("clip", self.clip, 1e-9, f64::INFINITY),
            ("weight_decay", self.weight_decay, 0.0, 1e3),
            ("per_scene", self.per_scene as f64, 1.0, 1e9),
            ("standing", self.standing, 0.0, 1e6),
            ("radius", f64::from(self.radius), 0.0, 1e6),
        ])
    }
}

/// Refuses options out of range; each is given by its name, value, least and largest value.
pub(super) fn check(options: &[(&str, f64, f64, f64)]) -> Result<(), Error> {
    match options.iter().find(|(_, value, least, largest)| !(least..=largest).contains(&value)) {
        Some((name, value, least, largest)) => {
            Err(Error::Option(format!("option `{name}` is {value}; expected {least} to {largest}")))
        }
        None => Ok(()),
    }
}

/// Callbacks for progress.
pub trait Observer {
    /// Called before the first step of a resumed run, with the rows of its earlier epochs.
    fn resumed(&mut self, _rows: &[EpochRow]) {}
    /// Called after each step: epoch and step from 1, steps of the epoch, mean loss of the step.
    fn step(&mut self, epoch: u32, step: usize, steps: usize, loss: f64);
    /// Called after each epoch.
    fn epoch(&mut self, row: &EpochRow);
    /// Whether to stop after this step; the last checkpoint stays.
    fn stops(&self) -> bool {
        false
    }
}

/// Result of pretraining.
pub struct Pretrained {
    /// Weights of the epoch with the least nll in validation; `None` if the run stopped in its first epoch.
    pub best: Option<Parameters>,
    /// One row per epoch.
    pub rows: Vec<EpochRow>,
    /// Whether the run was stopped before its last epoch.
    pub stopped: bool,
}

/// Pretrains a network; resumes an earlier run of the same options and data.
///
/// After each epoch the folder holds the best weights so far (`prior.safetensors`) and the checkpoint
/// (`last.safetensors`).
///
/// The bits of the result depend on network, data and options, not on threads or on interruptions.
///
/// *Errors*: [`Error::NothingToTrain`], or [`Error::NotFinite`] for a number that is not
/// finite, with scene, step and tensor; [`Error::Io`], [`Error::Format`] for the folder.
pub fn pretrain(
    network: &dyn Backbone,
    train: &[SceneData],
    dev: &[SceneData],
    options: &PretrainOptions,
    header: &Header,
    folder: &Path,
    observer: &mut (dyn Observer + Sync),
) -> Result<Pretrained, Error> {
    options.check()?;
    if !network.parameter_specs().iter().any(|spec| network.parameter_group(&spec.name).is_pretrained()) {
        return Err(Error::NothingToTrain(format!("backbone `{}` has nothing to train", network.name())));
    }
    let moving = Examples::of(train).filter(|e| e.moves || e.of_interest);
    let standing = Examples::of(train).filter(|e| !e.moves && !e.of_interest);
    if moving.list().is_empty() {
        return Err(Error::NothingToTrain(format!(
            "no scene of {} shows a moving vehicle that is valid at frame 10 and in 30 of the 80 frames after it",
            train.len()
        )));
    }
    let held_out = Examples::of(dev).filter(|e| (e.moves || e.of_interest) && e.is_whole);
    if held_out.list().is_empty() {
        return Err(Error::NothingToTrain(format!(
            "no scene of {} to validate on shows a vehicle that is valid at frames 10 and 90",
            dev.len()
        )));
    }
    let loop_options = LoopOptions {
        epochs: options.epochs,
        batch: options.batch,
        clip: options.clip,
        weight_decay: options.weight_decay,
    };
    let identity = serde_json::json!({
        "backbone": network.name(), "network": network.options(), "options": options, "data": header.data,
        "start": network.parameters().hash()?,
    });
    let last = folder.join("last.safetensors");
    let best = folder.join("prior.safetensors");
    let checkpoint = CheckpointFile { file: &last, identity, header: header.clone() };
    let mut trainer =
        Trainer::new(network, |name| network.parameter_group(name).is_pretrained(), loop_options.config())?;
    let mut task = Futures { options, moving, standing, held_out, best: &best, header, observer };
    let (rows, stopped) = epochs::run(&mut task, &mut trainer, &loop_options, Some(&checkpoint))?;
    let best = if rows.is_empty() { None } else { Some(Parameters::load(&best)?.0) };
    Ok(Pretrained { best, rows, stopped })
}

/// Pretraining on recorded futures.
struct Futures<'d> {
    options: &'d PretrainOptions,
    moving: Examples<'d>,
    standing: Examples<'d>,
    held_out: Examples<'d>,
    /// File of the best weights so far.
    best: &'d Path,
    header: &'d Header,
    observer: &'d mut (dyn Observer + Sync),
}

impl Task for Futures<'_> {
    /// An example, and whether it is mirrored.
    type Item = (Example, bool);
    /// Goal loss and trajectory loss.
    type Note = [f64; 2];
    type Row = EpochRow;

    /// The moving vehicles and some of the standing ones.
    fn items(&self, epoch: u32) -> Vec<(Example, bool)> {
        self.order(epoch)
    }

    fn rate(&self, step: u64, steps: u64) -> f64 {
        self.options.rate * schedule(step, steps, self.options.warm_up)
    }

    fn item_gradient(
        &self,
        trainer: &Trainer,
        (example, mirrored): &(Example, bool),
        epoch: u32,
        step: usize,
    ) -> Result<(Option<Gradient>, [f64; 2]), Error> {
        let data = self.moving.scene(example);
        let network = trainer.trainable()?;
        let sample = self.moving.sample(example, network, *mirrored)?;
        let agent = &data.scene.tracks[example.track].id;
        let purpose = format!("loss of `{agent}` in epoch {epoch}, step {step}");
        let mut rng = Rng::new(self.options.seed, &data.name, &purpose);
        let loss = network.loss(&sample, &mut rng).map_err(|error| error.of(data, example.track))?;
        let agent = agent.escape_debug();
        let what = format!("epoch {epoch}, step {step}, scene `{}`, agent `{agent}`", data.name);
        let gradient = trainer.gradient(&loss, &what)?;
        let part = |name: &str| gradient.parts.iter().find(|p| p.0 == name).map_or(0.0, |p| p.1);
        let parts = [part("goal"), part("trajectory")];
        Ok((Some(gradient), parts))
    }

    fn after_step(&mut self, epoch: u32, step: usize, steps: usize, gradients: &[Gradient]) -> bool {
        let loss: f64 = gradients.iter().map(|g| g.loss).sum();
        self.observer.step(epoch, step, steps, loss / gradients.len() as f64);
        self.observer.stops()
    }

    fn row(&mut self, trainer: &Trainer, epoch: Epoch<[f64; 2]>) -> Result<EpochRow, Error> {
        let (min_fde6, nll) = self.validate(trainer)?;
        let items = epoch.notes.len() as f64;
        let sum = |k: usize| epoch.notes.iter().fold(0.0, |sum, note| sum + note[k]);
        Ok(EpochRow {
            epoch: epoch.number,
            steps: trainer.adam.steps,
            goal: sum(0) / items,
            trajectory: sum(1) / items,
            gradient: epoch.norms / epoch.steps as f64,
            rate: epoch.rate,
            min_fde6,
            nll,
            seconds: epoch.clock.elapsed().as_secs_f64(),
        })
    }

    fn after_epoch(&mut self, trainer: &Trainer, before: &[EpochRow], row: &EpochRow) -> Result<(), Error> {
        let least = before.iter().map(|r| r.nll).fold(f64::INFINITY, f64::min);
        if row.nll < least || before.is_empty() {
            trainer.weights()?.save(self.header, self.best)?;
        }
        self.observer.epoch(row);
        Ok(())
    }

    fn resumed(&mut self, rows: &[EpochRow]) {
        self.observer.resumed(rows);
    }
}

impl Futures<'_> {
    /// Examples of an epoch in their order, each with a flag that says if it is mirrored.
    fn order(&self, epoch: u32) -> Vec<(Example, bool)> {
        let mut rng = Rng::new(self.options.seed, &format!("epoch {epoch}"), "order of training");
        let mut draw = |examples: &Examples, most: usize| {
            let mut drawn = examples.list().to_vec();
            rng.shuffle(&mut drawn);
            let mut of_scene = HashMap::new();
            drawn.retain(|example| {
                let count: &mut usize = of_scene.entry(example.scene).or_default();
                *count += 1;
                *count <= self.options.per_scene
            });
            drawn.truncate(most);
            drawn
        };
        let moving = draw(&self.moving, usize::MAX);
        let standing = draw(&self.standing, (moving.len() as f64 * self.options.standing) as usize);
        let mut order: Vec<(Example, bool)> =
            moving.into_iter().chain(standing).map(|e| (e, false)).collect();
        rng.shuffle(&mut order);
        for (_, mirrored) in &mut order {
            *mirrored = self.options.mirror && rng.unit() < 0.5;
        }
        order
    }

    /// Mean least end distance of six goals, and mean nll, over the held-out examples.
    fn validate(&self, trainer: &Trainer) -> Result<(f64, f64), Error> {
        let frozen = trainer.frozen()?;
        let network = trainable(&*frozen)?;
        let one = |example: &Example| -> Result<(f64, f64), Error> {
            let sample = self.held_out.sample(example, network, false)?;
            let data = self.held_out.scene(example);
            let truth = recorded(&data.scene.track_as_observed(example.track));
            let encoding = network.encode(Arc::clone(&sample.features))?;
            let nms = Sampling::Nms { radius: self.options.radius };
            let named = |error: Error| error.of(data, example.track);
            let six = propose(network, &encoding, 6, nms, &mut Rng::new(0, "", "")).map_err(named)?;
            let log_probs: Vec<f32> = finite(&network.log_probs(&encoding)?).map_err(named)?;
            let ends = network.mode_ends(&encoding)?;
            let nearest = labels::nearest(&ends, labels::end(&sample.future, &sample.valid).position);
            let distances = truth.distances(six.iter().map(|p| p.trajectory.points()));
            let nll = match network.trajectory_likelihood() {
                None => -f64::from(log_probs[nearest]),
                // Its modes are equally likely. The noise is the same in all epochs.
                Some(_) => {
                    let agent = &data.scene.tracks[example.track].id;
                    let mut rng = Rng::new(0, &data.name, &format!("validation of `{agent}`"));
                    let loss = network.loss(&sample, &mut rng).map_err(named)?;
                    loss.parts.iter().map(|part| part.1).sum()
                }
            };
            Ok((distances.min_fde, nll))
        };
        let all: Vec<Result<(f64, f64), Error>> =
            self.held_out.list().par_iter().with_max_len(1).map(one).collect();
        let all = all.into_iter().collect::<Result<Vec<_>, _>>()?;
        let mean = |pick: fn(&(f64, f64)) -> f64| {
            let values: Vec<f64> = all.iter().map(pick).collect();
            statistics::mean(&values).unwrap_or(f64::NAN)
        };
        Ok((mean(|x| x.0), mean(|x| x.1)))
    }
}

/// Share of the largest learning rate at a step: a linear rise, then a cosine down to zero.
fn schedule(step: u64, steps: u64, warm_up: f64) -> f64 {
    let at = (step + 1) as f64 / (steps + 1) as f64;
    if at < warm_up {
        at / warm_up
    } else {
        0.5 + 0.5 * (std::f64::consts::PI * (at - warm_up) / (1.0 - warm_up)).cos()
    }
}
