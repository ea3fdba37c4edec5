//! `sage bench STUDY`: runs a study; `sage bench report`: renders it again; `sage bench list`.

mod gallery;
mod measured;

use std::{path::Path, sync::Arc};

use advsage::selection::Selection;
use anyhow::{Context as _, Result, anyhow, bail};
use sage_backbones::Backbone;
use sage_bench::{
    chart::learning::{self, CURVES},
    measure::ExpertSource,
    plan::Plan,
    report::{self, RECORD as STUDY_RECORD, ROWS, Report, StudyRecord},
    rows::{Results, Subject},
    runner::{self, Observer},
    study::{MAX_STUDY_FILE, Study},
};
use sage_core::{files, text::wrap::wrapped};
use sage_generators::Aggression;
use sage_merging::ExpertSet;
use sage_run::{
    Outcome, networks,
    outcome::EndsWith,
    output::{self, Counts, DatasetRun, Ended, Folder, Inputs, MANIFEST, Part, SceneRecord},
    progress::{self, Progress, count},
    scenes::Scenes,
};
use serde_json::json;

use crate::{
    Registries,
    cli::{ReportArgs, StudyArgs},
};
use measured::{ChosenScenes, RESULTS, StoredResults, described, records, result_file, short_names};

/// Files of every finished study.
const REPORT_FILES: [&str; 5] = [report::PAGE, ROWS, report::ESTIMATES, STUDY_RECORD, MANIFEST];
/// Size limit of a stored result, and of files that a run wrote, bytes.
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
        if study.measures(Subject::Episode) {
            study.method.clear();
        }
        let has_unattacked = |subject: &Subject| matches!(subject, Subject::Drive | Subject::Episode);
        study.measure.retain(has_unattacked);
        study.metrics.retain(|subject, _| has_unattacked(subject));
        if study.measure.is_empty() {
            bail!(
                "--unattacked: study `{}` measures no drive without an attack; `drivers` does",
                study.study
            );
        }
    }
    // Against drivers, the drives under attack are what is asked for.
    let of_drives = [
        Subject::Drive,
        Subject::Episode,
        Subject::AttackedDrive,
        Subject::Search,
        Subject::Threshold,
        Subject::Transfer,
    ];
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
pub(crate) fn run(args: &StudyArgs, part: Part, registries: &Registries) -> Result<Outcome> {
    let study = adapted(args, registries)?;
    let out = args.folder.out.as_deref().context("--out names no folder")?;
    let plan = Plan::new(study, registries, &Weights(registries))?;
    plan.notes.iter().for_each(|note| progress::say_once(&format!("note: {note}")));
    let paths = [&args.paths[..], &args.data].concat();
    let procedural = args.procedural.unwrap_or(plan.study.procedural);
    if paths.is_empty() && procedural == 0 {
        bail!("name scenes, or a number of procedural ones with --procedural");
    }
    let all = Scenes::of(&paths, &args.split.filter(), procedural, plan.study.scene_seed)?;
    let paths = all.names();
    let names = short_names(&paths);
    let own: Vec<usize> = (0..names.len()).filter(|number| is_own(part, &names[*number])).collect();
    let scenes = all.only(|number| own.binary_search(&number).is_ok());
    let scenes = match (plan.needs_adversary(), part) {
        _ if own.is_empty() => scenes,
        (needs_adversary, Part::Shard(_)) => scenes.some(needs_adversary)?,
        (true, _) => scenes.attackable()?,
        (false, _) => scenes.known()?,
    };
    let chosen = ChosenScenes::new(&scenes, &names);
    let identity = json!({
        "plan": plan.identity, "scenes": described(&names),
        "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
    });
    Inputs::of_command_line().refuse_folder(out)?;
    let outdated = || vec![RESULTS.to_owned(), MANIFEST.to_owned()];
    let run = DatasetRun::start(out, identity, args.folder.force, part, &REPORT_FILES, outdated)?;
    if run.is_done() {
        return match part {
            Part::Whole | Part::Join => show_again(args, &run, &scenes, out),
            Part::Shard(_) => Ok(scenes.outcome()),
        };
    }
    let all_names: Vec<&str> = names.iter().map(String::as_str).collect();
    run.agree_on_scenes(&all_names)?;
    let shards = if part == Part::Join { run.joined(&all_names)?.1 } else { Vec::new() };
    run.folder().inner(RESULTS.as_ref())?;
    if plan.has_programs && part != Part::Join {
        plan.write_logs_to(&output::log_folder(run.folder(), part)?);
    }
    let mut follow = Follow { progress: Progress::new("measured", chosen.names.len()), scenes: &scenes };
    let store = StoredResults { folder: run.folder(), scenes: &scenes };
    let results = runner::run(&plan, &chosen, &store, &mut follow)?;
    let Follow { progress, .. } = follow;
    progress.finish(&format!(
        "{} on {}",
        count(plan.keys.len(), "method"),
        count(results.scenes.len(), "scene")
    ));
    let records = records(&scenes, &own, [&paths, &names]);
    if let Part::Shard(shard) = part {
        let stored = |record: SceneRecord, number: &usize| -> Result<SceneRecord> {
            let file = format!("{RESULTS}/{}", result_file(*number));
            let is_there = run.folder().path().join(&file).is_file();
            record.with_files(run.folder().path(), is_there.then_some(&*file))
        };
        let records = records.into_iter().zip(&own).map(|(record, number)| stored(record, number));
        run.finish_shard(shard, &records.collect::<Result<Vec<_>>>()?)?;
        return Ok(scenes.outcome());
    }
    if !results.cells.iter().flatten().any(|cell| cell.error.is_empty()) {
        let error = anyhow!("nothing could be measured in any of {} scenes", chosen.names.len());
        return Err(EndsWith(Outcome::BadScenes, error).into());
    }
    let mut report = Report::new(&plan.study, &results)?;
    report.notes += &scenes.warnings_as_markdown();
    report.files.extend(learning::charts(&curves_of(&plan.study)?)?);
    let record = StudyRecord::new(&plan.study, &results);
    if plan.study.report.pictures {
        gallery::write(run.folder(), &plan, &chosen, &results, &report)?;
    }
    write(run.folder(), &report, &record)?;
    // A scene that is bad stays so; what the system refused is tried again.
    let is_done = Counts::of(&records).retry == 0;
    run.finish(Ended {
        records: &records,
        shards: &shards,
        results: json!({"contents": scenes.describe()}),
        seconds_per_attack: None,
        has_pickles: false,
        is_done,
    })?;
    if is_done {
        run.folder().remove(RESULTS)?;
    }
    output::print(&if args.wide { report.markdown() } else { report.terminal() })?;
    let pictures = if plan.study.report.pictures { ", index.html with pictures" } else { "" };
    progress::say(&format!("{}, {STUDY_RECORD}{pictures} are in `{}`", files_of(&report), out.display()));
    Ok(scenes.outcome())
}

/// The learning curves of the trainings of a study that have them: names and texts.
fn curves_of(study: &Study) -> Result<Vec<(String, String)>> {
    let runs = study.runs.iter().filter_map(|entry| entry.split_once('='));
    let files = runs.map(|(name, folder)| (name, Path::new(folder).join(CURVES)));
    let there = files.filter(|(_, file)| file.is_file());
    let read = |(name, file): (&str, std::path::PathBuf)| {
        let text =
            files::read_text(&file, LIMIT).with_context(|| format!("cannot read `{}`", file.display()))?;
        Ok((name.to_owned(), text))
    };
    there.map(read).collect()
}

/// True if a part measures a scene. The join reads all, to report on them.
fn is_own(part: Part, name: &str) -> bool {
    part == Part::Join || part.holds(name)
}

/// Shows the report of a finished run.
///
/// *Errors*: the scenes are others now, or the folder cannot be read.
fn show_again(args: &StudyArgs, run: &DatasetRun, scenes: &Scenes, out: &Path) -> Result<Outcome> {
    if run.recorded_results()["contents"] != scenes.describe() {
        bail!(
            "`{}` holds this run of scenes with another content; give --force to measure again, or name another --out",
            out.display()
        );
    }
    // The run may have been killed before it removed them.
    run.folder().remove(RESULTS)?;
    run.remove_shards()?;
    let (record, results) = read(out)?;
    let report = Report::new(&record.study, &results)?;
    output::print(&if args.wide { report.markdown() } else { report.terminal() })?;
    let failed = sage_run::scenes::outcome_without(failed_scenes(&results));
    Ok(if failed == Outcome::Done { scenes.outcome() } else { failed })
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
    Ok(sage_run::scenes::outcome_without(failed_scenes(&results)))
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
        Ok(networks::load(&self.0.parts.backbones, name)?.network.into())
    }

    fn experts(&self, name: &str) -> Result<ExpertSet> {
        networks::load_experts(&self.0.parts.backbones, name)
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

/// Shows progress, and names what fails.
struct Follow<'s> {
    progress: Progress,
    scenes: &'s Scenes,
}

impl Observer for Follow<'_> {
    fn done(&mut self, before: bool) {
        if before { self.progress.step_found() } else { self.progress.step() }
    }

    fn failed(&mut self, scene: &str, what: &str, error: &anyhow::Error) {
        match what.is_empty() {
            true => self.scenes.fail(scene, error),
            false => self.scenes.fail(scene, &anyhow!("{what}: {error}")),
        }
    }

    fn left_out(&mut self, scene: &str, reason: &str) {
        self.progress.say(&format!("left out: `{scene}`: {reason}"));
    }
}
