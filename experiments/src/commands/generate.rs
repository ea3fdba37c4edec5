//! `sage generate`: adversarial scenes from recorded ones.

use std::{
    collections::HashMap,
    io::{ErrorKind, Write},
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::{Context as _, Result, bail};
use sage_core::{
    generator::{Attack, Generator},
    objective::{Context, ContextOptions, Scorer, Scores},
    scene::SceneIndex,
};
use sage_data::{Recording, folder};
use sage_generators::{Method, attacked};
use serde::Serialize;
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    cli::GenerateArgs,
    commands::draw::drawn_path,
    drawing::{self, Picture},
    input,
    methods::{self, Place},
    networks,
    output::{self, Folder},
    progress, terminal,
};

#[derive(Serialize)]
struct Candidate {
    log_prob: Option<f64>,
    goal: Option<[f64; 2]>,
    trajectory: sage_core::motion::Trajectory,
    scores: Scores,
}

/// Generators at all places over one set of weights.
struct Generators {
    weights: String,
    places: Vec<(Place, Box<dyn Generator>)>,
}

/// What each scene is attacked with. Weights are those that the user names, or by each scene's origin: what
/// a scene gets does not depend on those beside it.
struct GeneratorSets<'a> {
    args: &'a GenerateArgs,
    registries: &'a Registries,
    method: Box<dyn Method>,
    loaded: Vec<Generators>,
}

impl GeneratorSets<'_> {
    /// The generators for a scene.
    ///
    /// *Errors*: weights that cannot be used.
    fn for_scene(&mut self, is_made: bool) -> Result<&Generators> {
        let weights = match &self.args.weights {
            Some(weights) => weights.as_str(),
            None => networks::default_for(is_made)?,
        };
        let known = self.loaded.iter().position(|generators| generators.weights == weights);
        let number = match known {
            Some(number) => number,
            None => {
                self.loaded.push(self.load(weights)?);
                self.loaded.len() - 1
            }
        };
        Ok(&self.loaded[number])
    }

    fn load(&self, weights: &str) -> Result<Generators> {
        let args = self.args;
        let experts = networks::load_experts(&self.registries.backbones, weights)?;
        let merger = self.registries.mergers.build_default(&args.dial.merger)?;
        let choosing = args.choosing.with(args.choice);
        let places = if self.method.is_steered() {
            args.dial.places(weights, &experts, choosing.choice, &[1.0])?
        } else {
            vec![Place::at(1.0, None)?]
        };
        let build =
            |place: Place| Ok((place, methods::build(&*self.method, place, choosing, &experts, &*merger)?));
        let places = places.into_iter().map(build).collect::<Result<Vec<_>>>()?;
        Ok(Generators { weights: weights.to_owned(), places })
    }
}

pub(crate) fn run(args: &GenerateArgs, registries: &Registries) -> Result<Outcome> {
    let options = args.options.as_deref().map_or(Ok(json!({})), serde_json::from_str);
    let options: Value = options.context("--options is not a JSON object")?;
    let method = registries.methods.build(&args.method, &options)?;
    registries.mergers.get(&args.dial.merger)?;
    args.dial.check()?;
    say_what_changes_nothing(args, &*method);
    let mut sets = GeneratorSets { args, registries, method, loaded: Vec::new() };
    if let Some(weights) = &args.weights {
        sets.loaded.push(sets.load(weights)?);
    }
    let files = folder::scene_files(&args.scene)?;
    check_names(&files)?;
    let out = Folder::make(&args.folder.out, args.folder.force)?;
    // Any input in the output folder, whatever the names of the outputs will be.
    let names: Vec<PathBuf> = files
        .iter()
        .flat_map(|file| [Some(file.clone()), file.canonicalize().ok()])
        .flatten()
        .filter_map(|file| file.file_name().map(PathBuf::from))
        .collect();
    output::keep_inputs(std::slice::from_ref(&args.scene), &files, &out, &names)?;
    let mut failed = 0;
    // Whoever reads the output may have seen enough; the files come all the same.
    let mut heard = true;
    for (number, file) in files.iter().enumerate() {
        match attempt(args, &out, &mut sets, file) {
            Ok(lines) => heard = heard && tell(&lines)?,
            Err(Failure::Run(error)) => return Err(error),
            Err(Failure::Scene(error)) if output::is_disk_full(&error) => {
                let whole = number - failed;
                return Err(error.context(format!(
                    "{whole} of {} scenes are whole in `{}`; free space and start again with --force",
                    files.len(),
                    args.folder.out.display()
                )));
            }
            Err(Failure::Scene(error)) => {
                let (file, error) = (format!("`{}`", file.display()), format!("{error:#}"));
                let is_named = error.contains(&file);
                progress::say(&if is_named {
                    format!("error: {error}")
                } else {
                    format!("error: {file}: {error}")
                });
                failed += 1;
            }
        }
    }
    match failed {
        0 => Ok(Outcome::Done),
        all if all == files.len() => {
            bail!(
                "no scene came out of {}",
                if all == 1 { "1 file".to_owned() } else { format!("{all} files") }
            )
        }
        some => {
            let place = args.folder.out.display();
            progress::say(&format!("{some} of {} scenes failed; the others are in `{place}`", files.len()));
            Ok(Outcome::Partial)
        }
    }
}

/// What a failure ends.
enum Failure {
    /// The scene: the others go on.
    Scene(anyhow::Error),
    /// The run: no scene could be attacked.
    Run(anyhow::Error),
}

/// Reads a scene and attacks it at every place; the lines to print.
fn attempt(
    args: &GenerateArgs,
    out: &Folder,
    sets: &mut GeneratorSets,
    file: &Path,
) -> Result<Vec<String>, Failure> {
    let recording = Recording::read(file).map_err(|error| Failure::Scene(error.into()))?;
    // Where the user names weights, nobody asks where the scene is from.
    let is_made =
        args.weights.is_some() || recording.is_made().map_err(|error| Failure::Scene(error.into()))?;
    let generators = sets.for_scene(is_made).map_err(Failure::Run)?;
    one(args, out, generators, file, recording).map_err(Failure::Scene)
}

fn say_what_changes_nothing(args: &GenerateArgs, method: &dyn Method) {
    let strict = args.choosing.with(args.choice).strict;
    if !method.is_steered() && args.dial.is_given() {
        progress::say(&format!(
            "note: `{}` is not steered: lambda, mu and aggression change nothing",
            args.method
        ));
    }
    if args.dial.aggression.is_some() && (args.method != "sage" || strict) {
        progress::say(
            "note: the even dial was fitted for `sage` under the paper's feasibility; here it may not be even",
        );
    }
}

/// Name of a scene's output files.
fn stem(file: &Path) -> String {
    input::scene_name(file).file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Refuses what would lose a scene.
///
/// *Errors*: two scenes of one name.
fn check_names(files: &[PathBuf]) -> Result<()> {
    let mut seen: HashMap<String, &Path> = HashMap::new();
    for file in files {
        if let Some(other) = seen.insert(stem(file), file) {
            bail!(
                "`{}` and `{}` would become one file; generate them into two folders",
                other.display(),
                file.display()
            );
        }
    }
    Ok(())
}

/// Prints lines; whether anybody still reads them.
///
/// *Errors*: standard output is full.
fn tell(lines: &[String]) -> Result<bool> {
    let mut out = std::io::stdout().lock();
    let written = lines.iter().try_for_each(|line| out.write_all(line.as_bytes())).and_then(|()| out.flush());
    match written {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        written => written.map(|()| true).context("cannot write to standard output"),
    }
}

/// Attacks one scene at every place; the lines to print.
fn one(
    args: &GenerateArgs,
    out: &Folder,
    Generators { weights, places }: &Generators,
    file: &Path,
    mut recording: Recording,
) -> Result<Vec<String>> {
    recording.scene = recording.scene.with_roles(None, args.adversary.as_deref())?;
    let scene = recording.scene.clone();
    let index = SceneIndex::new(scene.map.clone());
    index.build_all();
    let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
    let scorer = Scorer::new(&ctx);
    let stem = stem(file);
    let (mut drawn, mut lines) = (Vec::new(), Vec::new());
    for (place, generator) in places {
        let clock = Instant::now();
        let attack = generator.generate(&ctx, args.seed)?;
        let seconds = clock.elapsed().as_secs_f64();
        attack.check(&scene)?;
        let name = if places.len() > 1 { format!("{stem}-{}", place.file_label()) } else { stem.clone() };
        let scores = scorer.scores(&ctx.candidate(attack.trajectory().clone()));
        lines.push(report(args, out, &name, *place, &attack, &scores, seconds, &scorer, &ctx)?);
        recording.scene = attacked(&scene, attack.trajectory())?;
        recording.provenance = Some(provenance(args, weights, *place).to_string());
        for ending in ["safetensors", "pkl"] {
            recording.write(&out.path().join(format!("{name}.{ending}")))?;
        }
        let label = if places.len() > 1 { place.long_label() } else { generator.name() };
        drawn.push(drawn_path(label, &ctx, attack.trajectory().clone()));
    }
    let picture = Picture { title: stem.clone(), candidates: drawn, ..Picture::default() };
    out.write(&format!("{stem}.svg"), drawing::draw(&scene, &picture).as_bytes())?;
    Ok(lines)
}

/// How a scene was attacked, for whoever finds the file.
fn provenance(args: &GenerateArgs, weights: &str, place: Place) -> Value {
    json!({
        "by": concat!("sage ", env!("CARGO_PKG_VERSION")), "command": output::command(), "method": args.method,
        "weights": weights, "lambda": place.lambda, "mu": place.mu, "aggression": place.aggression, "seed": args.seed,
    })
}

#[allow(clippy::too_many_arguments)] // One row needs all of it, and nobody else calls it.
fn report(
    args: &GenerateArgs,
    out: &Folder,
    name: &str,
    place: Place,
    attack: &Attack,
    scores: &Scores,
    seconds: f64,
    scorer: &Scorer,
    ctx: &Context,
) -> Result<String> {
    let all = attack.candidates.iter().map(|p| Candidate {
        log_prob: p.log_prob,
        goal: p.goal,
        scores: scorer.scores(&ctx.candidate(p.trajectory.clone())),
        trajectory: p.trajectory.clone(),
    });
    let row = json!({
        "scene": name, "method": args.method, "lambda": place.lambda, "mu": place.mu, "aggression": place.aggression,
        "seed": args.seed,
        "trajectory": attack.trajectory(), "chosen": attack.chosen, "feasible": scores.feasible,
        "reasons": scores.reasons, "note": attack.note, "scores": scores,
        "candidates": all.collect::<Vec<_>>(), "seconds": seconds,
    });
    out.write(&format!("{name}.json"), row.to_string().as_bytes())?;
    if args.json {
        let mut line = Vec::new();
        terminal::json_line(&mut line, &row)?;
        return Ok(String::from_utf8_lossy(&line).into_owned());
    }
    let hit = scores
        .collision_step
        .map_or("no contact".to_owned(), |step| format!("hits after {:.1} s", step as f64 / 10.0));
    Ok(format!(
        "{}: {hit}, R_adv {:.2}, P_kin {:.2}, P_beh {:.2}, {}{} ({:.0} ms)\n",
        terminal::harmless_name(name),
        scores.adversarial_reward,
        scores.kinematic_penalty,
        scores.behavior_penalty,
        if scores.feasible { "feasible" } else { "not feasible" },
        attack.note.as_ref().map_or(String::new(), |note| format!("; {note}")),
        1e3 * seconds
    ))
}
