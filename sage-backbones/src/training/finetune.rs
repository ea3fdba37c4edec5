//! Preference fine-tuning of an expert from a prior (HGPO).
//!
//! For each scene, candidates are drawn from the present policy and paired by feasibility and reward
//! ([`sage_core::preference_pairs`]). The loss of a pair is `−ln σ(kl_beta · (Δ − Δ_ref))`. `Δ` is the
//! difference of the log-probabilities of winner and loser under the policy, or of a network's own measure
//! ([`crate::backbone::TrajectoryLikelihood`]); `Δ_ref` is that under the prior, at the same goals. Everything that
//! fine-tuning does not change is computed once: encodings, the trajectories of all goals, and their terms of the experts' objectives. With [`Tunes::All`] the encoder is
//! tuned too, and the policy encodes each scene again; the trajectories stay the prior's.

use std::collections::BTreeSet;

use candle_core::Tensor;
use sage_core::{objective::Objective, seed::Rng};
use serde::{Deserialize, Serialize};

use super::{
    FinetuneOptions, Gradient, Trainer, Tunes,
    epochs::{self, CheckpointFile, Epoch, LoopOptions, Task},
    goal_table::{ExpertObjective, Measures},
    mode_pairs::ModePairs,
    prepared_scene::{PreparedScene, numbers},
};
use crate::{
    Error, Parameters,
    backbone::{Backbone, Loss, ParameterGroup, Shared, finite},
    encoding::Encoding,
    nn::AdamWConfig,
    own_encoder::reencode,
};

/// Results of one epoch of fine-tuning: means over scenes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FinetuneRow {
    /// Number of the epoch, from 1.
    pub epoch: u32,
    /// Loss.
    pub loss: f64,
    /// Mean of `kl_beta · (Δ − Δ_ref)`.
    pub margin: f64,
    /// Share of pairs that the policy has in the right order.
    pub accuracy: f64,
    /// Pairs per scene.
    pub pairs: f64,
    /// Pairs by feasibility, per scene.
    pub pairs_by_feasibility: f64,
    /// Share of candidates that are feasible.
    pub feasible: f64,
    /// Best adversarial reward among the feasible candidates.
    pub best_reward: f64,
    /// Divergence from the prior over all goals, nats.
    pub kl: f64,
    /// Share of scenes without a pair.
    pub without_pairs: f64,
    /// Probability of a feasible trajectory under the policy.
    pub expected_feasible: f64,
    /// Probability of a feasible trajectory that hits the ego, under the policy.
    pub expected_attack: f64,
    /// Probability of a believable attack, under the policy.
    pub expected_believable: f64,
    /// Mean adversarial reward (R_adv) under the policy.
    pub expected_reward: f64,
    /// Mean realism penalty (P_real) under the policy.
    pub expected_penalty: f64,
    /// Duration, seconds.
    pub seconds: f64,
}

/// Fine-tunes an expert from a prior. The scenes must be prepared with this prior and with `measures`, which
/// include the expert's objective. `callback` gets one row per epoch, also for the epochs of a resumed run.
///
/// *Errors*: [`Error::NothingToTrain`] without scenes, or [`Error::NotFinite`] for a number that is not finite, with epoch, scene and
/// tensor; [`Error::Io`] if the checkpoint cannot be written; [`Error::Format`] for a checkpoint that is
/// damaged or of another run.
pub fn finetune(
    prior: &dyn Backbone,
    scenes: &[PreparedScene],
    measures: &Measures,
    objective: &Objective,
    options: &FinetuneOptions,
    checkpoint: Option<&CheckpointFile>,
    callback: impl FnMut(&FinetuneRow) + Sync,
) -> Result<Parameters, Error> {
    options.check()?;
    if scenes.is_empty() {
        return Err(Error::NothingToTrain("no scene has an adversary and an ego path to tune on".to_owned()));
    }
    let loop_options = LoopOptions {
        epochs: options.epochs,
        batch: options.batch,
        clip: options.clip,
        weight_decay: options.weight_decay,
    };
    let of_encoder = match options.tunes {
        Tunes::Scores => BTreeSet::new(),
        Tunes::All => encoder_parameters(prior, &scenes[0])?,
    };
    let is_tuned = |name: &str| {
        let group = prior.parameter_group(name);
        let is_left_out = group == ParameterGroup::Interaction && !options.interaction_head;
        group.is_finetuned() && !is_left_out || of_encoder.contains(name)
    };
    if options.tunes == Tunes::All && prior.shared() != Shared::Trajectories {
        return Err(Error::Option(format!(
            "`tunes` is `all`, but experts of backbone `{}` have trajectories of their own: its parameter groups say what is tuned",
            prior.name()
        )));
    }
    let mut trainer = Trainer::new(prior, is_tuned, loop_options.config())?;
    let mut task = Preferences { prior, scenes, expert: measures.expert(objective)?, options, callback };
    epochs::run(&mut task, &mut trainer, &loop_options, checkpoint)?;
    trainer.weights()
}

/// Names of the parameters of the prior's group that log-probabilities depend on. The others, such as the decoder of
/// trajectories, have no gradient; weight decay alone must not change them.
fn encoder_parameters(prior: &dyn Backbone, scene: &PreparedScene) -> Result<BTreeSet<String>, Error> {
    let of_prior = |name: &str| prior.parameter_group(name) == ParameterGroup::Prior;
    let trainer = Trainer::new(prior, of_prior, AdamWConfig::default())?;
    let encoding = reencode(trainer.network(), prior, &scene.encoding)?;
    let store = trainer.network().log_probs(&encoding)?.get(0)?.backward()?;
    let reached = trainer.variables().iter().filter(|(_, variable)| store.get(variable).is_some());
    Ok(reached.map(|(name, _)| name.to_owned()).collect())
}

/// Fine-tuning on pairs of candidates of prepared scenes.
struct Preferences<'s, H> {
    prior: &'s dyn Backbone,
    scenes: &'s [PreparedScene],
    expert: ExpertObjective<'s>,
    options: &'s FinetuneOptions,
    callback: H,
}

impl<H: FnMut(&FinetuneRow) + Sync> Task for Preferences<'_, H> {
    /// Number of the scene.
    type Item = usize;
    type Note = FinetuneRow;
    type Row = FinetuneRow;

    fn items(&self, epoch: u32) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.scenes.len()).collect();
        Rng::new(self.options.seed, &format!("epoch {epoch}"), "order of fine-tuning").shuffle(&mut order);
        order
    }

    fn rate(&self, step: u64, steps: u64) -> f64 {
        self.options.rate * self.options.schedule.share(step, steps, self.options.warm_up)
    }

    fn item_gradient(
        &self,
        trainer: &Trainer,
        scene: &usize,
        epoch: u32,
        _step: usize,
    ) -> Result<(Option<Gradient>, FinetuneRow), Error> {
        let scene = &self.scenes[*scene];
        let network = trainer.network();
        let own = match (network.shared(), self.options.tunes) {
            (Shared::Nothing, _) => Some(network.encode(scene.encoding.shared_features())?),
            (_, Tunes::Scores) => None,
            (_, Tunes::All) => Some(reencode(network, self.prior, &scene.encoding)?),
        };
        let encoding = own.as_ref().unwrap_or(&scene.encoding);
        self.scene_gradient(trainer, scene, encoding, epoch)
    }

    fn row(&mut self, _: &Trainer, epoch: Epoch<FinetuneRow>) -> Result<FinetuneRow, Error> {
        let mut sum = FinetuneRow::default();
        epoch.notes.iter().for_each(|note| add(&mut sum, note));
        let mut row = mean(&sum, self.scenes.len());
        row.epoch = epoch.number;
        row.seconds = epoch.clock.elapsed().as_secs_f64();
        Ok(row)
    }

    fn after_epoch(&mut self, _: &Trainer, _: &[FinetuneRow], row: &FinetuneRow) -> Result<(), Error> {
        (self.callback)(row);
        Ok(())
    }

    fn resumed(&mut self, rows: &[FinetuneRow]) {
        rows.iter().for_each(&mut self.callback);
    }
}

impl<H> Preferences<'_, H> {
    /// Gradient of one scene, if it has pairs, and the scene's statistics.
    fn scene_gradient(
        &self,
        trainer: &Trainer,
        scene: &PreparedScene,
        encoding: &Encoding,
        epoch: u32,
    ) -> Result<(Option<Gradient>, FinetuneRow), Error> {
        let options = self.options;
        let log_probs = trainer.network().log_probs(encoding)?;
        let what = format!("epoch {epoch}, scene `{}`", scene.name);
        let policy: Vec<f32> = finite(&log_probs).map_err(|error| match error {
            Error::NotFinite(problem) => Error::NotFinite(format!("{what}: {problem}")),
            other => other,
        })?;
        let mut rng = scene.rng(options.seed, &format!("candidates of epoch {epoch}"));
        let (selected, pairs) = scene.pairs(&policy, &self.expert, options, &mut rng);
        let policy: Vec<f64> = policy.iter().map(|p| f64::from(*p)).collect();
        let expected = scene.expectation_of(&policy);
        let feasible = selected.iter().filter(|&&goal| scene.table.is_feasible(goal));
        let mut row = FinetuneRow {
            pairs: pairs.len() as f64,
            pairs_by_feasibility: pairs.iter().filter(|p| p.by_feasibility).count() as f64,
            feasible: feasible.clone().count() as f64 / selected.len().max(1) as f64,
            best_reward: feasible.map(|&goal| scene.table.reward(goal)).fold(0.0, f64::max),
            kl: expected.kl,
            without_pairs: f64::from(u8::from(pairs.is_empty())),
            expected_feasible: expected.feasible,
            expected_attack: expected.attack,
            expected_believable: expected.believable,
            expected_reward: expected.reward,
            expected_penalty: expected.penalty,
            ..FinetuneRow::default()
        };
        if pairs.is_empty() {
            return Ok((None, row));
        }
        let pairs = ModePairs::of(&selected, &pairs);
        let rng = scene.rng(options.seed, &format!("preferences of epoch {epoch}"));
        let margins = match trainer.trainable()?.trajectory_likelihood() {
            None => pairs.by_log_probs(&log_probs, &scene.reference)?,
            Some(likelihood) => pairs.by_trajectories(likelihood, encoding, self.prior, scene, &rng)?,
        };
        let margins = (margins * options.kl_beta)?;
        let (values, count) = (numbers(&margins)?, pairs.better.len());
        let loss = Loss::of(vec![("preference", minus_log_sigmoid(&margins)?.mean_all()?)])?;
        row.loss = loss.parts[0].1;
        row.margin = values.iter().sum::<f64>() / count as f64;
        row.accuracy = values.iter().filter(|m| **m > 0.0).count() as f64 / count as f64;
        let gradient = trainer.gradient(&loss, &what)?;
        Ok((Some(gradient), row))
    }
}

/// `−ln σ(x)`, computed as `max(0, −x) + ln(1 + e^−|x|)`.
fn minus_log_sigmoid(x: &Tensor) -> candle_core::Result<Tensor> {
    let tail = ((x.abs()?.neg()?.exp()? + 1.0)?).log()?;
    x.neg()?.relu()? + tail
}

fn fields(row: &mut FinetuneRow) -> [&mut f64; 14] {
    [
        &mut row.loss,
        &mut row.margin,
        &mut row.accuracy,
        &mut row.pairs,
        &mut row.pairs_by_feasibility,
        &mut row.feasible,
        &mut row.best_reward,
        &mut row.kl,
        &mut row.without_pairs,
        &mut row.expected_feasible,
        &mut row.expected_attack,
        &mut row.expected_believable,
        &mut row.expected_reward,
        &mut row.expected_penalty,
    ]
}

fn add(sum: &mut FinetuneRow, row: &FinetuneRow) {
    let mut row = row.clone();
    for (sum, x) in fields(sum).into_iter().zip(fields(&mut row)) {
        *sum += *x;
    }
}

fn mean(sum: &FinetuneRow, scenes: usize) -> FinetuneRow {
    let mut row = sum.clone();
    // Loss, margin and accuracy are over the scenes that had pairs.
    let with_pairs = (scenes as f64 - sum.without_pairs).max(1.0);
    for (k, x) in fields(&mut row).into_iter().enumerate() {
        *x /= if k < 3 { with_pairs } else { scenes as f64 };
    }
    row
}
