//! `sage explain`: why a scene is attacked as it is, or why not.

mod attack_row;
mod explanation;
mod picture;
mod text;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use advsage::{Registries, generators::Against, operating_point::Values, prepared, rows::search::SceneRow};
use anyhow::{Result, bail, ensure};
use sage_core::{
    objective::{Context, ContextOptions},
    scene::{Scene, SceneIndex},
};
use sage_data::{Recording, checks};
use sage_run::{
    Outcome, networks,
    output::{self, OutputFile},
    progress, terminal,
};

use crate::cli::ExplainArgs;
use attack_row::RecordedAttack;
use explanation::Explanation;

/// λ at which a scene is explained by default.
const LAMBDAS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// The explanations of a scene, and what is drawn of the last.
struct Explained {
    title: String,
    scene: Arc<Scene>,
    all: Vec<Explanation>,
    /// The candidates of the last explanation.
    candidates: picture::Candidates,
}

pub(crate) fn run(args: &ExplainArgs, registries: &Registries) -> Result<Outcome> {
    let svg = args.svg.as_deref().map(|path| OutputFile::claim(path, args.force)).transpose()?;
    if args.scene.is_dir() {
        bail!(
            "`{}` is a folder; give one of its scenes, or a row of `sage generate` in it, such as SCENE-lambda1.00.json",
            args.scene.display()
        );
    }
    let is_row = args.scene.extension().is_some_and(|ending| ending == "json");
    if is_row {
        refuse_options(args)?;
        if let Some(row) = SceneRow::read(&args.scene) {
            return explain_search(&row, args);
        }
        if let Some(scene) = scene_of_failure(&args.scene) {
            bail!(
                "`{}` is the row of a failure; `{}` says what came of the search of its scene, and `sage report` shows the failure",
                args.scene.display(),
                scene.display()
            );
        }
    }
    let explained = if is_row { of_row(args, registries)? } else { of_scene(args, registries)? };
    if let Some(svg) = svg {
        let title = input_name(&args.scene);
        svg.write(picture::draw(&explained.scene, &title, explained.candidates).as_bytes())?;
    }
    if args.json {
        let mut out = Vec::new();
        for one in &explained.all {
            terminal::write_json_line(&mut out, &serde_json::to_string(one)?)?;
        }
        output::print(&String::from_utf8(out)?)?;
    } else {
        let texts: Vec<String> = explained.all.iter().map(text::text).collect();
        output::print(&format!("{}\n\n{}", explained.title, texts.join("\n")))?;
    }
    Ok(Outcome::Done)
}

/// Name of a file for titles.
fn input_name(path: &Path) -> String {
    path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Refuses options that a row answers.
fn refuse_options(args: &ExplainArgs) -> Result<()> {
    let given = args.attack.first_given();
    let given = given.or_else(|| (args.method.name != "sage").then_some("--method"));
    let (adversary, kind) = (&args.attack.adversary, args.attack.adversary_type);
    let given = given.or_else(|| adversary.is_some().then_some("--adversary"));
    match given.or_else(|| kind.is_some().then_some("--adversary-type")) {
        Some(name) => bail!(
            "`{}` is a row, which says how its scene was attacked; leave out {name}",
            args.scene.display()
        ),
        None => Ok(()),
    }
}

/// Attacks a scene, and explains each attack.
fn of_scene(args: &ExplainArgs, registries: &Registries) -> Result<Explained> {
    ensure!(args.of.is_none(), "--of is the scene of a row, and `{}` is no row", args.scene.display());
    let mut attack = args.attack.clone();
    let points = &mut attack.generator.points;
    if points.is_empty() && attack.adversary_type.is_none() {
        points.lambda = Some(Values(LAMBDAS.to_vec()));
    }
    let generator = networks::build_generator(attack.spec(Some(&args.method), None)?, registries)?;
    let recording = Recording::read_as(&args.scene, &args.reading.options())?;
    for warning in checks::important(&recording.scene) {
        progress::say(&format!("warning: {warning}"));
    }
    let scene = Arc::new(attack.adversary().of(recording)?.scene);
    let ctx = prepared::recording(&scene, &SceneIndex::new(scene.map.clone()))?;
    let attacks = generator.built.attacks(&ctx, Against::Recording, attack.generator.seed)?;
    let objective = &generator.selection.objective;
    let uses_point = generator.built.facts.uses_operating_point();
    let (mut all, mut candidates) = (Vec::new(), picture::Candidates::default());
    for (attack, point) in attacks.iter().zip(&generator.points) {
        attack.check(ctx.scene())?;
        let label = if uses_point { point.long_label() } else { generator.method.to_string() };
        let (explanation, kinds) = Explanation::of(attack, &ctx, objective, point.mu, label);
        candidates = picture::Candidates::of(attack, &ctx, &explanation, &kinds);
        all.push(explanation);
    }
    let title = format!(
        "`{}` with the adversary `{}`, generator `{}`, selection `{}`:",
        terminal::escaped_name(&args.scene.display().to_string()),
        terminal::escaped_name(&ctx.adversary().id),
        generator.method,
        attack.generator.selection
    );
    Ok(Explained { title, scene, all, candidates })
}

/// Explains a row of `sage generate`.
fn of_row(args: &ExplainArgs, registries: &Registries) -> Result<Explained> {
    let row = RecordedAttack::read(&args.scene, args.of.as_deref(), &args.reading.options())?;
    let objective = row.objective(registries)?;
    let (scene, attack) = (&row.scene, &row.attack);
    let index = SceneIndex::new(scene.map.clone());
    let ctx = Context::new(scene, &index, &ContextOptions::default())?;
    attack.check(scene)?;
    let (explanation, kinds) = Explanation::of(attack, &ctx, &objective, row.mu, row.variant.clone());
    let candidates = picture::Candidates::of(attack, &ctx, &explanation, &kinds);
    let title = format!(
        "`{}` with the adversary `{}`, generator `{}`:",
        terminal::escaped_name(&args.scene.display().to_string()),
        terminal::escaped_name(&ctx.adversary().id),
        terminal::escaped_name(&row.method),
    );
    Ok(Explained { title, scene: row.scene.clone(), all: vec![explanation], candidates })
}

/// The row of the scene of a failure that a search found; `None` if the file is not the row of one.
fn scene_of_failure(row: &Path) -> Option<PathBuf> {
    let (scene, number) = row.file_stem()?.to_str()?.rsplit_once("-failure")?;
    let found = row.with_file_name(format!("{scene}.json"));
    (number.parse::<usize>().is_ok() && found.is_file()).then_some(found)
}

/// Explains a row of `sage search`.
fn explain_search(row: &SceneRow, args: &ExplainArgs) -> Result<Outcome> {
    ensure!(args.svg.is_none(), "a row of `sage search` has its picture beside it; leave out --svg");
    if args.json {
        let mut out = Vec::new();
        terminal::write_json_line(&mut out, &serde_json::to_string(row)?)?;
        output::print(&String::from_utf8(out)?)?;
    } else {
        output::print(&row.words())?;
    }
    Ok(Outcome::Done)
}
