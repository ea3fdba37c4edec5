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
use sage_generators::attacked;
use serde::Serialize;
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    cli::GenerateArgs,
    commands::draw::drawn_path,
    drawing::{self, Picture},
    methods::{self, Place},
    networks, output, progress,
};

#[derive(Serialize)]
struct Candidate {
    log_prob: Option<f64>,
    goal: Option<[f64; 2]>,
    trajectory: sage_core::motion::Trajectory,
    scores: Scores,
}

pub(crate) fn run(args: &GenerateArgs, registries: &Registries) -> Result<Outcome> {
    let files = folder::scene_files(&args.scene)?;
    let first = Recording::read(&files[0]);
    let weights = match (&args.weights, &first) {
        (Some(weights), _) => weights.as_str(),
        (None, Ok(recording)) => networks::default_for(recording)?,
        (None, Err(_)) => "procedural",
    };
    let experts = networks::load_experts(&registries.backbones, weights)?;
    let merger = registries.mergers.build_default(&args.dial.merger)?;
    let choosing = args.choosing.with(args.choice);
    let options = args.options.as_deref().map_or(Ok(json!({})), serde_json::from_str);
    let options: Value = options.context("--options is not a JSON object")?;
    let method = registries.methods.build(&args.method, &options)?;
    let mut places = args.dial.places(weights, &experts, choosing.choice, &[1.0])?;
    if !method.is_steered() {
        if args.dial.is_given() {
            progress::say(&format!(
                "note: `{}` is not steered: lambda, mu and aggression change nothing",
                args.method
            ));
        }
        places = vec![Place::at(1.0, None)?];
    }
    if args.dial.aggression.is_some() && (args.method != "sage" || choosing.strict) {
        progress::say(
            "note: the even dial was fitted for `sage` under the paper's feasibility; here it may not be even",
        );
    }
    let build = |place: &Place| Ok((*place, methods::build(&*method, *place, choosing, &experts, &*merger)?));
    let generators = places.iter().map(build).collect::<Result<Vec<_>>>()?;
    check_names(args, &files)?;
    output::make_folder(&args.folder.out, args.folder.force)?;
    let mut failed = 0;
    // Whoever reads the output may have seen enough; the files come all the same.
    let mut heard = true;
    for file in &files {
        match one(args, weights, file, &generators) {
            Ok(lines) => heard = heard && tell(&lines)?,
            Err(error) => {
                progress::say(&format!("error: `{}`: {error:#}", file.display()));
                failed += 1;
            }
        }
    }
    if failed > 0 {
        progress::say(&format!(
            "{failed} of {} scenes failed; the others are in `{}`",
            files.len(),
            args.folder.out.display()
        ));
        return if failed == files.len() {
            Err(anyhow::anyhow!("no scene came out"))
        } else {
            Ok(Outcome::Partial)
        };
    }
    Ok(Outcome::Done)
}

/// Name of a scene's output files.
fn stem(file: &Path) -> String {
    file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Refuses what would lose a scene.
///
/// *Errors*: two scenes of one name, or output over an input.
fn check_names(args: &GenerateArgs, files: &[PathBuf]) -> Result<()> {
    let mut seen: HashMap<String, &Path> = HashMap::new();
    for file in files {
        if let Some(other) = seen.insert(stem(file), file) {
            bail!(
                "`{}` and `{}` would become one file; generate them into two folders",
                other.display(),
                file.display()
            );
        }
        let folder = file.parent().and_then(|folder| folder.canonicalize().ok());
        if folder.is_some() && folder == args.folder.out.canonicalize().ok() {
            bail!(
                "`{}` lies in the output folder and could be overwritten; name another --out",
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
    let written = lines.iter().try_for_each(|line| writeln!(out, "{line}")).and_then(|()| out.flush());
    match written {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        written => written.map(|()| true).context("cannot write to standard output"),
    }
}

/// Attacks one scene at every place; the lines to print.
fn one(
    args: &GenerateArgs,
    weights: &str,
    file: &Path,
    generators: &[(Place, Box<dyn Generator>)],
) -> Result<Vec<String>> {
    let mut recording = Recording::read(file)?;
    recording.scene = recording.scene.with_roles(None, args.adversary.as_deref())?;
    let scene = recording.scene.clone();
    let index = SceneIndex::new(scene.map.clone());
    index.build_all();
    let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
    let scorer = Scorer::new(&ctx);
    let stem = stem(file);
    let (mut drawn, mut lines) = (Vec::new(), Vec::new());
    for (place, generator) in generators {
        let clock = Instant::now();
        let attack = generator.generate(&ctx, args.seed)?;
        let seconds = clock.elapsed().as_secs_f64();
        let name = if generators.len() > 1 { format!("{stem}-{}", place.file_label()) } else { stem.clone() };
        let scores = scorer.scores(&ctx.candidate(attack.trajectory().clone()));
        lines.push(report(args, &name, *place, &attack, &scores, seconds, &scorer, &ctx)?);
        recording.scene = attacked(&scene, attack.trajectory())?;
        recording.provenance = Some(provenance(args, weights, *place).to_string());
        for ending in ["safetensors", "pkl"] {
            recording.write(&args.folder.out.join(format!("{name}.{ending}")))?;
        }
        let label = if generators.len() > 1 { place.long_label() } else { generator.name() };
        drawn.push(drawn_path(label, &ctx, attack.trajectory().clone()));
    }
    let picture = Picture { title: stem.clone(), candidates: drawn, ..Picture::default() };
    let path = args.folder.out.join(format!("{stem}.svg"));
    output::write_file(&path, drawing::draw(&scene, &picture).as_bytes(), true)?;
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
    output::write_file(&args.folder.out.join(format!("{name}.json")), row.to_string().as_bytes(), true)?;
    if args.json {
        return Ok(row.to_string());
    }
    let hit = scores
        .collision_step
        .map_or("no contact".to_owned(), |step| format!("hits after {:.1} s", step as f64 / 10.0));
    Ok(format!(
        "{name}: {hit}, R_adv {:.2}, P_kin {:.2}, P_beh {:.2}, {}{} ({:.0} ms)",
        scores.adversarial_reward,
        scores.kinematic_penalty,
        scores.behavior_penalty,
        if scores.feasible { "feasible" } else { "not feasible" },
        attack.note.as_ref().map_or(String::new(), |note| format!("; {note}")),
        1e3 * seconds
    ))
}
