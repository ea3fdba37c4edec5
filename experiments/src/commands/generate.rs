//! `sage generate`: adversarial scenes from recorded ones.

use std::{
    collections::{HashMap, HashSet},
    io::{ErrorKind, Write},
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use anyhow::{Context as _, Result, bail, ensure};
use sage_core::{
    generator::{Attack, Note},
    objective::{Context, ContextOptions, FurtherMeasures, Scorer, Scores},
    scene::SceneIndex,
};
use sage_data::{Recording, folder};
use sage_generators::{Facts, attacked};
use sage_merging::Merger;
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::{
    Outcome, Registries,
    cli::GenerateArgs,
    drawing::{self, Picture, drawn_path},
    generators::{self, BuiltGenerator},
    input, networks,
    operating_point::OperatingPointSpec,
    output::{self, Folder},
    part::Part,
    progress,
    selection::Selection,
    terminal,
};

#[derive(Serialize)]
struct Candidate {
    log_prob: Option<f64>,
    goal: Option<[f64; 2]>,
    trajectory: sage_core::motion::Trajectory,
    scores: Scores,
}

/// The generator with all its operating points over one set of weights; none for one that needs no experts.
struct OverWeights {
    weights: Option<String>,
    built: BuiltGenerator,
    /// Where the dials are put, for files and rows: λ and μ even where they change nothing.
    places: Vec<OperatingPointSpec>,
}

/// What each scene is attacked with. Weights are those that the user names, or by each scene's origin: what
/// a scene gets does not depend on those beside it.
struct GeneratorSets<'a> {
    args: &'a GenerateArgs,
    registries: &'a Registries,
    method: Part,
    facts: Facts,
    merger: Arc<dyn Merger>,
    selection: Selection,
    further: FurtherMeasures,
    loaded: Vec<OverWeights>,
}

impl GeneratorSets<'_> {
    /// Number of what a scene is attacked with.
    ///
    /// *Errors*: weights that cannot be used.
    fn for_scene(&mut self, is_procedural: bool) -> Result<usize> {
        let weights = match &self.args.weights {
            _ if !self.facts.needs_experts => None,
            Some(weights) => Some(weights.as_str()),
            None => Some(networks::default_for(is_procedural)?),
        };
        let known = self.loaded.iter().position(|over| over.weights.as_deref() == weights);
        let number = match known {
            Some(number) => number,
            None => {
                self.loaded.push(self.load(weights)?);
                self.loaded.len() - 1
            }
        };
        Ok(number)
    }

    fn load(&self, weights: Option<&str>) -> Result<OverWeights> {
        let args = self.args;
        let load = |name| networks::load_experts(&self.registries.backbones, name);
        let experts = weights.map(load).transpose()?;
        let dial = || {
            let weights = weights.unwrap_or("procedural");
            let merger = args.points.merging.merger.to_string();
            match &experts {
                Some(experts) => networks::load_dial(weights, experts, &self.selection, &merger),
                None => networks::load_dial(weights, &load(weights)?, &self.selection, &merger),
            }
        };
        let range = self.merger.range();
        let places = if self.facts.uses_operating_point() {
            args.points.specs(dial, range, &[1.0])?
        } else {
            vec![OperatingPointSpec::at(1.0, None, range)?]
        };
        let labels: HashSet<String> = places.iter().map(OperatingPointSpec::file_label).collect();
        ensure!(labels.len() == places.len(), "two places of the dial would become one file");
        let inputs = generators::inputs(experts.as_ref(), &self.merger, &self.selection, args.seed);
        let built = BuiltGenerator::new(&self.method, self.registries, &inputs, &places)?;
        Ok(OverWeights { weights: weights.map(str::to_owned), built, places })
    }
}

pub(crate) fn run(args: &GenerateArgs, registries: &Registries) -> Result<Outcome> {
    let mut method = args.method.clone();
    if let Some(options) = &args.options {
        let options: Map<String, Value> =
            serde_json::from_str(options).context("--options is not a JSON object")?;
        method.options.extend(options);
    }
    let facts = method.build(&registries.generators)?.facts();
    let merger: Arc<dyn Merger> = args.points.merging.merger.build(&registries.mergers)?.into();
    args.points.check(merger.range())?;
    let selection = Selection::of(registries, &args.selection, args.rule.feasibility.as_ref())?;
    say_what_changes_nothing(args, &facts);
    let spec = Some(selection.objective.spec());
    let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, spec)?;
    let mut sets =
        GeneratorSets { args, registries, method, facts, merger, selection, further, loaded: Vec::new() };
    if args.weights.is_some() {
        sets.for_scene(true)?;
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
    let is_procedural =
        args.weights.is_some() || recording.is_procedural().map_err(|error| Failure::Scene(error.into()))?;
    let number = sets.for_scene(is_procedural).map_err(Failure::Run)?;
    one(args, out, sets, number, file, recording).map_err(Failure::Scene)
}

fn say_what_changes_nothing(args: &GenerateArgs, facts: &Facts) {
    let dial = &args.points;
    let follows_mixture = facts.depends_on_lambda || facts.depends_on_mu;
    let given = [
        ("--lambda", dial.lambda.is_some() && !follows_mixture),
        ("--mix", dial.mix.is_some() && !follows_mixture),
        ("--aggression", dial.aggression.is_some() && !follows_mixture),
        ("--mu", dial.mu.is_some() && !facts.depends_on_mu),
        ("--merger", dial.merging.merger.name != "linear" && !facts.depends_on_lambda),
        ("--selection", args.selection != "natural" && !facts.depends_on_mu),
        ("--weights", args.weights.is_some() && !facts.needs_experts),
    ];
    let idle: Vec<&str> = given.into_iter().filter(|(_, is_idle)| *is_idle).map(|(name, _)| name).collect();
    if !idle.is_empty() {
        progress::say(&format!("note: `{}` does not depend on {}", args.method, idle.join(", ")));
    }
    let is_paper = args.rule.feasibility.as_ref().is_none_or(|rule| *rule == Part::paper());
    if dial.aggression.is_some() && facts.uses_operating_point() && (args.method.name != "sage" || !is_paper)
    {
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
    sets: &GeneratorSets,
    number: usize,
    file: &Path,
    mut recording: Recording,
) -> Result<Vec<String>> {
    let OverWeights { weights, built, places } = &sets.loaded[number];
    recording.scene = recording.scene.with_roles(None, args.adversary.as_deref())?;
    let scene = Arc::new(recording.scene.clone());
    let index = SceneIndex::new(scene.map.clone());
    index.build_all();
    let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
    let scorer = Scorer::with(&ctx, &sets.further);
    let stem = stem(file);
    let clock = Instant::now();
    let attacks = built.generator.attacks(&ctx, &built.points, args.seed)?;
    let seconds = clock.elapsed().as_secs_f64() / places.len() as f64;
    let (mut drawn, mut lines) = (Vec::new(), Vec::new());
    for (place, attack) in places.iter().zip(attacks) {
        attack.check(&scene)?;
        let name = if places.len() > 1 { format!("{stem}-{}", place.file_label()) } else { stem.clone() };
        let report = Report { sets, scorer: &scorer, ctx: &ctx, name: &name, place, seconds };
        lines.push(report.write(args, out, &attack)?);
        recording.scene = attacked(&scene, attack.trajectory())?;
        recording.provenance = Some(provenance(args, sets, weights.as_deref(), place).to_string());
        for ending in ["safetensors", "pkl"] {
            recording.write(&out.path().join(format!("{name}.{ending}")))?;
        }
        let label = if places.len() > 1 { place.long_label() } else { built.keys[0].label() };
        drawn.push(drawn_path(label, &ctx, attack.trajectory().clone()));
    }
    let picture = Picture { title: stem.clone(), candidates: drawn, ..Picture::default() };
    out.write(&format!("{stem}.svg"), drawing::draw(&scene, &picture).as_bytes())?;
    Ok(lines)
}

/// How a scene was attacked, for whoever finds the file.
fn provenance(
    args: &GenerateArgs,
    sets: &GeneratorSets,
    weights: Option<&str>,
    place: &OperatingPointSpec,
) -> Value {
    let mut row = json!({
        "by": concat!("sage ", env!("CARGO_PKG_VERSION")), "command": output::command(), "weights": weights,
        "seed": args.seed,
    });
    describe(&mut row, args, sets, place);
    row
}

/// Adds what was asked for.
fn describe(row: &mut Value, args: &GenerateArgs, sets: &GeneratorSets, place: &OperatingPointSpec) {
    row["method"] = json!(sets.method.name);
    row["options"] = json!(sets.method.options);
    row["lambda"] = json!(place.lambda);
    row["mu"] = json!(place.mu);
    row["aggression"] = json!(place.aggression);
    if !place.mix.is_empty() {
        row["mix"] = place.mix.iter().map(|(name, weight)| (name.clone(), json!(weight))).collect();
    }
    row["merger"] = json!(args.points.merging.merger.to_string());
    row["selection"] = json!(sets.selection.objective.spec());
}

/// What is reported of one attack.
struct Report<'r> {
    sets: &'r GeneratorSets<'r>,
    scorer: &'r Scorer<'r>,
    ctx: &'r Context,
    name: &'r str,
    place: &'r OperatingPointSpec,
    /// Seconds a place, when all were worked on together.
    seconds: f64,
}

impl Report<'_> {
    /// Writes the attack with all its candidates as JSON; the line to print.
    fn write(&self, args: &GenerateArgs, out: &Folder, attack: &Attack) -> Result<String> {
        let Self { sets, scorer, ctx, name, place, seconds } = self;
        let chosen = ctx.candidate(attack.trajectory().clone());
        let scores = scorer.scores(&chosen);
        // By the rule of the selection, whatever the scores beside it tell of.
        let violations = sets.selection.objective.rule().violations(&chosen, ctx);
        let all = attack.candidates.iter().map(|p| Candidate {
            log_prob: p.log_prob,
            goal: p.goal,
            scores: scorer.scores(&ctx.candidate(p.trajectory.clone())),
            trajectory: p.trajectory.clone(),
        });
        let note = attack.note.as_ref().map(Note::to_string);
        let mut row = json!({
            "scene": name, "seed": args.seed,
            "trajectory": attack.trajectory(), "chosen": attack.chosen, "feasible": violations.is_empty(),
            "violations": violations, "note": note, "scores": scores,
            "candidates": all.collect::<Vec<_>>(), "seconds": seconds,
        });
        describe(&mut row, args, sets, place);
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
            if violations.is_empty() { "feasible" } else { "not feasible" },
            note.map_or(String::new(), |note| format!("; {note}")),
            1e3 * seconds
        ))
    }
}
