//! `sage demo`: attacks procedural scenes at five aggressions and draws them.

use std::{io::Write, sync::Arc};

use anyhow::{Context as _, Result};
use rayon::prelude::*;
use sage_core::{
    generator::Attack,
    objective::{Context, ContextOptions, Scorer, Scores},
    scene::{Scene, SceneIndex},
};
use sage_data::{
    Recording,
    procedural::{self, Kind},
};
use sage_generators::attacked;

use crate::{
    Outcome, Registries,
    cli::DemoArgs,
    drawing::{self, Picture, drawn_path},
    generators::{BuiltGenerator, Generators},
    networks,
    operating_point::OperatingPointSpec,
    output::Folder,
    part::Part,
    progress,
    selection::Selection,
};

/// Aggressions of the sweep.
const AGGRESSIONS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Scenes of each kind.
const SCENES: u64 = 6;

/// A scene with its attack at each aggression.
struct AttackedScene {
    scene: Arc<Scene>,
    attacks: Vec<(Attack, Scores)>,
}

pub(crate) fn run(args: &DemoArgs, registries: &Registries) -> Result<Outcome> {
    let out = Folder::make(&args.out, args.force)?;
    let experts = networks::load_experts(&registries.backbones, "procedural")?;
    let selection = Selection::of(registries, "natural", None)?;
    let dial = networks::load_dial("procedural", &experts, &selection, "linear")?;
    let points =
        AGGRESSIONS.map(|a| OperatingPointSpec::of(&dial, a)).into_iter().collect::<Result<Vec<_>>>()?;
    let generators = Generators::new(registries, &Part::named("linear"), &selection, 0)?;
    let sage = generators.with_experts(&experts).build(&Part::named("sage"), &points)?;
    let numbers: Vec<(Kind, u64)> =
        Kind::ALL.into_iter().flat_map(|kind| (0..SCENES).map(move |number| (kind, number))).collect();
    let attack = |&(kind, number): &(Kind, u64)| attacked_scene(kind, number, args.seed, &sage);
    let attacked_scenes: Vec<Result<AttackedScene>> =
        numbers.par_iter().with_max_len(1).map(attack).collect();
    let attacked_scenes = attacked_scenes.into_iter().collect::<Result<Vec<_>>>()?;
    for ((_, number), attacked_scene) in numbers.iter().zip(&attacked_scenes) {
        if *number == 0 {
            write_files(&out, attacked_scene)?;
        }
    }
    print(&attacked_scenes)?;
    progress::say(&format!(
        "one scene of each kind, its attack at aggression 1 and a picture of all five are in `{}`; open the .svg files in a browser",
        args.out.display()
    ));
    Ok(Outcome::Done)
}

fn attacked_scene(kind: Kind, number: u64, seed: u64, sage: &BuiltGenerator) -> Result<AttackedScene> {
    let scene = procedural::generate(kind, seed, number)
        .with_context(|| format!("no {} scene could be generated from seed {seed}", kind.name()))?;
    let (index, scene) = (SceneIndex::new(scene.map.clone()), Arc::new(scene));
    let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
    let scorer = Scorer::new(&ctx);
    let scored = |attack: Attack| {
        let scores = scorer.scores(&ctx.candidate(attack.trajectory().clone()));
        (attack, scores)
    };
    let attacks = sage.attacks(&ctx, seed)?;
    Ok(AttackedScene { scene, attacks: attacks.into_iter().map(scored).collect() })
}

/// Writes the scene, its strongest attack as another scene, and a picture of all attacks.
fn write_files(out: &Folder, attacked_scene: &AttackedScene) -> Result<()> {
    let scene = &attacked_scene.scene;
    let index = SceneIndex::new(scene.map.clone());
    let ctx = Context::new(scene, &index, &ContextOptions::default())?;
    let path = |ending: &str| out.path().join(format!("{}{ending}", scene.id));
    Recording::procedural((**scene).clone()).write(&path(".safetensors"))?;
    if let Some((strongest, _)) = attacked_scene.attacks.last() {
        let attacked = Recording::procedural(attacked(scene, strongest.trajectory())?);
        attacked.write(&path("-attacked.safetensors"))?;
        attacked.write(&path("-attacked.pkl"))?;
    }
    let drawn = AGGRESSIONS
        .iter()
        .zip(&attacked_scene.attacks)
        .map(|(a, (attack, _))| drawn_path(format!("aggression {a:.2}"), &ctx, attack.trajectory().clone()));
    let picture = Picture { title: scene.id.clone(), candidates: drawn.collect(), ..Picture::default() };
    out.write(&format!("{}.svg", scene.id), drawing::draw(scene, &picture).as_bytes())
}

fn print(attacked_scenes: &[AttackedScene]) -> Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{:<10} {:>10} {:>12} {:>8} {:>8} {:>8} {:>10}   {}",
        "aggression",
        "attacked",
        "believable",
        "R_adv",
        "P_kin",
        "P_beh",
        "feasible",
        Kind::ALL.map(|kind| format!("{:>11}", kind.name())).join(" ")
    )?;
    for (slot, a) in AGGRESSIONS.into_iter().enumerate() {
        let scores: Vec<&Scores> = attacked_scenes.iter().map(|s| &s.attacks[slot].1).collect();
        let mean = |value: &dyn Fn(&Scores) -> f64| {
            scores.iter().map(|s| value(s)).sum::<f64>() / scores.len() as f64
        };
        let hits = |s: &Scores| f64::from(u8::from(s.collision == Some(true) && s.feasible));
        let of_kind = |k: usize| {
            let per = SCENES as usize;
            let hit = scores[k * per..(k + 1) * per].iter().filter(|s| hits(s) > 0.0).count();
            format!("{:>11}", format!("{hit} of {per}"))
        };
        let kinds: Vec<String> = (0..Kind::ALL.len()).map(of_kind).collect();
        writeln!(
            out,
            "{a:<10.2} {:>9.0}% {:>11.0}% {:>8.2} {:>8.2} {:>8.2} {:>9.0}%   {}",
            100.0 * mean(&hits),
            100.0 * mean(&|s| f64::from(u8::from(s.believable == Some(true)))),
            mean(&|s| s.adversarial_reward),
            mean(&|s| s.kinematic_penalty),
            mean(&|s| s.behavior_penalty),
            100.0 * mean(&|s| f64::from(u8::from(s.feasible))),
            kinds.join(" ")
        )?;
    }
    Ok(())
}
