//! Arguments of the commands that train driving policies.

use std::path::PathBuf;

use advsage::{
    driver_spec::DriverSpec,
    part::{Part, split},
};
use clap::Args;
use sage_core::registry::{Entry, Registry};
use sage_sim::environment::{DrivingReward, RewardSum, reward::Published};

use super::{
    FolderArgs, MOST_PROCEDURAL, SplitArgs,
    attacking::MergerArgs,
    help::{ATTACK, OUTPUT, RUN, SCENE, SELECTION, TRAINING},
};

/// Train a driving policy, alone or against an adversary (SAGE, algorithm 2).
///
/// Every episode is a scene in which the adversary attacks with the probability and intensity of the curriculum; the
/// generator plans against the newest drive of the policy in that scene; with --search the policy drives against several plans. At fixed steps the policy is evaluated on the scenes of --eval, unchanged and under attack at λ = 1.
///
/// The output folder holds a folder per seed (`seed-0/`): `policy.safetensors` with its card, the policies of the last
/// five evaluations, `evaluations.csv`, `episodes.csv`, and a checkpoint; beside them `curves.csv`, SVG curves and
/// `run.json`. The same command resumes an interrupted run with bit-identical results. A policy file drives wherever
/// an ego is named: `sage simulate SCENE --ego td3:run/seed-0/policy.safetensors`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage train-ego --method none --updates 20000 --seeds 0..1 --out run/
  sage train-ego --learner ppo --method none --mirrored 0.5 --out run/
  sage train-ego scenes/ --splits docs/results/splits.json --split train \\
      --eval dev-scenes/ --method sage --updates 200000 --ratio 0.5 \\
      --seeds 0..5 --out run/")]
pub(crate) struct TrainEgoArgs {
    /// Scene files and folders for training (default: procedural scenes).
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub split: SplitArgs,
    /// Scene files and folders for evaluation (default: procedural scenes of another seed).
    #[arg(long, help_heading = SCENE, value_name = "PATH", num_args = 1..)]
    pub eval: Vec<PathBuf>,
    /// Evaluate on scenes of the training too.
    #[arg(long, help_heading = SCENE)]
    pub allow_overlap: bool,
    /// Number of procedural scenes for training, without PATH or with --procedural-share; without PATH a third as many are for evaluation.
    #[arg(long, help_heading = SCENE, value_name = "N", default_value_t = 120, value_parser = clap::value_parser!(u64).range(3..=MOST_PROCEDURAL))]
    pub procedural: u64,
    /// Generator of the attacks, by its name in `sage list`, or none.
    #[arg(long, help_heading = ATTACK, value_name = "NAME", default_value = "none")]
    pub method: Part,
    /// Let the newest policy drive against up to N of the drivable plans of --method, and attack by the first at which it is at
    /// fault, or by the strongest.
    #[arg(long, help_heading = ATTACK, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=64))]
    pub search: Option<u64>,
    /// Generator of the attacks in the evaluation, or none.
    #[arg(long, help_heading = ATTACK, value_name = "NAME", default_value = "sage")]
    pub eval_method: Part,
    /// Weights of the experts: procedural, waymo, waymo-paper, waymo-literal or a folder.
    #[arg(long, help_heading = ATTACK, value_name = "NAME", default_value = "procedural")]
    pub weights: String,
    /// Objective that selects one of the candidates: its name in `sage list`, or a JSON file.
    #[arg(long, help_heading = SELECTION, value_name = "NAME", default_value = "natural")]
    pub selection: String,
    #[command(flatten)]
    pub merging: MergerArgs,
    /// When and how strongly the adversary attacks, by its name in `sage list`.
    #[arg(long, help_heading = TRAINING, value_name = "NAME", default_value = "paper")]
    pub curriculum: Part,
    /// Which scene is next, by its name in `sage list`.
    #[arg(long, help_heading = TRAINING, value_name = "NAME", default_value = "uniform")]
    pub sampler: Part,
    /// What the other options are by default: as published, or as the shipped driver ppo was trained.
    #[arg(long, help_heading = TRAINING, value_name = "NAME", default_value = "published")]
    pub recipe: RecipeName,
    /// Algorithm: td3 as published, or ppo, which learns as much in a tenth of the time (default: td3; recipe driver: ppo).
    #[arg(long, help_heading = TRAINING, value_name = "NAME")]
    pub learner: Option<LearnerName>,
    /// PPO: steps of 0.1 s in all (default: 1000000).
    #[arg(long, help_heading = TRAINING, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub steps: Option<u64>,
    /// TD3: updates of the networks (default: 100000).
    #[arg(long, help_heading = TRAINING, value_name = "N")]
    pub updates: Option<u64>,
    /// TD3: updates per step of the environment (default: 1, as published).
    #[arg(long, help_heading = TRAINING, value_name = "R")]
    pub ratio: Option<f64>,
    /// Rewards with weights, by their names in `sage list`, such as 'contact-ends,0.05*smooth'
    /// (default: published; recipe driver: rewards for care).
    #[arg(long, help_heading = TRAINING, value_name = "[WEIGHT*]NAME,…")]
    pub reward: Option<RewardSpec>,
    /// PPO: scripted policy whose actions are imitated first, by its name in `sage list`, or none (default: none; recipe
    /// driver: expert).
    #[arg(long, help_heading = TRAINING, value_name = "NAME")]
    pub teacher: Option<DriverSpec>,
    /// Arrival and leaving the road do not end an episode; the route goes on along the lanes (default: false; recipe driver:
    /// true).
    #[arg(long, help_heading = TRAINING, value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub goes_on: Option<bool>,
    /// Which vehicles of the scenes are driven in training: the recorded ego, or all that move for 3 s (default: recorded;
    /// recipe driver: all).
    #[arg(long, help_heading = SCENE, value_name = "WHICH")]
    pub egos: Option<EgosName>,
    /// Share of the episodes in procedural scenes, beside those of PATH (default: none; recipe driver: 0.2).
    #[arg(long, help_heading = SCENE, value_name = "SHARE", requires = "paths", value_parser = share)]
    pub procedural_share: Option<f64>,
    /// Share of the episodes in the mirror image of their scene, 0 to 1 (default: 0; recipe driver: 0.5).
    #[arg(long, help_heading = TRAINING, value_name = "SHARE", value_parser = share)]
    pub mirrored: Option<f64>,
    /// Seeds, as FIRST..END (END is not among them).
    #[arg(long, help_heading = RUN, value_name = "A..B", default_value = "0..1", value_parser = seeds)]
    pub seeds: std::ops::Range<u64>,
    /// Number of evaluations, evenly spaced, the last at the end.
    #[arg(long, help_heading = TRAINING, value_name = "N", default_value_t = 20)]
    pub evaluations: u64,
    /// Rare options: a YAML file or JSON, such as '{"max_steps": 251, "td3": {"gamma": 0.98, "random_steps": 5000}}'.
    /// `docs/training.md` lists them.
    #[arg(long, help_heading = TRAINING, value_name = "FILE|JSON", default_value = "{}")]
    pub config: String,
    /// Steps between two checkpoints (default: 5000 for td3, 200000 for ppo).
    #[arg(long, help_heading = TRAINING, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub checkpoint_every: Option<u64>,
    /// Licence text for the card of the policies.
    #[arg(long, help_heading = OUTPUT, value_name = "TEXT")]
    pub license: Option<String>,
    #[command(flatten)]
    pub folder: FolderArgs,
}

/// Defaults of the other options.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum RecipeName {
    /// TD3, the published rules and reward, the recorded egos.
    Published,
    /// PPO that first imitates `expert`, episodes that go on, rewards for care, all vehicles and mirror images.
    Driver,
}

/// Which vehicles are driven in training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum EgosName {
    /// The recorded ego.
    Recorded,
    /// Every vehicle that moves and is recorded for at least 3 s.
    All,
}

impl EgosName {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Recorded => "recorded",
            Self::All => "all",
        }
    }
}

/// Rewards with weights.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RewardSpec(Vec<(f64, Part)>);

impl std::str::FromStr for RewardSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let term = |text: String| {
            let (weight, name) = match text.split_once('*') {
                Some((weight, name)) => (weight.trim().parse().ok(), name),
                None => (Some(1.0), &text[..]),
            };
            let weight = weight.filter(|weight: &f64| weight.is_finite());
            let weight = weight.ok_or_else(|| format!("`{text}` has no weight; write WEIGHT*NAME"))?;
            Ok((weight, name.parse()?))
        };
        split(text).into_iter().map(term).collect::<Result<_, _>>().map(Self)
    }
}

impl RewardSpec {
    /// Builds the rewards; none for the published one alone.
    pub(crate) fn build(&self, registry: &Registry<dyn DrivingReward>) -> anyhow::Result<RewardSum> {
        let Self(terms) = self;
        let built = terms
            .iter()
            .map(|(weight, part)| Ok((part.to_string(), *weight, part.build(registry)?)))
            .collect::<anyhow::Result<Vec<_>>>()?;
        let is_published = terms.len() == 1
            && terms[0].0 == 1.0
            && terms[0].1.name == <Published as Entry<dyn DrivingReward>>::NAME;
        Ok(if is_published { RewardSum::default() } else { RewardSum::new(built) })
    }
}

/// What learns to drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum LearnerName {
    /// TD3 (Fujimoto et al. 2018).
    Td3,
    /// PPO (Schulman et al. 2017).
    Ppo,
}

impl LearnerName {
    pub(crate) fn algorithm(self) -> sage_learn::Algorithm {
        match self {
            Self::Td3 => sage_learn::Algorithm::Td3,
            Self::Ppo => sage_learn::Algorithm::Ppo,
        }
    }
}

fn share(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| (0.0..=1.0).contains(value));
    value.ok_or_else(|| format!("`{text}` is not a share; write a number from 0 to 1"))
}

fn seeds(text: &str) -> Result<std::ops::Range<u64>, String> {
    let problem = || format!("`{text}` is not a range of seeds; write FIRST..END, such as 0..5");
    let (first, end) = text.split_once("..").ok_or_else(problem)?;
    let range = first.parse().map_err(|_| problem())?..end.parse().map_err(|_| problem())?;
    if range.is_empty() || range.end - range.start > 1000 {
        return Err(format!("`{text}` holds no seed, or more than 1000"));
    }
    Ok(range)
}
