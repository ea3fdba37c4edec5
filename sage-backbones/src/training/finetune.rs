//! Preference fine-tuning of an expert from a prior (HGPO).
//!
//! For each scene, candidates are drawn from the present policy and paired by feasibility and reward
//! ([`sage_core::preference_pairs`]). The loss of a pair is `−ln σ(kl_beta · (Δ − Δ_ref))`. `Δ` is the
//! difference of the log-probabilities of winner and loser under the policy; `Δ_ref` is that under the prior,
//! at the same goals. Everything that fine-tuning does not change is computed once: encodings, the
//! trajectories of all goals, and their terms of the experts' objectives. With [`Tunes::All`] the encoder is
//! tuned too, and the policy encodes each scene again; the trajectories stay the prior's.

use std::collections::BTreeSet;

use candle_core::{Device, Tensor};
use sage_core::{
    objective::{Objective, ObjectiveSpec},
    preference_pairs::{Pairing, ScoredCandidate, preference_pairs},
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use super::{
    Gradient, Trainer,
    epochs::{self, CheckpointFile, Epoch, LoopOptions, Task},
    goal_table::{ExpertObjective, Measures},
    prepared_scene::{PreparedScene, numbers},
    pretrain::check,
};
use crate::{
    Error, Parameters,
    backbone::{Backbone, Loss, ParameterGroup, finite},
    candidates::{Selection, select},
    encoding::Encoding,
    nn::AdamWConfig,
    own_encoder::reencode,
};

/// Options of fine-tuning.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FinetuneOptions {
    /// Objective of the expert.
    pub objective: ObjectiveSpec,
    /// Parameters that are tuned.
    #[serde(skip_serializing_if = "Tunes::is_scores")]
    pub tunes: Tunes,
    /// Whether the interaction head is tuned. If not, it stays zero, as if the network had none.
    #[serde(skip_serializing_if = "is_true")]
    pub interaction_head: bool,
    /// Rule that forms pairs.
    pub pairing: Pairing,
    /// Least difference of the two rewards of a pair.
    pub margin: f64,
    /// Maximum number of pairs per scene.
    pub max_pairs: usize,
    /// Candidates per scene.
    pub candidates: usize,
    /// Rule that selects candidates.
    pub selection: Selection,
    /// Temperature of HGPO: with a smaller value the policy moves farther from the prior.
    pub kl_beta: f64,
    /// Whether each scene is also used mirrored.
    pub mirror: bool,
    /// Passes over the scenes.
    pub epochs: u32,
    /// Scenes per step.
    pub batch: usize,
    /// Largest learning rate.
    pub rate: f64,
    /// How the learning rate changes after the warm-up.
    #[serde(skip_serializing_if = "Schedule::is_cosine")]
    pub schedule: Schedule,
    /// Steps over which the learning rate rises.
    pub warm_up: u64,
    /// Maximum norm of the gradient of a step.
    pub clip: f64,
    /// Weight decay.
    pub weight_decay: f64,
    /// Seed of candidates, pairs and order.
    pub seed: u64,
}

impl Default for FinetuneOptions {
    /// Options of the adversarial expert.
    fn default() -> Self {
        Self {
            objective: preset("natural-adversarial"),
            tunes: Tunes::Scores,
            interaction_head: true,
            pairing: Pairing::Hierarchical,
            // About a second of contact time: pairs are between hits and misses rather than between misses.
            margin: 1.0,
            max_pairs: 128,
            candidates: 128,
            selection: Selection::Gumbel,
            kl_beta: 0.05,
            mirror: true,
            epochs: 7,
            batch: 4,
            rate: 2e-3,
            schedule: Schedule::Cosine,
            warm_up: 20,
            clip: 1.0,
            weight_decay: 0.3,
            seed: 0,
        }
    }
}

impl FinetuneOptions {
    /// Refuses options out of range.
    ///
    /// *Errors*: [`Error::Option`] with the option and its value.
    pub fn check(&self) -> Result<(), Error> {
        check(&[
            ("margin", self.margin, 0.0, 1e6),
            ("max_pairs", self.max_pairs as f64, 1.0, 1e6),
            ("candidates", self.candidates as f64, 2.0, 1e4),
            ("kl_beta", self.kl_beta, 1e-9, 1e6),
            ("epochs", f64::from(self.epochs), 1.0, 1e6),
            ("batch", self.batch as f64, 1.0, 1e6),
            ("rate", self.rate, 0.0, 1.0),
            ("clip", self.clip, 1e-9, f64::INFINITY),
            ("weight_decay", self.weight_decay, 0.0, 1e3),
        ])
    }

    /// Options of the realistic expert. The paper also gives it the adversarial reward, with a weight of one
    /// tenth. The reward of a hit is ten times the differences of penalties, so with that weight this expert
    /// attacks too. It is tuned more gently than the adversarial one: the closer it stays to the prior, the
    /// more attacks remain among the candidates between the two.
    pub fn realistic() -> Self {
        Self {
            objective: preset("natural-realistic"),
            margin: 0.07,
            max_pairs: 64,
            candidates: 64,
            selection: Selection::Nms { radius: 3.0 },
            kl_beta: 0.3,
            epochs: 1,
            ..Self::default()
        }
    }

    /// Options of the lawful expert. A margin of 0.3 is a third of a metre of mean lane distance, or a third of a
    /// second against the traffic.
    pub fn lawful() -> Self {
        Self { objective: preset("lawful"), margin: 0.3, kl_beta: 0.1, epochs: 3, ..Self::default() }
    }
}

fn is_true(value: &bool) -> bool {
    *value
}

fn preset(name: &str) -> ObjectiveSpec {
    ObjectiveSpec::preset(name).unwrap_or_else(|| ObjectiveSpec {
        terms: Vec::new(),
        feasibility: Default::default(),
        violation_weight: 0.0,
    })
}

/// Parameters that fine-tuning changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Tunes {
    /// Those of the scores and of the interaction head. Encodings stay the prior's.
    #[default]
    Scores,
    /// All that the probabilities depend on, with the encoder. The trajectories of the modes stay the prior's.
    All,
}

impl Tunes {
    fn is_scores(&self) -> bool {
        *self == Self::Scores
    }
}

/// How the learning rate changes after the warm-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Schedule {
    /// Down to zero along half a cosine.
    #[default]
    Cosine,
    /// Not at all, as in the paper.
    Constant,
}

impl Schedule {
    fn is_cosine(&self) -> bool {
        *self == Self::Cosine
    }

    /// Share of the largest learning rate at one of `steps` steps, after a linear rise over `warm_up` steps.
    fn share(self, step: u64, steps: u64, warm_up: u64) -> f64 {
        let rise = ((step + 1) as f64 / (warm_up + 1) as f64).min(1.0);
        match self {
            Self::Cosine => {
                rise * (0.5 + 0.5 * (std::f64::consts::PI * step as f64 / steps.max(1) as f64).cos())
            }
            Self::Constant => rise,
        }
    }
}

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
        let own = match self.options.tunes {
            Tunes::Scores => None,
            Tunes::All => Some(reencode(trainer.network(), self.prior, &scene.encoding)?),
        };
        let encoding = own.as_ref().unwrap_or(&scene.encoding);
        scene_gradient(trainer, scene, encoding, &self.expert, self.options, epoch)
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

/// Gradient of one scene, if it has pairs, and the scene's statistics.
fn scene_gradient(
    trainer: &Trainer,
    scene: &PreparedScene,
    encoding: &Encoding,
    expert: &ExpertObjective,
    options: &FinetuneOptions,
    epoch: u32,
) -> Result<(Option<Gradient>, FinetuneRow), Error> {
    let log_probs = trainer.network().log_probs(encoding)?;
    let what = format!("epoch {epoch}, scene `{}`", scene.name);
    let policy: Vec<f32> = finite(&log_probs).map_err(|error| match error {
        Error::NotFinite(problem) => Error::NotFinite(format!("{what}: {problem}")),
        other => other,
    })?;
    // The folder of a scene file must not matter.
    let own = scene.name.rsplit(['/', '\\']).next().unwrap_or(&scene.name);
    let mut rng = Rng::new(options.seed, own, &format!("candidates of epoch {epoch}"));
    let selected = select(&policy, &scene.ends, options.candidates, options.selection, &mut rng);
    let candidates: Vec<ScoredCandidate> = selected
        .iter()
        .map(|&goal| ScoredCandidate {
            reward: scene.table.value(goal, expert),
            is_feasible: scene.table.is_feasible(goal),
        })
        .collect();
    let pairs = preference_pairs(&candidates, options.pairing, options.max_pairs, options.margin, &mut rng);
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
    let goals = |pick: fn(&sage_core::preference_pairs::Pair) -> usize| -> Vec<u32> {
        pairs.iter().map(|pair| selected[pick(pair)] as u32).collect()
    };
    let (winners, losers) = (goals(|p| p.winner), goals(|p| p.loser));
    let count = pairs.len();
    let reference: Vec<f64> = winners
        .iter()
        .zip(&losers)
        .map(|(&w, &l)| scene.reference[w as usize] - scene.reference[l as usize])
        .collect();
    let select = |goals: Vec<u32>| log_probs.index_select(&Tensor::from_vec(goals, count, &Device::Cpu)?, 0);
    let difference = (select(winners)? - select(losers)?)?;
    let reference = Tensor::from_vec(reference, count, &Device::Cpu)?.to_dtype(difference.dtype())?;
    let margins = ((difference - reference)? * options.kl_beta)?;
    let values = numbers(&margins)?;
    let loss = Loss::of(vec![("preference", minus_log_sigmoid(&margins)?.mean_all()?)])?;
    row.loss = loss.parts[0].1;
    row.margin = values.iter().sum::<f64>() / count as f64;
    row.accuracy = values.iter().filter(|m| **m > 0.0).count() as f64 / count as f64;
    let gradient = trainer.gradient(&loss, &what)?;
    Ok((Some(gradient), row))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_schedule_rises_and_then_falls_or_stays() {
        let share = |schedule: Schedule, step| schedule.share(step, 100, 3);
        for schedule in [Schedule::Cosine, Schedule::Constant] {
            assert!((share(schedule, 0) - 0.25).abs() < 1e-12, "a quarter in the first of four steps");
        }
        assert_eq!([3, 50, 99].map(|step| share(Schedule::Constant, step)), [1.0; 3]);
        assert!((share(Schedule::Cosine, 50) - 0.5).abs() < 1e-12 && share(Schedule::Cosine, 99) < 1e-3);
        assert_eq!(Schedule::Constant.share(0, 100, 0), 1.0, "no warm-up");
    }

    #[test]
    fn options_of_earlier_files_have_the_same_text() {
        // Weights' headers and identities of runs hold this text.
        let text = serde_json::to_string(&FinetuneOptions::default()).unwrap();
        assert!(
            !text.contains("schedule") && !text.contains("interaction_head") && !text.contains("tunes"),
            "{text}"
        );
        let options = FinetuneOptions {
            schedule: Schedule::Constant,
            interaction_head: false,
            ..FinetuneOptions::default()
        };
        let text = serde_json::to_string(&options).unwrap();
        assert!(
            text.contains(r#""schedule":"constant""#) && text.contains(r#""interaction_head":false"#),
            "{text}"
        );
        assert_eq!(serde_json::from_str::<FinetuneOptions>(&text).unwrap(), options);
    }
}
