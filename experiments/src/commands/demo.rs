//! `sage demo`: made scenes, simple attacks on them, scores and pictures.

use std::io::Write;

use anyhow::{Context as _, Result};
use sage_core::{
    motion::Trajectory,
    objective::{Context, ContextOptions, Scorer, Scores},
    scene::{Scene, SceneIndex},
};
use sage_data::{
    Recording,
    procedural::{self, Kind},
};

use crate::{
    Outcome,
    cli::DemoArgs,
    commands::draw::drawn_path,
    drawing::{self, Picture},
    output, progress,
};

/// An attack with its name and scores.
type Scored = (String, Trajectory, Scores);

pub(crate) fn run(args: &DemoArgs) -> Result<Outcome> {
    output::make_folder(&args.out, args.force)?;
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{:<16} {:>6} {:>6} {:>8} {:>8}  {:<26} {:>6} {:>6} {:>6} {:>6}",
        "scene", "agents", "lanes", "attacks", "that hit", "the best", "R_adv", "hit s", "P_kin", "P_beh"
    )?;
    for kind in Kind::ALL {
        let scene = procedural::generate(kind, args.seed, 0)
            .with_context(|| format!("no {} scene came of seed {}", kind.name(), args.seed))?;
        let index = SceneIndex::new(scene.map.clone());
        let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
        let attacks = scored(&scene, &ctx);
        let hits = attacks.iter().filter(|(.., s)| s.collision && s.feasible).count();
        let lanes = scene.map.features.iter().filter(|f| f.kind.is_lane()).count();
        write!(
            out,
            "{:<16} {:>6} {lanes:>6} {:>8} {hits:>8}  ",
            scene.id,
            scene.tracks.len(),
            attacks.len()
        )?;
        match best(&attacks) {
            Some((name, _, s)) => {
                let hit =
                    s.collision_step.map_or("-".to_owned(), |step| format!("{:.1}", step as f64 / 10.0));
                writeln!(
                    out,
                    "{name:<26} {:>6.2} {hit:>6} {:>6.2} {:>6.2}",
                    s.adversarial_reward, s.kinematic_penalty, s.behavior_penalty
                )?;
            }
            None => writeln!(out, "none is feasible")?,
        }
        Recording::made(scene.clone()).write(&args.out.join(format!("{}.safetensors", scene.id)))?;
        let candidates = best(&attacks).map(|(name, path, _)| drawn_path(name.clone(), &ctx, path.clone()));
        let picture = Picture {
            title: scene.id.clone(),
            candidates: candidates.into_iter().collect(),
            ..Picture::default()
        };
        let path = args.out.join(format!("{}.svg", scene.id));
        output::write_file(&path, drawing::draw(&scene, &picture).as_bytes(), args.force)?;
    }
    progress::say(&format!(
        "scenes and pictures are in `{}`; open the .svg files in a browser",
        args.out.display()
    ));
    Ok(Outcome::Done)
}

/// The simple attacks of a scene with their scores.
fn scored(scene: &Scene, ctx: &Context) -> Vec<Scored> {
    let scorer = Scorer::new(ctx);
    let score = |(name, path): (String, Trajectory)| {
        let scores = scorer.scores(&ctx.candidate(path.clone()));
        (name, path, scores)
    };
    procedural::attacks(scene).into_iter().map(score).collect()
}

/// The feasible attack that hits, of greatest `R_adv − (P_kin + P_beh) / 10`; if none hits, the one
/// that comes nearest by that measure.
fn best(attacks: &[Scored]) -> Option<&Scored> {
    let value = |s: &Scores| s.adversarial_reward - 0.1 * (s.kinematic_penalty + s.behavior_penalty);
    attacks
        .iter()
        .filter(|(.., s)| s.feasible)
        .max_by(|a, b| a.2.collision.cmp(&b.2.collision).then(value(&a.2).total_cmp(&value(&b.2))))
}
