//! `sage generate`: writes adversarial variants of scenes as a data set.

mod attack;
mod plan;
mod report;
mod row;

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::Instant,
};

use anyhow::{Result, bail};
use sage_core::statistics;
use sage_data::folder;
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    cli::GenerateArgs,
    input,
    output::{self, DatasetRun},
    progress,
};

use attack::{Failure, attack_scene};
use plan::Plan;
use report::Report;
use row::row_file;

/// A scene file with the name of its outputs.
struct Input {
    file: PathBuf,
    /// Name of the file without its ending.
    scene: String,
}

pub(crate) fn run(args: &GenerateArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let plan = Plan::new(args, registries)?;
    let files = folder::scene_files(&args.scene)?;
    let all = inputs(&files)?;
    let own: Vec<&Input> =
        all.iter().filter(|input| args.shard.is_none_or(|shard| shard.holds(&input.scene))).collect();
    let row_files = |inputs: &[&Input]| -> Vec<String> {
        let rows =
            |input: &&Input| plan.variants.iter().map(|v| row_file(&input.scene, v)).collect::<Vec<_>>();
        inputs.iter().flat_map(rows).collect()
    };
    // Input files must not be in the output folder, even if no output has the same name.
    let names: Vec<PathBuf> = files
        .iter()
        .flat_map(|file| [Some(file.clone()), file.canonicalize().ok()])
        .flatten()
        .filter_map(|file| file.file_name().map(PathBuf::from))
        .collect();
    output::protect_inputs(std::slice::from_ref(&args.scene), &files, &args.folder.out, &names)?;
    let run = DatasetRun::start(&args.folder.out, plan.identity()?, args.folder.force, args.shard, || {
        row_files(&own)
    })?;
    let report = Report::new(run.folder().path(), args.json, own.len());
    let seconds = work(&plan, &run, &own, &report)?;
    let failed = report.finish(&args.folder.out);
    let folder = run.folder().path().to_owned();
    let results = || {
        let done = all.iter().filter(|input| is_done(&plan, &folder, input)).count();
        json!({"scenes": all.len(), "done": done})
    };
    let is_whole = |results: &Value| results["scenes"] == results["done"];
    let whole = |results: &Value| is_whole(results).then(|| clock.elapsed().as_secs_f64());
    let median = statistics::median(&seconds);
    let (results, listed) = run.finish(plan.writes_pickles(), results, median, whole)?;
    let others = listed.saturating_sub(all.len() * plan.variants.len());
    if is_whole(&results) && others > 0 {
        let out = args.folder.out.display();
        let others = progress::count(others, "scene");
        progress::say(&format!(
            "note: the summary of `{out}` also lists {others} that other runs left there"
        ));
    }
    match failed {
        0 => Ok(Outcome::Done),
        1 if own.len() == 1 => bail!("the scene could not be attacked"),
        all if all == own.len() => bail!("none of {all} scenes could be attacked"),
        some => {
            let out = args.folder.out.display();
            progress::say(&format!(
                "{some} of {} scenes failed; the others are in `{out}`; the same command tries the failed ones again",
                own.len()
            ));
            Ok(Outcome::Partial)
        }
    }
}

/// Attacks scenes on all threads; each thread takes the next scene. Returns seconds per variant of each
/// attacked scene.
///
/// *Errors*: the first failure that ends the run.
fn work(plan: &Plan, run: &DatasetRun, inputs: &[&Input], report: &Report) -> Result<Vec<f64>> {
    let next = AtomicUsize::new(0);
    let (stopped, times) = (Mutex::new(None), Mutex::new(Vec::new()));
    let locked_stop = || stopped.lock().unwrap_or_else(PoisonError::into_inner);
    rayon::broadcast(|_| {
        while locked_stop().is_none() {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(input) = inputs.get(number) else { break };
            let outcome = match attack_scene(plan, run, &input.file, &input.scene) {
                Ok(scene) => {
                    times.lock().unwrap_or_else(PoisonError::into_inner).extend(scene.seconds);
                    report.done(number, scene)
                }
                Err(Failure::Scene(error)) if output::is_disk_full(&error) => Err(error.context(format!(
                    "the disk is full; {} of {} scenes are finished in `{}`; free space and run the same command again",
                    report.finished(),
                    inputs.len(),
                    run.folder().path().display()
                ))),
                Err(Failure::Scene(error)) => report.failed(number, &input.file, &error),
                Err(Failure::Run(error)) => Err(error),
            };
            if let Err(error) = outcome {
                locked_stop().get_or_insert(error);
            }
        }
    });
    match stopped.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error),
        None => Ok(times.into_inner().unwrap_or_else(PoisonError::into_inner)),
    }
}

/// True if all rows of a scene exist.
fn is_done(plan: &Plan, folder: &Path, input: &Input) -> bool {
    let exists = |variant: &String| folder.join(row_file(&input.scene, variant)).is_file();
    plan.variants.iter().all(exists)
}

/// Scene files with the names of their outputs.
///
/// *Errors*: two files have the same name.
fn inputs(files: &[PathBuf]) -> Result<Vec<Input>> {
    let mut seen: HashMap<String, &Path> = HashMap::new();
    let mut inputs = Vec::with_capacity(files.len());
    for file in files {
        let scene = input::scene_name(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(other) = seen.insert(scene.clone(), file) {
            bail!(
                "`{}` and `{}` have the same name, so their outputs would have; generate them into two folders",
                other.display(),
                file.display()
            );
        }
        inputs.push(Input { file: file.clone(), scene });
    }
    Ok(inputs)
}
