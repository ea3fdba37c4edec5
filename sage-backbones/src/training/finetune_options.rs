//! Options of preference fine-tuning.

use sage_core::{objective::ObjectiveSpec, preference_pairs::Pairing};
use serde::{Deserialize, Serialize};

use super::pretrain::check;
use crate::{Error, candidates::Sampling};

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
    pub selection: Sampling,
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
            selection: Sampling::Gumbel,
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
            selection: Sampling::Nms { radius: 3.0 },
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
        believable_first: false,
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
    pub(super) fn share(self, step: u64, steps: u64, warm_up: u64) -> f64 {
        let rise = ((step + 1) as f64 / (warm_up + 1) as f64).min(1.0);
        match self {
            Self::Cosine => {
                rise * (0.5 + 0.5 * (std::f64::consts::PI * step as f64 / steps.max(1) as f64).cos())
            }
            Self::Constant => rise,
        }
    }
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
