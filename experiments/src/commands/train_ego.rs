//! `sage train-ego`: trains driving policies, a run per seed.

mod chosen;
mod columns;
mod one_seed;
mod report;
mod trained;

use std::{
    collections::{BTreeSet, HashMap},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::Instant,
};

use advsage::{
    driver_search::DriverSearch,
    generators::{BuiltGenerator, Generators, weight_hashes},
    part::Part,
    search::rule,
    selection::Selection,
};
use anyhow::{Context as _, Result, bail};
use sage_core::scene::{SceneData, SceneIndex};
use sage_run::{
    Outcome, networks,
    output::{self, Run, RunState},
    progress,
    scenes::{self, Scenes, with_other_egos},
};
use sage_sim::{
    SimScene,
    policy::EgoPolicy,
    rl::{Algorithm, Attacker, BUFFER, CHECKPOINT, TrainingOptions},
};
use serde_json::{Value, json};

use self::{chosen::Chosen, columns::Columns, trained::Trained};
use crate::{
    Registries,
    cli::{EgosName, SplitArgs, TrainEgoArgs},
};

/// Name for no generator.
const NONE: &str = "none";
/// Steps between two checkpoints where none are given: the buffer of TD3 grows with each, and PPO is many times faster.
const CHECKPOINT_EVERY: [(Algorithm, u64); 2] = [(Algorithm::Td3, 5000), (Algorithm::Ppo, 200_000)];
/// Procedural scenes of the evaluation have this seed, those of the training have 0.
const EVALUATION_SEED: u64 = 1;
/// Licence of policies that saw procedural scenes only.
const OWN_LICENSE: &str = "MIT OR Apache-2.0";
/// Licence note of policies that saw recorded scenes.
const DATA_LICENSE: &str = "trained on recorded scenes: the terms of their data set apply";

/// Everything that all seeds share.
struct Shared<'a> {
    args: &'a TrainEgoArgs,
    registries: &'a Registries,
    training: Vec<Arc<SimScene>>,
    evaluation: Vec<Arc<SimScene>>,
    names: Vec<String>,
    attacker: Option<Box<dyn Attacker>>,
    examiner: Option<BuiltGenerator>,
    teacher: Option<Box<dyn EgoPolicy>>,
    options: TrainingOptions,
    /// Where the procedural scenes begin beside others, and their share.
    second_kind: Option<(usize, f64)>,
    /// Steps between two checkpoints.
    checkpoint_every: u64,
    columns: Columns,
    /// Name and hashes of the attacker's weights.
    weights: Value,
    identity: Value,
    license: String,
}

pub(crate) fn run(args: &TrainEgoArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let Chosen { options, egos, procedural_share, teacher } =
        Chosen::of(args, &registries.parts.driving_rewards)?;
    args.curriculum.build(&registries.parts.curricula)?;
    args.sampler.build(&registries.parts.scene_samplers)?;
    let taught_by = teacher.as_ref().map(|teacher| teacher.part().to_string());
    let teacher = teacher.map(|teacher| teacher.part().build(&registries.parts.policies)).transpose()?;
    if teacher.as_ref().is_some_and(|teacher| teacher.is_recording()) {
        bail!(
            "--teacher: a recording shows no steering and throttle to imitate; name a policy that drives, such as expert"
        );
    }
    let selection = Selection::of(&registries.parts, &args.selection, None)?;
    let mut generators = Generators::new(&registries.parts, &args.merging.merger, &selection, 0)?;
    let parts = [&args.method, &args.eval_method].map(|part| Some(part).filter(|p| p.name != NONE));
    let needs_experts = |part: Option<&Part>| -> Result<bool> {
        Ok(part.map(|part| generators.facts(part)).transpose()?.is_some_and(|facts| facts.needs_experts))
    };
    let [of_attacker, of_examiner] = [needs_experts(parts[0])?, needs_experts(parts[1])?];
    let mut used = Value::Null;
    if of_attacker || of_examiner {
        let experts = networks::load_experts(&registries.parts.backbones, &args.weights)?;
        used = json!({"name": args.weights, "hashes": weight_hashes(&experts)?});
        generators = generators.with_experts(&experts);
    }
    let build = |part: Option<&Part>| -> Result<_> {
        let built = part.map(|part| generators.build(part, &[])).transpose()?;
        built.as_ref().map_or(Ok(()), BuiltGenerator::check_lambda)?;
        Ok(built)
    };
    let (attacker, examiner) = (build(parts[0])?, build(parts[1])?);
    for (file, hash) in [&attacker, &examiner].into_iter().flatten().flat_map(|built| &built.files) {
        used["files"][file] = hash.clone();
    }
    let needs_adversary = attacker.is_some() || examiner.is_some();
    let attacker = match (attacker, args.search) {
        (Some(built), Some(drives)) => Some(searching(built, drives as usize, registries)?),
        (Some(built), None) => Some(Box::new(built) as Box<dyn Attacker>),
        (None, Some(_)) => bail!("--search needs plans: name a generator by --method"),
        (None, None) => None,
    };
    let (mut training, mut failed) = scenes(&args.paths, &args.split, args.procedural, 0, needs_adversary)?;
    if egos == EgosName::All {
        training = with_other_egos(training, attacker.is_some());
    }
    let mut second_kind = None;
    if let Some(share) = procedural_share {
        second_kind = Some((training.len(), share));
        let every = SplitArgs { reading: args.split.reading.clone(), ..SplitArgs::default() };
        let (procedural, without) = scenes(&[], &every, args.procedural, 0, needs_adversary)?;
        training.extend(procedural);
        failed += without;
    }
    if egos == EgosName::All || second_kind.is_some() {
        progress::say(&format!("training in {} scenes, each with one ego", training.len()));
    }
    let every = SplitArgs { reading: args.split.reading.clone(), ..SplitArgs::default() };
    let (evaluation, failed_evaluation) =
        scenes(&args.eval, &every, args.procedural.div_ceil(3), EVALUATION_SEED, needs_adversary)?;
    refuse_overlap(args, &training, &evaluation)?;
    let hashes = [&training, &evaluation].map(|data| scenes::describe(data));
    let usual = CHECKPOINT_EVERY.iter().find(|(algorithm, _)| *algorithm == options.algorithm);
    let checkpoint_every = args.checkpoint_every.or(usual.map(|(_, every)| *every)).unwrap_or(5000);
    let identity = json!({
        "command": "train-ego", "options": options, "generator": args.method.to_string(), "search": args.search,
        "evaluation_generator": args.eval_method.to_string(), "curriculum": args.curriculum.to_string(),
        "sampler": args.sampler.to_string(), "teacher": taught_by, "merger": args.merging.merger.to_string(), "selection": selection.objective.spec(),
        "weights": used,
        "scenes": hashes[0], "egos": egos.name(), "procedural_share": procedural_share,
        "reward": options.reward.to_string(), "evaluation_scenes": hashes[1], "checkpoint_every": checkpoint_every,
        "seeds": [args.seeds.start, args.seeds.end], "program": output::program(),
    });
    let own = if args.paths.is_empty() { OWN_LICENSE } else { DATA_LICENSE };
    let shared = Shared {
        args,
        registries,
        columns: Columns::new(&registries.metrics.episode)?,
        names: evaluation.iter().map(|data| data.name.clone()).collect(),
        training: simulated(&training)?,
        evaluation: simulated(&evaluation)?,
        attacker,
        examiner,
        teacher,
        options,
        second_kind,
        checkpoint_every,
        weights: if of_attacker { used } else { Value::Null },
        identity,
        license: args.license.clone().unwrap_or_else(|| own.to_owned()),
    };
    drop((training, evaluation));
    let temporary: Vec<String> =
        args.seeds.clone().map(|seed| format!("{}/{BUFFER}", one_seed::folder(seed))).collect();
    let temporary: Vec<&str> = temporary.iter().map(String::as_str).collect();
    let results = ["curves.csv", "curves.svg"];
    let (run, state) = Run::start(
        &args.folder.out,
        shared.identity.clone(),
        args.folder.force,
        &temporary,
        &results,
        &results,
    )?;
    if state == RunState::Done {
        return Ok(Outcome::Done);
    }
    if state == RunState::New {
        for seed in args.seeds.clone() {
            run.folder().remove(&format!("{}/{CHECKPOINT}", one_seed::folder(seed)))?;
        }
    }
    let trained = all_seeds(&shared, &run)?;
    report::write(&run, &shared.columns, &trained)?;
    let summary = report::summary(&shared.columns, &trained);
    run.finish(&summary, clock.elapsed().as_secs_f64())?;
    output::print(&report::markdown(&shared.columns, shared.evaluation.len(), &trained))?;
    progress::say(&format!("policies, curves and run.json are in `{}`", args.folder.out.display()));
    Ok(scenes::outcome_without(failed + failed_evaluation))
}

/// A generator whose plans are searched with the policy in training.
fn searching(generator: BuiltGenerator, drives: usize, registries: &Registries) -> Result<Box<dyn Attacker>> {
    if generator.facts.knows.driver || generator.facts.is_upper_bound {
        bail!(
            "--search drives against plans that --method proposes, and `{}` asks the driver itself or is an upper bound; leave --search out, or name a generator such as sage",
            generator.label()
        );
    }
    Ok(Box::new(DriverSearch::new(generator, rule(&registries.parts, None)?, drives)))
}

/// Scenes that can be driven, and how many failed.
fn scenes(
    paths: &[std::path::PathBuf],
    split: &SplitArgs,
    procedural: u64,
    seed: u64,
    needs_adversary: bool,
) -> Result<(Vec<SceneData>, usize)> {
    let all = Scenes::of(paths, &split.filter(), procedural, seed)?;
    let all = if needs_adversary { all.attackable()? } else { all.known()? };
    let mut loaded = all.read_all()?;
    loaded.retain(|data| match SimScene::new(data.scene.clone(), data.index.clone()) {
        Ok(_) => true,
        Err(error) => {
            all.fail(&data.name, &error.into());
            false
        }
    });
    if loaded.is_empty() {
        bail!("no scenes are left; give more paths or other filters");
    }
    Ok((loaded, all.failed()))
}

fn refuse_overlap(args: &TrainEgoArgs, training: &[SceneData], evaluation: &[SceneData]) -> Result<()> {
    let seen: BTreeSet<[u8; 16]> = training.iter().map(|data| data.scene.content_hash()).collect();
    let both: Vec<&str> = evaluation
        .iter()
        .filter(|data| seen.contains(&data.scene.content_hash()))
        .map(|data| &*data.name)
        .collect();
    if let Some(first) = both.first()
        && !args.allow_overlap
    {
        bail!(
            "{} of {} scenes of the evaluation are among those of the training, such as `{first}`; give others with --eval, or --allow-overlap",
            both.len(),
            evaluation.len()
        );
    }
    Ok(())
}

fn simulated(data: &[SceneData]) -> Result<Vec<Arc<SimScene>>> {
    let mut on_map: HashMap<*const SceneIndex, Arc<SimScene>> = HashMap::new();
    data.iter()
        .map(|data| {
            let known = on_map.get(&Arc::as_ptr(&data.index));
            let made = match known {
                Some(known) => known.on_same_map(data.scene.clone()),
                None => SimScene::new(data.scene.clone(), data.index.clone()),
            };
            let scene = made.with_context(|| format!("`{}`", data.name))?;
            on_map.entry(Arc::as_ptr(&data.index)).or_insert_with(|| scene.clone());
            Ok(scene)
        })
        .collect()
}

/// Trains all seeds, each on a thread of its own. They share no state, so the number of threads changes no bit.
fn all_seeds(shared: &Shared, run: &Run) -> Result<Vec<Trained>> {
    let seeds: Vec<u64> = shared.args.seeds.clone().collect();
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::new());
    let clock = report::Clock::new(shared.options.steps() * seeds.len() as u64);
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
