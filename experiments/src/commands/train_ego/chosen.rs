//! What a training does: the options of the command, and where they say nothing those of its recipe.

use advsage::driver_spec::DriverSpec;
use anyhow::{Context as _, Result, anyhow, bail};
use sage_bench::study::yaml_error;
use sage_core::{files, registry::Registry};
use sage_learn::{Algorithm, PpoOptions, TrainingOptions};
use sage_sim::environment::DrivingReward;
use serde_json::{Map, Value, json};

use super::attacks::NONE;
use crate::cli::{EgosName, RecipeName, RewardSpec, TrainEgoArgs};

/// Options of a run that are options of the command, not of its configuration.
const OWN_OPTIONS: [(&str, &str); 8] = [
    ("algorithm", "--learner"),
    ("updates", "--updates"),
    ("ratio", "--ratio"),
    ("ppo_steps", "--steps"),
    ("mirrored", "--mirrored"),
    ("goes_on", "--goes-on"),
    ("evaluations", "--evaluations"),
    ("seed", "--seeds"),
];
/// Size limit of a configuration, bytes.
const MAX_CONFIG: u64 = 1 << 20;
/// Rewards of the recipe `driver`.
const CAREFUL: &str = r#"contact-ends{"penalty":30},5*off-road,2*speed-limit,smooth"#;

/// Defaults of the options.
struct Recipe {
    algorithm: Algorithm,
    reward: &'static str,
    egos: EgosName,
    mirrored: f64,
    goes_on: bool,
    /// With PATH.
    procedural_share: Option<f64>,
    /// With PPO.
    teacher: Option<&'static str>,
    ppo: Value,
}

impl Recipe {
    fn of(name: RecipeName) -> Self {
        match name {
            RecipeName::Published => Self {
                algorithm: Algorithm::Td3,
                reward: "published",
                egos: EgosName::Recorded,
                mirrored: 0.0,
                goes_on: false,
                procedural_share: None,
                teacher: None,
                ppo: json!({}),
            },
            RecipeName::Driver => Self {
                algorithm: Algorithm::Ppo,
                reward: CAREFUL,
                egos: EgosName::All,
                mirrored: 0.5,
                goes_on: true,
                procedural_share: Some(0.2),
                teacher: Some("expert"),
                ppo: json!({"entropy": 0.003, "kept": 0.6, "gamma": 0.98, "environments": 512, "minibatch": 4096}),
            },
        }
    }
}

/// What a training does.
pub(super) struct Chosen {
    /// Options of the runs; the seed is set later.
    pub(super) options: TrainingOptions,
    /// Vehicles that are driven.
    pub(super) egos: EgosName,
    /// Share of the episodes in procedural scenes beside others.
    pub(super) procedural_share: Option<f64>,
    /// Policy whose actions are imitated first.
    pub(super) teacher: Option<DriverSpec>,
}

impl Chosen {
    /// Reads the configuration, and checks all options.
    ///
    /// *Errors*: an option that is out of range, or not one of the learner.
    pub(super) fn of(args: &TrainEgoArgs, rewards: &Registry<dyn DrivingReward>) -> Result<Self> {
        let recipe = Recipe::of(args.recipe);
        let algorithm = args.learner.map_or(recipe.algorithm, |learner| learner.algorithm());
        refuse_options_of_other(args, algorithm)?;
        let reward = match &args.reward {
            Some(reward) => reward.clone(),
            None => {
                recipe.reward.parse::<RewardSpec>().map_err(|problem| anyhow!("the recipe: {problem}"))?
            }
        };
        let defaults = TrainingOptions::default();
        let options = TrainingOptions {
            algorithm,
            updates: args.updates.unwrap_or(defaults.updates),
            ratio: args.ratio.unwrap_or(defaults.ratio),
            ppo_steps: args.steps.unwrap_or(defaults.ppo_steps),
            mirrored: args.mirrored.unwrap_or(recipe.mirrored),
            goes_on: args.goes_on.unwrap_or(recipe.goes_on),
            evaluations: args.evaluations,
            reward: reward.build(rewards)?,
            seed: 0,
            ..configured(args, algorithm, &recipe.ppo)?
        };
        options.check()?;
        let teacher = teacher(args, recipe.teacher.filter(|_| algorithm == Algorithm::Ppo))?;
        if teacher.is_none() && options.ppo.taught != PpoOptions::default().taught {
            bail!("`taught` is the share of the training with a teacher, and there is none; give --teacher");
        }
        if teacher.is_some() && options.ppo.taught == 0.0 {
            bail!(
                "`taught` is 0, so that nothing is learnt of --teacher; give a share above 0, or --teacher none"
            );
        }
        let share = args.procedural_share.or(recipe.procedural_share);
        Ok(Self {
            options,
            egos: args.egos.unwrap_or(recipe.egos),
            procedural_share: share.filter(|_| !args.paths.is_empty()),
            teacher,
        })
    }
}

/// The policy whose actions are imitated first, if there is one.
fn teacher(args: &TrainEgoArgs, of_recipe: Option<&str>) -> Result<Option<DriverSpec>> {
    let teacher = match (&args.teacher, of_recipe) {
        (Some(teacher), _) => teacher.clone(),
        (None, Some(name)) => name.parse().map_err(|problem| anyhow!("the recipe: {problem}"))?,
        (None, None) => return Ok(None),
    };
    if teacher.part().name == NONE {
        return Ok(None);
    }
    // Their files would decide what is learnt, and under which licence.
    if teacher.names_program() || !teacher.files().is_empty() || teacher.is_of_file() {
        bail!(
            "--teacher: `{}` is not a scripted policy of `sage list`; name one that is, such as expert",
            teacher.part().name
        );
    }
    Ok(Some(teacher))
}

/// The rare options.
fn configured(args: &TrainEgoArgs, algorithm: Algorithm, of_recipe: &Value) -> Result<TrainingOptions> {
    let inline = args.config.trim_start().starts_with('{');
    let (text, name) = if inline {
        (args.config.clone(), "--config")
    } else {
        let read = files::read_text(args.config.as_ref(), MAX_CONFIG);
        (read.with_context(|| format!("--config: cannot read `{}`", args.config))?, &*args.config)
    };
    let mut given: Map<String, Value> =
        serde_saphyr::from_str(&text).map_err(yaml_error).with_context(|| format!("`{name}`"))?;
    if let Some((key, option)) = OWN_OPTIONS.iter().find(|(key, _)| given.contains_key(*key)) {
        bail!("`{name}`: `{key}` is not part of a configuration; give {option}");
    }
    let of_other: &[&str] = match algorithm {
        Algorithm::Td3 => &["ppo"],
        Algorithm::Ppo => &["td3", "environments"],
    };
    if let Some(key) = of_other.iter().find(|key| given.contains_key(**key)) {
        bail!("`{name}`: `{key}` is an option of the other learner; see --learner");
    }
    if let (Algorithm::Ppo, Value::Object(of_recipe)) = (algorithm, of_recipe) {
        let ppo = given.entry("ppo").or_insert_with(|| json!({}));
        // What is no object is refused below.
        if let Value::Object(ppo) = ppo {
            for (key, value) in of_recipe {
                ppo.entry(key.clone()).or_insert_with(|| value.clone());
            }
        }
    }
    serde_json::from_value(Value::Object(given)).with_context(|| format!("`{name}`"))
}

fn refuse_options_of_other(args: &TrainEgoArgs, algorithm: Algorithm) -> Result<()> {
    let (name, length, of_other) = match algorithm {
        Algorithm::Td3 => ("td3", "--updates and --ratio", vec![("--steps", args.steps.is_some())]),
        Algorithm::Ppo => {
            ("ppo", "--steps", vec![("--updates", args.updates.is_some()), ("--ratio", args.ratio.is_some())])
        }
    };
    if let Some((option, _)) = of_other.into_iter().find(|(_, is_given)| *is_given) {
        bail!("{option} is no option of `--learner {name}`; its length is given by {length}");
    }
    if algorithm == Algorithm::Td3 && args.teacher.is_some() {
        bail!("--teacher is no option of `--learner td3`; only `--learner ppo` learns from a teacher");
    }
    Ok(())
}
