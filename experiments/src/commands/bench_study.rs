//! `sage bench STUDY`: runs a study; `sage bench report`: renders it again; `sage bench list`.

mod gallery;

use std::{collections::HashMap, path::Path, sync::Arc, time::Instant};

use anyhow::{Context as _, Result, bail};
use sage_backbones::Backbone;
use sage_bench::{
    measure::ExpertSource,
    plan::Plan,
    report::{self, RECORD as STUDY_RECORD, ROWS, Report, StudyRecord},
    rows::{Results, Subject},
    runner::{self, Observer, SceneSource, Store},
    study::{MAX_STUDY_FILE, Study},
    wrap::wrapped,
};
use sage_core::{files, scene::SceneData};
use sage_generators::Aggression;
use sage_merging::ExpertSet;
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    cli::{ReportArgs, StudyArgs},
    input, networks,
    output::{self, Folder, Run, RunState},
    progress::{self, Progress, count},
    scenes::Scenes,
    selection::Selection,
};

/// Folder of the results from which an interrupted run resumes.
const WINDOWS: &str = ".sage-rows";
/// Size limit of a stored window, and of files that a run wrote, bytes.
const LIMIT: u64 = 1 << 30;

/// The study of a name or a file.
fn study(name: &str, registries: &Registries) -> Result<Study> {
    if let Some((name, text)) = registries.studies.iter().find(|(known, _)| *known == name) {
        return Study::parse(text, name);
    }
    let path = Path::new(name);
    if !path.is_file() {
        let known: Vec<&str> = registries.studies.iter().map(|(name, _)| *name).collect();
        let known = known.join(", ");
        bail!("there is no study `{name}`; known: {known}; or the file of a study (YAML)");
    }
    let text =
        files::read_argument_text(path, MAX_STUDY_FILE).with_context(|| format!("cannot read `{name}`"))?;
    Study::parse(&text, name)
}

/// The study with what the command line replaces.
fn adapted(args: &StudyArgs, registries: &Registries) -> Result<Study> {
    let name = args.study.as_deref().context("no study is named")?;
    let mut study = study(name, registries)?;
    for assignment in args.axes.assignments().iter().chain(&args.set) {
        study.set(assignment)?;
    }
    if let Some(drivers) = args.axes.drivers() {
        study.ego = drivers;
    }
    study.check()?;
    if let Some(search) = args.avoidable.options() {
        study.avoidable = Some(search);
    }
    if let Some(run) = &args.axes.tested {
        test_run(&mut study, run)?;
    }
    if args.axes.unattacked {
        study.measure.retain(|subject| *subject == Subject::Drive);
        study.metrics.retain(|subject, _| *subject == Subject::Drive);
    }
    // Against drivers, the drives under attack are what is asked for.
    let of_drives =
        [Subject::Drive, Subject::AttackedDrive, Subject::Search, Subject::Threshold, Subject::Transfer];
    let is_driven = of_drives.iter().any(|subject| study.measures(*subject));
    if !study.ego.is_empty() && !is_driven {
        study.measure.push(Subject::AttackedDrive);
        study.metrics.insert(Subject::AttackedDrive, ATTACKED.map(str::to_owned).to_vec());
    }
    Ok(study)
}

/// Tests another run than the one of the study. The paper's orderings are about its own run, so the same differences are
/// only said to be better or worse.
fn test_run(study: &mut Study, run: &str) -> Result<()> {
    let named: Vec<&str> = study.runs.iter().filter_map(|entry| Some(entry.split_once('=')?.0)).collect();
    if !named.contains(&run) {
        bail!("--tested names `{run}`, which is none of --runs: {}", named.join(", "));
    }
    for family in &mut study.report.tests {
        if family.tested != run {
            family.tested = run.to_owned();
            if !family.against.is_empty() {
                family.against.clear();
                family.title = "Other measures".to_owned();
                family.verdicts = ["better", "worse"].map(str::to_owned);
            }
        }
    }
    Ok(())
}

/// Metrics of attacks on drivers in a study that lists none.
const ATTACKED: [&str; 9] = [
    "attack",
    "at-fault attack",
    "solid attack",
    "any vehicle",
    "progress",
    "R_adv",
    "R_adv, path cut",
    "impact",
    "*",
];

/// Runs a study.
pub(crate) fn run(args: &StudyArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let study = adapted(args, registries)?;
    let out = args.folder.out.as_deref().context("--out names no folder")?;
    let plan = Plan::new(study, registries, &Weights(registries))?;
    plan.notes.iter().for_each(|note| progress::say_once(&format!("note: {note}")));
    let paths = [&args.paths[..], &args.data].concat();
    let procedural = args.procedural.unwrap_or(plan.study.procedural);
    if paths.is_empty() && procedural == 0 {
        bail!("name scenes, or a number of procedural ones with --procedural");
    }
    let all = Scenes::of(&paths, &args.split, procedural, plan.study.scene_seed)?;
    let scenes = if plan.needs_adversary() { all.attackable()? } else { all.known()? };
    let chosen =
        ChosenScenes::new(&scenes, args.shard.map(|shard| [shard.number, shard.of].map(|n| n as usize)));
    let identity = json!({
        "plan": plan.identity, "scenes": scenes.describe(), "names": chosen.names, "shard": chosen.shard,
        "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
    });
    let results = [report::PAGE, ROWS, report::ESTIMATES, STUDY_RECORD];
    let (run, state) = Run::start(out, identity, args.folder.force, &[WINDOWS], &[], &results)?;
    if state == RunState::Done {
        let (record, results) = read(out)?;
        let report = Report::new(&record.study, &results)?;
        output::print(&if args.wide { report.markdown() } else { report.terminal() })?;
        return Ok(crate::scenes::outcome_without(failed_scenes(&results)));
    }
    run.folder().inner(WINDOWS.as_ref())?;
    if plan.has_programs {
        plan.write_logs_to(&run.folder().inner(output::PLANNER_LOGS.as_ref())?);
    }
    let mut follow = Follow { progress: Progress::new("measured", chosen.names.len()), scenes: &scenes };
    let results = runner::run(&plan, &chosen, &Windows(run.folder()), &mut follow)?;
    let Follow { progress, .. } = follow;
    progress.finish(&format!(
        "{} on {}",
        count(plan.keys.len(), "method"),
        count(results.scenes.len(), "scene")
    ));
    let mut report = Report::new(&plan.study, &results)?;
    report.notes += &scenes.warnings_as_markdown();
    let record = StudyRecord::new(&plan.study, &results, chosen.shard);
    if plan.study.report.pictures {
        gallery::write(run.folder(), &plan, &chosen, &results, &report)?;
    }
    write(run.folder(), &report, &record)?;
    run.finish(&Value::Null, clock.elapsed().as_secs_f64())?;
    output::print(&if args.wide { report.markdown() } else { report.terminal() })?;
    let pictures = if plan.study.report.pictures { ", index.html with pictures" } else { "" };
    progress::say(&format!("{}, {STUDY_RECORD}{pictures} are in `{}`", files_of(&report), out.display()));
    Ok(scenes.outcome())
}

fn files_of(report: &Report) -> String {
    report.files.iter().map(|(name, _)| &name[..]).collect::<Vec<_>>().join(", ")
}

/// Writes the files of a report. The record goes last.
fn write(folder: &Folder, report: &Report, record: &StudyRecord) -> Result<()> {
    let page = format!("{}\n```text\n{}\n```\n", report.markdown(), output::command());
    for (name, text) in &report.files {
        let text = if name == report::PAGE { &page } else { text };
        folder.write(name, text.as_bytes())?;
    }
    folder.write(STUDY_RECORD, format!("{}\n", serde_json::to_string(record)?).as_bytes())
}

/// The results in a folder.
fn read(folder: &Path) -> Result<(StudyRecord, Results)> {
    let text = |name: &str| {
        let path = folder.join(name);
        files::read_text(&path, LIMIT).with_context(|| format!("cannot read `{}`", path.display()))
    };
    let within = |name: &str| format!("`{}`", folder.join(name).display());
    let record: StudyRecord =
        serde_json::from_str(&text(STUDY_RECORD)?).with_context(|| within(STUDY_RECORD))?;
    record.study.check().with_context(|| within(STUDY_RECORD))?;
    let results = report::read(&record, &text(ROWS)?).with_context(|| within(ROWS))?;
    Ok((record, results))
}

/// Renders the report of one or more folders again.
pub(crate) fn report(args: &ReportArgs, registries: &Registries) -> Result<Outcome> {
    let all = args.folders.iter().map(|folder| read(folder)).collect::<Result<Vec<_>>>()?;
    let missing = report::missing(all.iter().map(|(record, _)| record));
    if let Some([_, of]) = missing.first() {
        let numbers: Vec<String> = missing.iter().map(|[number, _]| number.to_string()).collect();
        progress::say(&format!("warning: shard {} of {of} is not among the folders", numbers.join(", ")));
    }
    let (record, results) = report::join(all)?;
    let study = match &args.study {
        Some(name) => study(name, registries)?,
        None => record.study.clone(),
    };
    let report = Report::new(&study, &results)?;
    let out = Folder::make(&args.folder.out, args.folder.force)?;
    write(&out, &report, &StudyRecord { study, ..record })?;
    output::print(&if args.wide { report.markdown() } else { report.terminal() })?;
    progress::say(&format!(
        "{} and {STUDY_RECORD} are in `{}`",
        files_of(&report),
        args.folder.out.display()
    ));
    Ok(crate::scenes::outcome_without(failed_scenes(&results)))
}

/// Number of scenes in which something failed.
fn failed_scenes(results: &Results) -> usize {
    results.cells.iter().filter(|cells| cells.iter().any(|cell| !cell.error.is_empty())).count()
}

/// Lists the shipped studies and all metrics.
pub(crate) fn list(registries: &Registries) -> Result<Outcome> {
    let mut out = "Studies:\n".to_owned();
    for (name, text) in &registries.studies {
        let line = format!("  {name:<12} {}", Study::parse(text, name)?.summary);
        out += &format!("{}\n", wrapped(&line, 15));
    }
    let metrics = &registries.metrics;
    let mut table = |subject: &str, infos: Vec<&sage_core::metric::MetricInfo>| {
        out += &format!("\nMetrics of {subject}:\n");
        for info in infos {
            let unit = if info.unit.is_empty() { String::new() } else { format!(" ({})", info.unit) };
            let line = format!("  {:<28} {}", format!("{}{unit}", info.name), info.summary);
            out += &format!("{}\n", wrapped(&line, 31));
        }
    };
    table("a trajectory", metrics.trajectory.all().iter().map(|m| &m.info).collect());
    table("a trajectory, with a search", metrics.avoidable.all().iter().map(|m| &m.info).collect());
    table("a policy without selection", metrics.policy.all().iter().map(|m| &m.info).collect());
    table("a drive", metrics.drive.all().iter().map(|m| &m.info).collect());
    table("an attacked drive", metrics.attack.all().iter().map(|m| &m.info).collect());
    table("an episode", metrics.episode.all().iter().map(|m| &m.info).collect());
    table("a prediction", metrics.prediction.all().iter().map(|m| &m.info).collect());
    table("a search", metrics.search.all().iter().map(|m| &m.info).collect());
    table("a threshold", metrics.threshold.all().iter().map(|m| &m.info).collect());
    out += "\nEvery registered reward and rule (`sage list`) is a metric of a trajectory too.\n";
    output::print(&out)?;
    Ok(Outcome::Done)
}

/// Experts by the names that commands accept.
struct Weights<'r>(&'r Registries);

impl ExpertSource for Weights<'_> {
    fn network(&self, name: &str) -> Result<Arc<dyn Backbone>> {
        Ok(networks::load(&self.0.backbones, name)?.network.into())
    }

    fn experts(&self, name: &str) -> Result<ExpertSet> {
        networks::load_experts(&self.0.backbones, name)
    }

    fn dial(
        &self,
        name: &str,
        experts: &ExpertSet,
        selection: &Selection,
        merger: &str,
    ) -> Result<Aggression> {
        networks::load_dial(name, experts, selection, merger)
    }
}

/// Some of the scenes of a list, with names that are unique in results.
struct ChosenScenes<'s> {
    scenes: &'s Scenes,
    numbers: Vec<usize>,
    names: Vec<String>,
    shard: Option<[usize; 2]>,
}

impl<'s> ChosenScenes<'s> {
    fn new(scenes: &'s Scenes, shard: Option<[usize; 2]>) -> Self {
        let paths = scenes.names();
        let short = |path: &String| input::scene_name(Path::new(path)).unwrap_or_else(|_| path.clone());
        let short: Vec<String> = paths.iter().map(short).collect();
        let mut counts: HashMap<&str, usize> = HashMap::new();
        short.iter().for_each(|name| *counts.entry(name).or_default() += 1);
        let is_chosen = |k: &usize| shard.is_none_or(|[number, of]| k % of == number - 1);
        let numbers: Vec<usize> = (0..paths.len()).filter(is_chosen).collect();
        let name = |k: &usize| match counts[&short[*k][..]] {
            1 => short[*k].clone(),
            _ => sage_data::folder::name_apart(&short[*k], Path::new(&paths[*k])),
        };
        let names = numbers.iter().map(name).collect();
        Self { scenes, numbers, names, shard }
    }
}

impl SceneSource for ChosenScenes<'_> {
    fn names(&self) -> Vec<String> {
        self.names.clone()
    }

    fn load(&self, number: usize) -> Result<Option<Arc<SceneData>>> {
        self.scenes.load(self.numbers[number])
    }
}

/// Windows of results in the folder of a run.
struct Windows<'f>(&'f Folder);

impl Store for Windows<'_> {
    fn read(&self, window: usize) -> Option<String> {
        files::read_text(&self.0.path().join(WINDOWS).join(format!("{window:06}.json")), LIMIT).ok()
    }

    fn write(&self, window: usize, text: &str) -> Result<()> {
        self.0.write(&format!("{WINDOWS}/{window:06}.json"), text.as_bytes())
    }
}

/// Shows progress, and names what fails.
struct Follow<'s> {
    progress: Progress,
    scenes: &'s Scenes,
}

impl Observer for Follow<'_> {
    fn done(&mut self, before: bool) {
        if before { self.progress.step_found() } else { self.progress.step() }
    }

    fn failed(&mut self, scene: &str, what: &str, error: &str) {
        let error = if what.is_empty() { error.to_owned() } else { format!("{what}: {error}") };
        self.scenes.fail(scene, &anyhow::anyhow!(error));
    }

    fn left_out(&mut self, scene: &str, reason: &str) {
        self.progress.say(&format!("left out: `{scene}`: {reason}"));
    }
}
