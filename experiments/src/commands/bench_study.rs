//! `sage bench STUDY`: runs a study; `sage bench report`: renders it again; `sage bench list`.

mod chosen_study;
mod gallery;
mod measured;

use std::{path::Path, sync::Arc};

use advsage::{selection::Selection, weights::NamedNetwork};
use anyhow::{Context as _, Result, anyhow, bail};
use sage_backbones::Backbone;
use sage_bench::{
    chart::learning::{self, CURVES},
    measure::ExpertSource,
    prepared_study::{self, PreparedStudy},
    report::{self, RECORD as STUDY_RECORD, ROWS, Report, StudyRecord},
    rows::{Results, Subject},
    runner::{self, Observer},
    study::Study,
};
use sage_core::{files, text::wrap::wrapped};
use sage_generators::Aggression;
use sage_merging::ExpertSet;
use sage_run::{
    Error, Outcome, networks,
    output::{
        self, Counts, DatasetRun, Ended, Extent, Folder, Inputs, MANIFEST, Producer, SceneRecord, ShardState,
    },
    printing,
    progress::{self, Progress, count},
    scenes::Scenes,
};
use serde::Serialize;
use serde_json::json;

use crate::{
    Registries,
    cli::{ReportArgs, StudyArgs},
};
use chosen_study::{adapted, study};
use measured::{ChosenScenes, RESULTS, StoredResults, described, records, result_file, short_names};

/// Files of every finished study.
const REPORT_FILES: [&str; 5] = [report::PAGE, ROWS, report::ESTIMATES, STUDY_RECORD, MANIFEST];
/// Size limit of a stored result, and of files that a run wrote, bytes.
const LIMIT: u64 = 1 << 30;

/// What identifies a run.
#[derive(Serialize)]
struct Identity<'a> {
    plan: &'a prepared_study::Identity,
    scenes: String,
    #[serde(flatten)]
    by: Producer,
}

/// A study with its scenes.
struct Job<'a> {
    args: &'a StudyArgs,
    extent: Extent,
    prepared: PreparedStudy,
    scenes: Scenes,
    /// Files and short names of all scenes, in their order.
    paths: Vec<String>,
    names: Vec<String>,
    /// Numbers of the scenes that this part measures.
    own: Vec<usize>,
}

/// Runs a study.
pub(crate) fn run(args: &StudyArgs, extent: Extent, registries: &Registries) -> Result<Outcome> {
    let out = args.folder.out.as_deref().context("--out names no folder")?;
    let job = Job::new(args, extent, registries)?;
    let run = job.start(out)?;
    if run.is_done() {
        return match extent {
            Extent::Whole | Extent::Join => show_again(args, &run, &job.scenes, out),
            Extent::Shard(_) => Ok(job.scenes.outcome()),
        };
    }
    let all_names: Vec<&str> = job.names.iter().map(String::as_str).collect();
    run.agree_on_scenes(&all_names)?;
    let shards = if extent == Extent::Join { run.joined(&all_names)?.1 } else { Vec::new() };
    let chosen = ChosenScenes::new(&job.scenes, &job.names);
    let results = job.measure(&run, &chosen)?;
    match extent {
        Extent::Shard(shard) => run.finish_shard(shard, &job.shard_records(run.folder())?)?,
        Extent::Whole | Extent::Join => job.report(run, &chosen, &results, &shards)?,
    }
    Ok(job.scenes.outcome())
}

impl<'a> Job<'a> {
    /// Plans the study and lists its scenes.
    ///
    /// *Errors*: a study that cannot be planned; no scenes.
    fn new(args: &'a StudyArgs, extent: Extent, registries: &Registries) -> Result<Self> {
        let prepared = PreparedStudy::new(adapted(args, registries)?, registries, &Weights(registries))?;
        prepared.notes.iter().for_each(|note| progress::say_once(&format!("note: {note}")));
        let paths = [&args.paths[..], &args.data].concat();
        let procedural = args.procedural.unwrap_or(prepared.study.procedural);
        if paths.is_empty() && procedural == 0 {
            bail!("name scenes, or a number of procedural ones with --procedural");
        }
        let all = Scenes::of(&paths, &args.split.filter(), procedural, prepared.study.scene_seed)?;
        let paths = all.names();
        let names = short_names(&paths);
        let own: Vec<usize> = (0..names.len()).filter(|number| is_own(extent, &names[*number])).collect();
        let scenes = all.only(|number| own.binary_search(&number).is_ok());
        let scenes = match (prepared.needs_adversary(), extent) {
            _ if own.is_empty() => scenes,
            (needs_adversary, Extent::Shard(_)) => scenes.some(needs_adversary)?,
            (true, _) => scenes.attackable()?,
            (false, _) => scenes.only_readable()?,
        };
        Ok(Self { args, extent, prepared, scenes, paths, names, own })
    }

    fn start(&self, out: &Path) -> Result<DatasetRun> {
        let identity =
            Identity { plan: &self.prepared.identity, scenes: described(&self.names), by: Producer::own() };
        Inputs::of_command_line().refuse_folder(out)?;
        let outdated = || vec![RESULTS.to_owned(), MANIFEST.to_owned()];
        let (identity, force) = (serde_json::to_value(identity)?, self.args.folder.force);
        Ok(DatasetRun::start(out, identity, force, self.extent, &REPORT_FILES, outdated)?)
    }

    /// Measures what no earlier run did.
    fn measure(&self, run: &DatasetRun, chosen: &ChosenScenes) -> Result<Results> {
        run.folder().inner(RESULTS.as_ref())?;
        if self.prepared.has_programs && self.extent != Extent::Join {
            self.prepared.write_logs_to(&output::log_folder(run.folder(), self.extent)?);
        }
        let progress = Progress::new("measured", chosen.names.len());
        let mut follow = Follow { progress, scenes: &self.scenes };
        let store = StoredResults { folder: run.folder(), scenes: &self.scenes };
        let results = runner::run(&self.prepared, chosen, &store, &mut follow)?;
        let [methods, scenes] =
            [count(self.prepared.keys.len(), "method"), count(results.scenes.len(), "scene")];
        follow.progress.finish(&format!("{methods} on {scenes}"));
        Ok(results)
    }

    fn records(&self) -> Vec<SceneRecord> {
        records(&self.scenes, &self.own, &self.paths, &self.names)
    }

    /// Records of the scenes of a shard, with their results.
    fn shard_records(&self, folder: &Folder) -> Result<Vec<SceneRecord>> {
        let stored = |(record, number): (SceneRecord, &usize)| -> Result<SceneRecord> {
            let file = format!("{RESULTS}/{}", result_file(*number));
            let is_there = folder.path().join(&file).is_file();
            Ok(record.with_files(folder.path(), is_there.then_some(&*file))?)
        };
        self.records().into_iter().zip(&self.own).map(stored).collect()
    }

    /// Writes and prints the report.
    ///
    /// *Errors*: nothing could be measured; a file that cannot be written.
    fn report(
        &self,
        run: DatasetRun,
        chosen: &ChosenScenes,
        results: &Results,
        shards: &[ShardState],
    ) -> Result<()> {
        if !results.cells.iter().flatten().any(|cell| cell.error.is_empty()) {
            let problem = format!("nothing could be measured in any of {} scenes", chosen.names.len());
            return Err(Error::BadScenes(Box::new(Error::Refused(problem))).into());
        }
        let study = &self.prepared.study;
        let mut report = Report::new(study, results)?;
        report.notes += &self.scenes.warnings_as_markdown();
        report.files.extend(learning::charts(&curves_of(study)?)?);
        if study.report.pictures {
            gallery::write(run.folder(), &self.prepared, chosen, results, &report)?;
        }
        write(run.folder(), &report, &StudyRecord::new(study, results))?;
        let records = self.records();
        // A scene that is bad stays so; what the system refused is tried again.
        let is_done = Counts::of(&records).retry == 0;
        run.finish(Ended {
            records: &records,
            shards,
            results: json!({"contents": self.scenes.describe()}),
            seconds_per_attack: None,
            has_pickles: false,
            is_done,
        })?;
        if is_done {
            run.folder().remove(RESULTS)?;
        }
        output::print(&if self.args.wide { report.markdown() } else { report.terminal() })?;
        if study.measures(Subject::Drive) {
            printing::print_step_times(self.prepared.step_times());
        }
        let pictures = if study.report.pictures { ", index.html with pictures" } else { "" };
        let out = run.folder().path().display();
        progress::say(&format!("{}, {STUDY_RECORD}{pictures} are in `{out}`", files_of(&report)));
        Ok(())
    }
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
fn is_own(extent: Extent, name: &str) -> bool {
    extent == Extent::Join || extent.holds(name)
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
    Ok(folder.write(STUDY_RECORD, format!("{}\n", serde_json::to_string(record)?).as_bytes())?)
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
    out.finish()?;
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
    fn network(&self, name: &str) -> advsage::Result<Arc<dyn Backbone>> {
        Ok(NamedNetwork::load(&self.0.parts.backbones, name)?.network.into())
    }

    fn experts(&self, name: &str) -> advsage::Result<ExpertSet> {
        networks::load_experts(&self.0.parts.backbones, name)
    }

    fn dial(
        &self,
        name: &str,
        experts: &ExpertSet,
        selection: &Selection,
        merger: &str,
    ) -> advsage::Result<Aggression> {
        networks::load_dial(name, experts, selection, merger)
    }
}

/// Shows progress, and names what fails.
struct Follow<'s> {
    progress: Progress,
    scenes: &'s Scenes,
}

impl Observer<anyhow::Error> for Follow<'_> {
    fn done(&mut self, before: bool) {
        if before { self.progress.step_found() } else { self.progress.step() }
    }

    fn failed(&mut self, scene: &str, what: &str, error: &anyhow::Error) {
        match what.is_empty() {
            true => self.scenes.fail(scene, error.as_ref()),
            false => self.scenes.fail(scene, anyhow!("{what}: {error}").as_ref()),
        }
    }

    fn left_out(&mut self, scene: &str, reason: &str) {
        self.progress.say(&format!("left out: `{scene}`: {reason}"));
    }
}
