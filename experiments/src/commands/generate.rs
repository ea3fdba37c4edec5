//! `sage generate`: adversarial scenes from recorded ones.

use std::{io::Write, path::Path, time::Instant};

use anyhow::{Context as _, Result};
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
    let merger = registries.mergers.build_default("linear")?;
    let choosing = args.choosing.with(args.choice);
    let method = registries.methods.build_default(&args.method)?;
    let mut places = args.dial.places(weights, choosing.choice, &[1.0])?;
    if !method.is_steered() {
        places.truncate(1);
    }
    let build = |place: &Place| Ok((*place, methods::build(&*method, *place, choosing, &experts, &*merger)?));
    let generators = places.iter().map(build).collect::<Result<Vec<_>>>()?;
    output::make_folder(&args.out, args.force)?;
    let mut failed = 0;
    for file in &files {
        if let Err(error) = one(args, weights, file, &generators) {
            progress::say(&format!("error: `{}`: {error:#}", file.display()));
            failed += 1;
        }
    }
    if failed > 0 {
        progress::say(&format!(
            "{failed} of {} scenes failed; the others are in `{}`",
            files.len(),
            args.out.display()
        ));
        return if failed == files.len() {
            Err(anyhow::anyhow!("no scene came out"))
        } else {
            Ok(Outcome::Partial)
        };
    }
    Ok(Outcome::Done)
}

fn one(
    args: &GenerateArgs,
    weights: &str,
    file: &Path,
    generators: &[(Place, Box<dyn Generator>)],
) -> Result<()> {
    let mut recording = Recording::read(file)?;
    recording.scene = recording.scene.with_roles(None, args.adversary.as_deref())?;
    let scene = recording.scene.clone();
    let index = SceneIndex::new(scene.map.clone());
    let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
    let scorer = Scorer::new(&ctx);
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut drawn = Vec::new();
    for (place, generator) in generators {
        let clock = Instant::now();
        let attack = generator.generate(&ctx, args.seed)?;
        let seconds = clock.elapsed().as_secs_f64();
        let name = if generators.len() > 1 { format!("{stem}-{}", place.file_label()) } else { stem.clone() };
        let scores = scorer.scores(&ctx.candidate(attack.trajectory().clone()));
        report(args, &name, *place, &attack, &scores, seconds, &scorer, &ctx)?;
        recording.scene = attacked(&scene, attack.trajectory())?;
        recording.provenance = Some(provenance(args, weights, *place).to_string());
        for ending in ["safetensors", "pkl"] {
            recording.write(&args.out.join(format!("{name}.{ending}")))?;
        }
        let label = if generators.len() > 1 { place.long_label() } else { generator.name() };
        drawn.push(drawn_path(label, &ctx, attack.trajectory().clone()));
    }
    let picture = Picture { title: stem.clone(), candidates: drawn, ..Picture::default() };
    let path = args.out.join(format!("{stem}.svg"));
    output::write_file(&path, drawing::draw(&scene, &picture).as_bytes(), true)
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
) -> Result<()> {
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
    output::write_file(&args.out.join(format!("{name}.json")), row.to_string().as_bytes(), true)?;
    let mut out = std::io::stdout().lock();
    if args.json {
        writeln!(out, "{row}")?;
    } else {
        let hit = scores
            .collision_step
            .map_or("no contact".to_owned(), |step| format!("hits after {:.1} s", step as f64 / 10.0));
        writeln!(
            out,
            "{name}: {hit}, R_adv {:.2}, P_kin {:.2}, P_beh {:.2}, {}{} ({:.0} ms)",
            scores.adversarial_reward,
            scores.kinematic_penalty,
            scores.behavior_penalty,
            if scores.feasible { "feasible" } else { "not feasible" },
            attack.note.as_ref().map_or(String::new(), |note| format!("; {note}")),
            1e3 * seconds
        )?;
    }
    out.flush().context("cannot write to standard output")
}
