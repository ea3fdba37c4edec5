//! `sage bench closed-loop`: trained policies in unchanged and attacked scenes, beside the paper's tables.

mod report;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context as _, Result, anyhow, bail, ensure};
use rayon::prelude::*;
use sage_core::{files, seed::Rng};
use sage_sim::{
    SimScene,
    environment::EnvironmentOptions,
    observation::LENGTH,
    policy::EgoPolicy,
    rl::{
        ActorPolicy, Attacker, EpisodeRow, Network, Shape, Td3Options, attack_episode, drive_scene,
        evaluation_rules, read_policy,
    },
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use self::report::Tested;
use crate::{
    Outcome, Registries,
    adversary::Adversary,
    cli::ClosedLoopArgs,
    ego::Ego,
    networks,
    output::{self, Folder},
    part::{Parts, PolicyParts},
    progress::{self, Progress},
    scenes::{self, Scenes},
    selection::Selection,
};

/// Folder of the results per policy.
const CELLS: &str = "cells";
/// Largest file of results that is read, bytes.
const MAX_CELL: u64 = 64 << 20;
/// Method of policies with initial weights.
const UNTRAINED: &str = "untrained";

/// A policy to be evaluated.
struct Candidate {
    /// Run or policy that it belongs to: a row of the tables.
    method: String,
    seed: u64,
    /// Name of its file of results.
    cell: String,
    policy: Box<dyn EgoPolicy>,
    /// Changes with its weights.
    identity: Value,
}

/// Results of a policy: for each kind of scenes, an episode per scene.
#[derive(Serialize, Deserialize)]
pub(super) struct Cell {
    identity: Value,
    /// Unchanged scenes first, then those of each generator.
    kinds: Vec<Vec<EpisodeRow>>,
}

/// Results of a method: for each seed, those of its policies.
pub(super) struct Method {
    name: String,
    seeds: Vec<Vec<Cell>>,
}

pub(crate) fn run(args: &ClosedLoopArgs, registries: &Registries) -> Result<Outcome> {
    let tested = Tested::of(args.tested.as_deref(), args.runs.iter().map(|(name, _)| &name[..]))?;
    let candidates = candidates(args, registries)?;
    let selection = Selection::of(registries, &args.selection, None)?;
    let weights = match &args.weights {
        Some(name) => name.clone(),
        None => networks::default_for(args.paths.is_empty())?.to_owned(),
    };
    let Parts(parts) = &args.methods;
    let attackers = parts
        .iter()
        .map(|part| Adversary::new(part, &weights, &selection, registries))
        .collect::<Result<Vec<_>>>()?;
    let out = Folder::resumable(&args.folder.out, args.folder.force, CELLS)?;
    let cells = out.inner(CELLS.as_ref())?;
    let all = Scenes::of(&args.paths, &args.split, args.procedural, 1)?.attackable()?;
    let mut data = all.read_all()?;
    let mut scenes: Vec<Arc<SimScene>> = Vec::with_capacity(data.len());
    data.retain(|data| match SimScene::new(data.scene.clone(), data.index.clone()) {
        Ok(scene) => {
            scenes.push(scene);
            true
        }
        Err(error) => {
            all.fail(&data.name, &error.into());
            false
        }
    });
    ensure!(!scenes.is_empty(), "no scene can be driven");
    let names: Vec<String> = data.iter().map(|data| data.name.clone()).collect();
    let shared = json!({
        "scenes": scenes::describe(&data), "methods": parts.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "weights": attackers.iter().map(|a| &a.weights).collect::<Vec<_>>(), "selection": selection.objective.spec(),
        "program": output::program(),
    });
    drop(data);
    let mut progress = Progress::new("evaluated", candidates.len());
    let mut methods: Vec<Method> = Vec::new();
    for window in candidates.chunks(2 * rayon::current_num_threads()) {
        let work = |candidate: &Candidate| -> Result<(Cell, bool)> {
            let identity = json!([shared, candidate.identity]);
            let file = cells.join(format!("{}.json", candidate.cell));
            match read_cell(&file, &identity).filter(|_| !args.folder.force) {
                Some(cell) => Ok((cell, true)),
                None => Ok((evaluated(candidate, &scenes, &attackers, identity), false)),
            }
        };
        let done: Vec<Result<(Cell, bool)>> = window.par_iter().with_max_len(1).map(work).collect();
        for (candidate, done) in window.iter().zip(done) {
            let (cell, was_found) = done?;
            if was_found {
                progress.step_found();
            } else {
                let text = serde_json::to_string(&cell)?;
                out.write(&format!("{CELLS}/{}.json", candidate.cell), text.as_bytes())?;
                progress.step();
            }
            file_under(&mut methods, candidate, cell);
        }
    }
    progress.finish(&format!(
        "{} in {}",
        progress::count(candidates.len(), "driver"),
        progress::count(scenes.len(), "scene")
    ));
    let kinds: Vec<String> =
        std::iter::once("unchanged".to_owned()).chain(parts.iter().map(ToString::to_string)).collect();
    let markdown = report::markdown(&methods, &kinds, scenes.len(), &tested);
    out.write("closed-loop.md", markdown.as_bytes())?;
    out.write("episodes.csv", report::episodes_csv(&methods, &kinds, &names).as_bytes())?;
    let failures: Vec<&String> = methods.iter().flat_map(Method::failures).collect();
    let record = json!({
        "command": output::command(), "run": shared, "scenes": names, "failed_episodes": failures.len(),
        "policies": candidates.iter().map(|c| json!([c.method, c.seed, c.identity])).collect::<Vec<_>>(),
    });
    out.write(output::RECORD, format!("{record:#}\n").as_bytes())?;
    output::print(&markdown)?;
    progress::say(&format!(
        "closed-loop.md, episodes.csv and run.json are in `{}`",
        args.folder.out.display()
    ));
    if let Some(first) = failures.first() {
        progress::say(&format!(
            "{} failed; one of them: {first}",
            progress::count(failures.len(), "episode")
        ));
        return Ok(Outcome::Partial);
    }
    Ok(all.outcome())
}

/// Puts results under their method and seed.
fn file_under(methods: &mut Vec<Method>, candidate: &Candidate, cell: Cell) {
    let known = methods.iter().position(|method| method.name == candidate.method);
    let k = known.unwrap_or_else(|| {
        methods.push(Method { name: candidate.method.clone(), seeds: Vec::new() });
        methods.len() - 1
    });
    // Candidates come seed by seed, so a new seed is the next one.
    let seeds = &mut methods[k].seeds;
    match seeds
        .last_mut()
        .filter(|cells| cells.first().is_some_and(|c| c.identity[1]["seed"] == candidate.seed))
    {
        Some(cells) => cells.push(cell),
        None => seeds.push(vec![cell]),
    }
}

impl Method {
    fn failures(&self) -> impl Iterator<Item = &String> {
        let cells = self.seeds.iter().flatten();
        cells.flat_map(|cell| cell.kinds.iter().flatten()).filter_map(|row| row.failed.as_ref())
    }
}

/// All policies of the runs, then those by name, then untrained ones.
fn candidates(args: &ClosedLoopArgs, registries: &Registries) -> Result<Vec<Candidate>> {
    let mut all = Vec::new();
    for (k, (name, folder)) in args.runs.iter().enumerate() {
        ensure!(args.runs[..k].iter().all(|(other, _)| other != name), "the run `{name}` is given twice");
        all.extend(of_run(name, folder)?);
    }
    let PolicyParts(parts) = &args.policies;
    for (part, ego) in parts.iter().zip(Ego::all(parts, registries)?) {
        let cell = format!("policy-{}", &blake3::hash(ego.label.as_bytes()).to_hex()[..12]);
        let identity = json!({"policy": crate::ego::identity(part)?, "seed": 0});
        all.push(Candidate { method: ego.label, seed: 0, cell, policy: ego.policy, identity });
    }
    for seed in 0..args.untrained {
        let shape = Shape { inputs: LENGTH, hidden: Td3Options::default().hidden, outputs: 2 };
        let network = Network::random(shape, &mut Rng::new(seed, "", "actor"));
        all.push(Candidate {
            method: UNTRAINED.to_owned(),
            seed,
            cell: format!("{UNTRAINED}-{seed}"),
            policy: Box::new(ActorPolicy::new(network)),
            identity: json!({"policy": UNTRAINED, "seed": seed}),
        });
    }
    if all.is_empty() {
        bail!("no policies; name runs with --runs, or policies with --policies");
    }
    Ok(all)
}

/// The policies of the last evaluations of all seeds of a run.
fn of_run(name: &str, folder: &Path) -> Result<Vec<Candidate>> {
    let listed = |path: &Path| -> Result<Vec<PathBuf>> {
        let entries = std::fs::read_dir(path).with_context(|| format!("cannot read `{}`", path.display()))?;
        entries.map(|entry| Ok(entry?.path())).collect()
    };
    let number = |path: &Path, prefix: &str, suffix: &str| -> Option<u64> {
        path.file_name()?.to_str()?.strip_prefix(prefix)?.strip_suffix(suffix)?.parse().ok()
    };
    let mut seeds: Vec<(u64, PathBuf)> =
        listed(folder)?.into_iter().filter_map(|path| Some((number(&path, "seed-", "")?, path))).collect();
    seeds.sort();
    let mut all = Vec::new();
    for (seed, path) in seeds {
        let files = listed(&path)?.into_iter();
        let mut policies: Vec<(u64, PathBuf)> =
            files.filter_map(|file| Some((number(&file, "policy-", ".safetensors")?, file))).collect();
        policies.sort();
        for (step, file) in policies {
            let (network, _) = read_policy(&file).map_err(|problem| anyhow!(problem))?;
            let bytes = files::read(&file, MAX_CELL)?;
            let identity = json!({"policy": blake3::hash(&bytes).to_hex()[..16], "seed": seed});
            let cell = format!("run-{name}-seed-{seed}-{step}");
            let policy = Box::new(ActorPolicy::new(network));
            all.push(Candidate { method: name.to_owned(), seed, cell, policy, identity });
        }
    }
    if all.is_empty() {
        bail!(
            "`{}` holds no policies of finished seeds; expected `seed-0/policy-….safetensors`",
            folder.display()
        );
    }
    Ok(all)
}

fn read_cell(file: &Path, identity: &Value) -> Option<Cell> {
    let bytes = files::read(file, MAX_CELL).ok()?;
    let cell: Cell = serde_json::from_slice(&bytes).ok()?;
    (cell.identity == *identity).then_some(cell)
}

/// Drives all scenes, unchanged and under each attack.
fn evaluated(
    candidate: &Candidate,
    scenes: &[Arc<SimScene>],
    attackers: &[Adversary],
    identity: Value,
) -> Cell {
    let rules = evaluation_rules(&EnvironmentOptions::training());
    let mut kinds = vec![Vec::with_capacity(scenes.len()); 1 + attackers.len()];
    for (number, scene) in scenes.iter().enumerate() {
        let (row, drive) = drive_scene(&*candidate.policy, scene, number, &rules, 0);
        kinds[0].push(row);
        for (rows, attacker) in kinds[1..].iter_mut().zip(attackers) {
            let attacker: &dyn Attacker = attacker;
            rows.push(attack_episode(&*candidate.policy, scene, number, drive.as_ref(), attacker, &rules, 0));
        }
    }
    Cell { identity, kinds }
}
