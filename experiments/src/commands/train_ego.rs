//! `sage train-ego`: trains driving policies, a run per seed.

mod attacks;
mod chosen;
mod columns;
mod driven_scenes;
mod one_seed;
mod report;

use std::{
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::Instant,
};

use anyhow::{Context as _, Result, bail};
use sage_core::objective::ObjectiveSpec;
use sage_learn::{Algorithm, BUFFER, CHECKPOINT, TrainingOptions};
use sage_run::{
    Outcome,
    output::{self, Run, RunState},
    progress,
    scenes::outcome_without,
};
use sage_sim::policy::EgoPolicy;
use serde::Serialize;
use serde_json::Value;

use self::{
    attacks::Attacks, chosen::Chosen, columns::Columns, driven_scenes::DrivenScenes, report::Trained,
};
use crate::{Registries, cli::TrainEgoArgs};

/// Steps between two checkpoints where none are given: the buffer of TD3 grows with each, and PPO is many times faster.
const CHECKPOINT_EVERY: [(Algorithm, u64); 2] = [(Algorithm::Td3, 5000), (Algorithm::Ppo, 200_000)];
/// Licence of policies that saw procedural scenes only.
const OWN_LICENSE: &str = "MIT OR Apache-2.0";
/// Licence note of policies that saw recorded scenes.
const DATA_LICENSE: &str = "trained on recorded scenes: the terms of their data set apply";

/// What identifies a run.
#[derive(Serialize)]
struct Identity<'a> {
    command: &'static str,
    options: &'a TrainingOptions,
    generator: String,
    search: Option<u64>,
    evaluation_generator: String,
    curriculum: String,
    sampler: String,
    teacher: Option<String>,
    merger: String,
    selection: &'a ObjectiveSpec,
    weights: &'a Value,
    scenes: &'a str,
    egos: &'static str,
    procedural_share: Option<f64>,
    reward: String,
    evaluation_scenes: &'a str,
    checkpoint_every: u64,
    seeds: [u64; 2],
    program: String,
}

/// Everything that all seeds share.
struct Shared<'a> {
    args: &'a TrainEgoArgs,
    registries: &'a Registries,
    chosen: Chosen,
    scenes: DrivenScenes,
    attacks: Attacks,
    teacher: Option<Box<dyn EgoPolicy>>,
    /// Steps between two checkpoints.
    checkpoint_every: u64,
    columns: Columns,
}

pub(crate) fn run(args: &TrainEgoArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let shared = Shared::new(args, registries)?;
    let (run, state) = shared.start()?;
    if state == RunState::Done {
        return Ok(Outcome::Done);
    }
    let trained = all_seeds(&shared, &run)?;
    report::write(&run, &shared.columns, &trained)?;
    let summary = report::summary(&shared.columns, &trained);
    run.finish(&summary, clock.elapsed().as_secs_f64())?;
    output::print(&report::markdown(&shared.columns, shared.scenes.evaluation.len(), &trained))?;
    progress::say(&format!("policies, curves and run.json are in `{}`", args.folder.out.display()));
    Ok(outcome_without(shared.scenes.failed))
}

impl<'a> Shared<'a> {
    /// Checks all options, builds the teacher and the generators and reads the scenes.
    fn new(args: &'a TrainEgoArgs, registries: &'a Registries) -> Result<Self> {
        let parts = &registries.parts;
        let chosen = Chosen::of(args, &parts.driving_rewards)?;
        args.curriculum.build(&parts.curricula)?;
        args.sampler.build(&parts.scene_samplers)?;
        let teacher = chosen.teacher.as_ref().map(|teacher| teacher.part().build(&parts.policies));
        let teacher = teacher.transpose()?;
        if teacher.as_ref().is_some_and(|teacher| teacher.is_recording()) {
            bail!(
                "--teacher: a recording shows no steering and throttle to imitate; name a policy that drives, such as expert"
            );
        }
        let attacks = Attacks::of(args, parts)?;
        let scenes = DrivenScenes::of(args, &chosen, &attacks)?;
        let usual = CHECKPOINT_EVERY.iter().find(|(algorithm, _)| *algorithm == chosen.options.algorithm);
        let checkpoint_every = args.checkpoint_every.or(usual.map(|(_, every)| *every)).unwrap_or(5000);
        let columns = Columns::new(&registries.metrics.episode)?;
        Ok(Self { args, registries, chosen, scenes, attacks, teacher, checkpoint_every, columns })
    }

    fn identity(&self) -> Result<Value> {
        let Self { args, chosen, scenes, attacks, .. } = self;
        let [training, evaluation] = &scenes.described;
        let identity = Identity {
            command: "train-ego",
            options: &chosen.options,
            generator: args.method.to_string(),
            search: args.search,
            evaluation_generator: args.eval_method.to_string(),
            curriculum: args.curriculum.to_string(),
            sampler: args.sampler.to_string(),
            teacher: self.taught_by(),
            merger: args.merging.merger.to_string(),
            selection: &attacks.selection,
            weights: &attacks.weights,
            scenes: training,
            egos: chosen.egos.name(),
            procedural_share: chosen.procedural_share,
            reward: chosen.options.reward.to_string(),
            evaluation_scenes: evaluation,
            checkpoint_every: self.checkpoint_every,
            seeds: [args.seeds.start, args.seeds.end],
            program: output::program(),
        };
        Ok(serde_json::to_value(identity)?)
    }

    fn start(&self) -> Result<(Run, RunState)> {
        let folders: Vec<String> = self.args.seeds.clone().map(one_seed::folder).collect();
        let temporary: Vec<String> = folders.iter().map(|folder| format!("{folder}/{BUFFER}")).collect();
        let temporary: Vec<&str> = temporary.iter().map(String::as_str).collect();
        let results = ["curves.csv", "curves.svg"];
        let folder = &self.args.folder;
        let (run, state) =
            Run::start(&folder.out, self.identity()?, folder.force, &temporary, &results, &results)?;
        if state == RunState::New {
            for folder in folders {
                run.folder().remove(&format!("{folder}/{CHECKPOINT}"))?;
            }
        }
        Ok((run, state))
    }

    /// Name of the policy that teaches.
    fn taught_by(&self) -> Option<String> {
        Some(self.chosen.teacher.as_ref()?.part().to_string())
    }

    /// The licence of the policies.
    fn license(&self) -> String {
        let own = if self.args.paths.is_empty() { OWN_LICENSE } else { DATA_LICENSE };
        self.args.license.clone().unwrap_or_else(|| own.to_owned())
    }
}

/// Trains all seeds, each on a thread of its own. They share no state, so the number of threads changes no bit.
fn all_seeds(shared: &Shared, run: &Run) -> Result<Vec<Trained>> {
    let seeds: Vec<u64> = shared.args.seeds.clone().collect();
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::new());
    let clock = report::Clock::new(shared.chosen.options.steps() * seeds.len() as u64);
    let work = || {
        while let Some(seed) = seeds.get(next.fetch_add(1, Ordering::Relaxed)) {
            let trained = one_seed::train(shared, run, *seed, &clock).with_context(|| format!("seed {seed}"));
            let failed = trained.is_err();
            done.lock().unwrap_or_else(PoisonError::into_inner).push((*seed, trained));
            if failed {
                next.store(seeds.len(), Ordering::Relaxed);
            }
        }
    };
    let threads = rayon::current_num_threads().min(seeds.len());
    std::thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(seed, _)| *seed);
    done.into_iter().map(|(_, trained)| trained).collect()
}
