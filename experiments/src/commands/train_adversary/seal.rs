//! `sage train-adversary seal`: roll-outs, then the score, the skills, and the distributions of skills.

mod card;
mod collected;
mod curves;
mod measured;

use std::{
    sync::atomic::{AtomicUsize, Ordering},
    time::Instant,
};

use advsage::{
    Registries,
    generators::{BuiltGenerator, Generators, weight_hashes},
    part::Part,
    selection::Selection,
    weights::NamedNetwork,
};
use anyhow::{Context as _, Result, ensure};
use rayon::prelude::*;
use sage_backbones::{
    Parameters,
    parameters::{Header, Scope},
    training::CheckpointFile,
};
use sage_baselines::seal::networks::{
    OBSERVATION, SEAL_FILE, SealOptions, SealWeights, SkillEncoder, SkillWindows, WINDOW,
    training::{
        CriticalityData, CriticalityOptions, PriorOptions, PriorRow, PriorWindows, SkillOptions, Trained,
        train_criticality, train_prior, train_skills,
    },
};
use sage_core::scene::SceneData;
use sage_run::{
    Outcome, networks,
    outcome::caught,
    output::{self, Producer, Run, RunState},
    progress::{self, count},
    scenes::{self, Scenes},
};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use self::{collected::Collected, curves::Curves};
use super::training_scenes::TrainingScenes;
use crate::cli::TrainSealArgs;

/// The same with the skills of ordinary driving.
const BENIGN_FILE: &str = "seal-benign.safetensors";
/// Generator whose candidates the score learns from and selects among.
const CANDIDATES: &str = "cat";
/// Epochs of a distribution of skills without an improvement after which its training ends.
const PRIOR_PATIENCE: u32 = 15;

/// Options of the parts that are options of the whole, and how they are given.
const OWN_OPTIONS: [(&str, &str, &str); 4] = [
    ("criticality", "seed", "--seed"),
    ("skills", "seed", "--seed"),
    ("prior", "seed", "--seed"),
    ("prior", "hidden", "`hidden`"),
];

/// Options of the training; seed and width are set from the outside.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct TrainingOptions {
    /// Width of the distributions' networks.
    hidden: usize,
    criticality: CriticalityOptions,
    skills: SkillOptions,
    prior: PriorOptions,
}

impl Default for TrainingOptions {
    fn default() -> Self {
        let hidden = SealOptions::default().hidden;
        // Ten times the published rate for a seventh of its epochs: the actions are explained as well (docs/results/baselines.md).
        let skills =
            SkillOptions { epochs: 14, rate: 1e-3, plateau: 3, cooldown: 2, ..SkillOptions::default() };
        let prior = PriorOptions { patience: Some(PRIOR_PATIENCE), ..PriorOptions::default() };
        Self { hidden, criticality: CriticalityOptions::default(), skills, prior }
    }
}

impl TrainingOptions {
    fn of(args: &TrainSealArgs) -> Result<Self> {
        let given = &args.options;
        let options: Self =
            serde_json::from_str(given).with_context(|| format!("--options: `{given}` is not usable"))?;
        SealOptions { hidden: options.hidden }.check()?;
        let raw: Value = serde_json::from_str(given)?;
        for (part, key, option) in OWN_OPTIONS {
            ensure!(raw[part].get(key).is_none(), "--options: `{part}.{key}` cannot be given; use {option}");
        }
        let (hidden, seed) = (options.hidden, args.seed);
        Ok(Self {
            criticality: CriticalityOptions { seed, ..options.criticality },
            skills: SkillOptions { seed, ..options.skills },
            prior: PriorOptions { seed, hidden, ..options.prior },
            hidden,
        })
    }
}

/// What identifies a training.
#[derive(Serialize)]
struct Identity<'a> {
    command: &'static str,
    options: &'a TrainingOptions,
    data: &'a str,
    dev: String,
    /// Hashes of the networks.
    prior: Map<String, Value>,
    seed: u64,
    license: &'a str,
    #[serde(flatten)]
    by: Producer,
}

pub(crate) fn run(args: &TrainSealArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let options = TrainingOptions::of(args)?;
    let prior = NamedNetwork::load(&registries.backbones, &args.weights)?;
    networks::announce(&prior);
    let license = args.license.clone().unwrap_or_else(|| prior.header.license.clone());
    let selection = Selection::of(registries, "natural", None)?;
    let merger = Part::named("linear");
    let experts = sage_merging::ExpertSet::of_prior(prior.network.into());
    let generators = Generators::new(registries, &merger, &selection, args.seed)?.with_experts(&experts);
    let candidates = generators.build(&Part::named(CANDIDATES), &[])?;
    let list = TrainingScenes::read(&args.scenes, args.seed)?;
    let (train, dev) = (&list.train, &list.dev);
    let data = scenes::describe(train);
    let identity = serde_json::to_value(Identity {
        command: "train-adversary seal",
        options: &options,
        data: &data,
        dev: scenes::describe(dev),
        prior: weight_hashes(&experts)?,
        seed: args.seed,
        license: &license,
        by: Producer::own(),
    })?;
    let state_files = ["criticality", "skills", "adversarial", "benign"].map(|part| format!("{part}.state"));
    let results = [SEAL_FILE, BENIGN_FILE, curves::TABLE, card::FILE];
    let temporary: Vec<&str> = state_files.iter().map(String::as_str).collect();
    let (run, state) =
        Run::start(&args.folder.out, identity.clone(), args.folder.force, &temporary, &[], &results)?;
    if state == RunState::Done {
        return Ok(Outcome::Done);
    }
    let collected = collect(&list.training, train, &candidates, args.seed);
    let counts = collected.counts;
    progress::say(&format!(
        "{} without and {} against candidates ({} and {} ended in a contact): {}, {} before contacts ({:.0} s)",
        count(counts.unattacked, "roll-out"),
        counts.attacked,
        counts.unattacked_contacts,
        counts.attacked_contacts,
        count(counts.windows, "window"),
        counts.windows_before_contact,
        clock.elapsed().as_secs_f64()
    ));
    let states = States { run: &run, identity: &identity };
    let trained = train_all(collected, &options, &states)?;
    let header = Header {
        backbone: "seal".to_owned(),
        options: serde_json::to_value(SealOptions { hidden: options.hidden })?,
        seed: args.seed,
        data,
        command: output::command(),
        license,
        notes: [("training".to_owned(), serde_json::to_string(&options)?)].into(),
    };
    let file = |flow: &Parameters| SealWeights::file_parameters(&trained.criticality, &trained.skills, flow);
    let (adversarial, benign) = (file(&trained.adversarial), file(&trained.benign));
    let weights = [(SEAL_FILE, &adversarial), (BENIGN_FILE, &benign)];
    for (name, parameters) in weights {
        parameters.save(&header, &run.folder().path().join(name))?;
    }
    trained.curves.write(run.folder())?;
    let networks = SealOptions { hidden: options.hidden };
    let [adversarial, benign] = [(SEAL_FILE, adversarial), (BENIGN_FILE, benign)]
        .map(|(name, parameters)| SealWeights::new(&parameters, &networks, name));
    let measured = measured::measure(
        &list.validation,
        dev,
        &candidates,
        [adversarial?, benign?],
        &trained.encoder()?,
        args.seed,
    )?;
    let summary = json!({"counts": counts, "trained": trained.summary, "measured": measured});
    run.folder().write(card::FILE, card::page(&header, &summary).as_bytes())?;
    let seconds = clock.elapsed().as_secs_f64();
    run.finish(&summary, seconds)?;
    progress::say(&format!("`{SEAL_FILE}` is in `{}` ({seconds:.0} s)", args.folder.out.display()));
    Ok(list.outcome())
}

/// Collects in all scenes, in parallel. The order of the scenes, and so the result, does not depend on threads.
fn collect(scenes: &Scenes, train: &[SceneData], candidates: &BuiltGenerator, seed: u64) -> Collected {
    let total = train.len();
    let done = AtomicUsize::new(0);
    let one = |data: &SceneData| {
        let collected =
            collected::collect(data, candidates, seed).with_context(|| format!("`{}`", data.name));
        let done = 1 + done.fetch_add(1, Ordering::Relaxed);
        if done.is_multiple_of(20) {
            progress::say(&format!("driven in {done} of {}", count(total, "scene")));
        }
        collected
    };
    let all: Vec<Result<Collected>> =
        train.par_iter().with_max_len(1).map(|data| caught(|| one(data))).collect();
    let mut sum = Collected::default();
    for (collected, data) in all.into_iter().zip(train) {
        match collected {
            Ok(collected) => sum.add(collected),
            Err(error) => scenes.fail(&data.name, error.as_ref()),
        }
    }
    sum
}

/// Where the states of the trainings are kept.
struct States<'r> {
    run: &'r Run,
    identity: &'r Value,
}

impl States<'_> {
    /// Trains one part, and writes its state after each epoch.
    fn train<Row>(
        &self,
        part: &str,
        train: impl FnOnce(&CheckpointFile) -> Result<Trained<Row>, sage_backbones::Error>,
    ) -> Result<Trained<Row>> {
        let file = self.run.folder().path().join(format!("{part}.state"));
        let identity = json!({"run": self.identity, "part": part});
        let checkpoint = CheckpointFile { file: &file, identity, header: Header::default() };
        train(&checkpoint).with_context(|| format!("training of `{part}`"))
    }
}

/// What was trained.
struct TrainedParts {
    criticality: Parameters,
    skills: Parameters,
    adversarial: Parameters,
    benign: Parameters,
    curves: Curves,
    summary: Value,
}

impl TrainedParts {
    fn encoder(&self) -> Result<SkillEncoder> {
        Ok(SkillEncoder::new(&Scope::of(&self.skills).at("encoder"))?)
    }
}

/// Trains all parts; two at a time, each on one thread.
fn train_all(collected: Collected, options: &TrainingOptions, states: &States) -> Result<TrainedParts> {
    let Collected { examples, ordinary, before_contact, .. } = collected;
    let data = CriticalityData { examples };
    let say = |part: &str, epoch: u32, training: f64, validation: f64, more: String| {
        progress::say(&format!("{part} epoch {epoch}: loss {training:.4}, validation {validation:.4}{more}"));
        false
    };
    let score = || {
        states.train("criticality", |checkpoint| {
            train_criticality(&data, &options.criticality, Some(checkpoint), &mut |row| {
                say("criticality", row.epoch, row.training, row.validation, String::new())
            })
        })
    };
    let skills = || {
        states.train("skills", |checkpoint| {
            train_skills(&ordinary, &options.skills, Some(checkpoint), &mut |row| {
                let [a, b] = [row.steering, row.throttle].map(|x| x.unwrap_or(f64::NAN));
                let more = format!(", R² of steering {a:.3}, of throttle {b:.3} ({:.0} s)", row.seconds);
                say("skills", row.epoch, row.training, row.validation, more)
            })
        })
    };
    let (score, skills) = rayon::join(score, skills);
    let (score, skills) = (score?, skills?);
    let encoder = SkillEncoder::new(&Scope::of(&skills.parameters).at("encoder"))?;
    let (ordinary, before) = (encoded(&encoder, &ordinary)?, encoded(&encoder, &before_contact)?);
    let flow = |name: &'static str, windows: &PriorWindows| {
        states.train(name, |checkpoint| {
            train_prior(windows, &options.prior, Some(checkpoint), &mut |row: &PriorRow| {
                say(name, row.epoch, row.training, row.validation, String::new())
            })
        })
    };
    let (adversarial, benign) = rayon::join(|| flow("adversarial", &before), || flow("benign", &ordinary));
    let (adversarial, benign) = (adversarial?, benign?);
    let mut curves = Curves::new();
    score.rows.iter().for_each(|r| curves.add("criticality", r.epoch, r.training, r.validation, r.rate));
    skills.rows.iter().for_each(|r| curves.add("skills", r.epoch, r.training, r.validation, r.rate));
    adversarial
        .rows
        .iter()
        .for_each(|r| curves.add("adversarial", r.epoch, r.training, r.validation, r.rate));
    benign.rows.iter().for_each(|r| curves.add("benign", r.epoch, r.training, r.validation, r.rate));
    let best = |epoch: u32| epoch as usize - 1;
    let summary = json!({
        "criticality": {"best": score.rows[best(score.best_epoch)], "epochs": score.rows.len(), "parameters": score.parameters.numbers()},
        "skills": {"best": skills.rows[best(skills.best_epoch)], "epochs": skills.rows.len()},
        "adversarial": {"best": adversarial.rows[best(adversarial.best_epoch)], "epochs": adversarial.rows.len(), "parameters": adversarial.parameters.numbers()},
        "benign": {"best": benign.rows[best(benign.best_epoch)], "epochs": benign.rows.len()},
    });
    Ok(TrainedParts {
        criticality: score.parameters,
        skills: skills.parameters,
        adversarial: adversarial.parameters,
        benign: benign.parameters,
        curves,
        summary,
    })
}

/// Windows with their encoded skills.
fn encoded(encoder: &SkillEncoder, windows: &SkillWindows) -> Result<PriorWindows> {
    let skills = encoder.encode(windows)?;
    let first = windows.observations.chunks(WINDOW * OBSERVATION).flat_map(|window| &window[..OBSERVATION]);
    Ok(PriorWindows {
        skills_mu: skills.mu,
        skills_logvar: skills.logvar,
        observations: first.copied().collect(),
        groups: windows.groups.clone(),
    })
}
