//! Rows of `sage generate` as scenes: each with the scene that it attacks.

use std::{
    collections::{BTreeMap, HashSet},
    path::{Path, PathBuf},
};

use advsage::{
    attacked_files::{Attack, AttackFormats, AttackSummary, AttackedFiles},
    rows::{
        ROW_LIMIT,
        attack::{AttackRow, LeftOutRow},
    },
};
use anyhow::{Context as _, Result, anyhow, bail, ensure};
use sage_core::{
    files::{self, Existing},
    text::natural_order,
};
use sage_data::{Format, ReadOptions, Recording, openscenario::Options};
use sage_run::{
    Outcome,
    output::{self, Counts, DatasetRun, Ended, Extent, MANIFEST, Producer, RECORD},
    progress,
    scene_queue::{self, Failure, Input, Report, ReportWords, SceneReport, Scenes, Worked},
};
use serde::Serialize;
use serde_json::json;

use crate::cli::ConvertArgs;

/// The folder of a run of `sage generate`.
struct Source {
    /// Its command, which goes into the scenes.
    command: String,
    weights: Option<String>,
    /// Hash of the run, with which its rows begin.
    run: String,
    /// Files of the rows of each scene.
    rows: BTreeMap<String, Vec<PathBuf>>,
}

/// What identifies a conversion.
#[derive(Serialize)]
struct Identity<'a> {
    convert: &'static str,
    /// Hash of the run that the rows are of.
    rows: &'a str,
    scenes: String,
    standard: &'static str,
    ego: &'static str,
    reading: Option<ReadOptions>,
    #[serde(flatten)]
    by: Producer,
}

/// The error of inputs that are no scenes, with what helps if they are rows.
pub(super) fn explained(error: anyhow::Error, paths: &[PathBuf]) -> anyhow::Error {
    let has_rows = |path: &&PathBuf| {
        output::record_of(path).ok().flatten().is_some_and(|record| record["run"]["variants"].is_array())
    };
    match paths.iter().find(has_rows) {
        Some(path) => error.context(format!(
            "`{}` holds rows of `sage generate`; name the scenes that they attack with --of",
            path.display()
        )),
        None => error,
    }
}

/// Converts the rows of a folder, with the scenes that they attack.
pub(super) fn run(args: &ConvertArgs, of: &Path, extent: Extent) -> Result<Outcome> {
    let [path] = &args.paths[..] else { bail!("with --of, name one folder of rows, or one row") };
    if args.to == Format::TfRecord {
        bail!("rows become scene files first: convert --to native, and the result --to womd");
    }
    let source = Source::read(path)?;
    let scenes = Scenes::find(of, &args.reading.options())?.only(|name| source.rows.contains_key(name));
    let names: HashSet<&str> = scenes.names().into_iter().collect();
    if let Some(missing) = source.rows.keys().find(|name| !names.contains(&***name)) {
        bail!(
            "no scene in `{}` has the name `{missing}`, of which `{}` has rows",
            of.display(),
            path.display()
        );
    }
    let out = &args.folder.out;
    scenes.protect(out, vec![path.clone()])?;
    let identity = serde_json::to_value(Identity {
        convert: args.to.ending(),
        rows: &source.run,
        scenes: names_hash(&scenes.names()),
        standard: args.standard.unwrap_or_default().name(),
        ego: args.ego.unwrap_or_default().name(),
        reading: output::reading_identity(args.reading.options()),
        by: Producer::own(),
    })?;
    let outdated = || vec![MANIFEST.to_owned()];
    let run = DatasetRun::start(out, identity, args.folder.force, extent, &[MANIFEST], outdated)?;
    let report = |count| {
        Report::new(run.folder().path(), false, count, ReportWords { done: "converted", result: "scene" })
    };
    let worked = Worked::on(&scenes, extent, &run, report, |input| source.convert(args, &run, input))?;
    let records = &worked.records;
    match extent {
        Extent::Shard(shard) => run.finish_shard(shard, records)?,
        Extent::Whole | Extent::Join => drop(run.finish(Ended {
            records,
            shards: &worked.shards,
            results: scene_queue::results(records),
            seconds_per_attack: None,
            has_pickles: args.to == Format::Pickle,
            is_done: Counts::of(records).failure_count() == 0,
        })?),
    }
    Ok(scene_queue::outcome(records, extent, out, "converted", scene_queue::AGAIN))
}

/// Hash of the names of scenes.
fn names_hash(names: &[&str]) -> String {
    blake3::hash(json!(names).to_string().as_bytes()).to_hex()[..16].to_owned()
}

impl Source {
    /// Reads what a folder of rows says of its run, and lists the rows by scene.
    ///
    /// *Errors*: it is no output of `sage generate`.
    fn read(path: &Path) -> Result<Self> {
        let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) };
        let record = output::record_of(folder)?.filter(|record| record["run"]["variants"].is_array());
        let record = record.with_context(|| {
            format!("`{}` is no output of `sage generate`: it has no such `{RECORD}`", folder.display())
        })?;
        if record["results"].is_null() {
            progress::say(&format!("note: the run in `{}` is not complete", folder.display()));
        }
        let run_hash = output::run_hash(&record["run"]);
        let variants: Vec<String> = serde_json::from_value(record["run"]["variants"].clone())?;
        let mut files = vec![path.to_owned()];
        if path.is_dir() {
            let entries =
                std::fs::read_dir(path).with_context(|| format!("cannot read `{}`", path.display()))?;
            files = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
            files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
        }
        let mut rows: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
        for file in files {
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let scene = |variant: &String| name.strip_suffix(&format!("-{variant}.json"));
            if let Some(scene) = variants.iter().find_map(scene) {
                rows.entry(scene.to_owned()).or_default().push(file);
            }
        }
        ensure!(!rows.is_empty(), "`{}` has no rows of its run", path.display());
        let name = record["run"]["weights"].as_object().and_then(|weights| weights.keys().next().cloned());
        let command = record["command"].as_str().unwrap_or_default().to_owned();
        Ok(Self { command, weights: name, run: run_hash, rows })
    }

    /// Converts the rows of a scene.
    ///
    /// *Errors*: [`Failure`].
    fn convert(
        &self,
        args: &ConvertArgs,
        run: &DatasetRun,
        input: &Input,
    ) -> Result<SceneReport, Failure<anyhow::Error>> {
        let files = self.attacked(args, run, input).map_err(Failure::Scene)?;
        if files.is_empty() {
            let reason = "its rows say that it is left out".to_owned();
            return Err(Failure::LeftOut { reason, lines: Vec::new() });
        }
        let (lines, warnings, failures) = (Vec::new(), Vec::new(), Vec::new());
        Ok(SceneReport { lines, files, seconds: Some(0.0), warnings, failures })
    }

    /// Writes the attacked scenes of all rows of a scene.
    fn attacked(&self, args: &ConvertArgs, run: &DatasetRun, input: &Input) -> Result<Vec<String>> {
        let bytes = sage_data::read_bytes(&input.file)?;
        let hash = args.reading.options().source_hash(&bytes);
        let mut recording = Recording::from_bytes_as(&input.file, bytes, &args.reading.options())?;
        let scenario = Options {
            standard: args.standard.unwrap_or_default(),
            ego: args.ego.unwrap_or_default(),
            license: None,
        };
        let formats = args.to.name().parse::<AttackFormats>().map_err(anyhow::Error::msg)?;
        let mut writer = None;
        let mut names = Vec::new();
        for file in self.rows.get(&input.scene).into_iter().flatten() {
            let in_row = || format!("`{}`", file.display());
            // Rows of another run remain after --force with fewer scenes.
            if !scene_queue::is_row_of(file, &self.run) {
                continue;
            }
            let Some(row) = read_row(file).with_context(in_row)? else { continue };
            ensure!(
                hash.starts_with(&row.source_hash) && row.scene == input.scene,
                "`{}` is not the scene that {} attacks: its hash is another, or its --ego-track",
                input.file.display(),
                in_row()
            );
            let writer = match &mut writer {
                Some(writer) => writer,
                none => {
                    // All rows of a run have the same adversary.
                    if let Some(placed) = &row.generated.placed {
                        recording = placed.of(recording)?;
                    }
                    none.insert(AttackedFiles::new(&recording, &input.scene, formats, scenario.clone())?)
                }
            };
            let recorded = recording.scene.adversary().is_ok_and(|track| track.id == row.adversary);
            let scene = recording.scene.clone().with_roles(None, (!recorded).then_some(&*row.adversary))?;
            let attack = Attack {
                trajectory: &row.trajectory,
                variant: &row.variant,
                generated: &row.generated,
                weights: self.weights.as_deref(),
                seed: row.seed,
                command: &self.command,
            };
            let mut written = writer.files(&scene, &attack)?;
            if let Some(scenarios) = writer.scenarios(&scene) {
                written.extend(writer.scenario(
                    &scenarios,
                    &scene,
                    &attack,
                    &summary(&row).and(&row.generated),
                )?);
            }
            for (name, bytes) in &written {
                let path = run.folder().path().join(name);
                files::write(&path, bytes, Existing::Replace)
                    .with_context(|| format!("cannot write `{}`", path.display()))?;
            }
            names.extend(written.into_iter().map(|(name, _)| name));
        }
        Ok(names)
    }
}

/// Reads a row; `None` if it says that its scene is left out.
///
/// *Errors*: it is none, or attacks a drive that its scene does not hold.
fn read_row(file: &Path) -> Result<Option<AttackRow>> {
    let bytes = files::read(file, ROW_LIMIT)?;
    let row: AttackRow = match serde_json::from_slice(&bytes) {
        Ok(row) => row,
        Err(_) if serde_json::from_slice::<LeftOutRow>(&bytes).is_ok() => return Ok(None),
        Err(error) => return Err(error).context("it is no row of `sage generate`"),
    };
    if let Some(ego) = &row.generated.ego {
        return Err(anyhow!(
            "it attacks a drive of {ego:?}, which its scene does not hold; attack again with --format pickle"
        ));
    }
    Ok(Some(row))
}

/// What an OpenSCENARIO file says about an attack.
fn summary(row: &AttackRow) -> AttackSummary<'_> {
    let scores = &row.scores.scores;
    AttackSummary {
        seed: row.seed,
        adversary: &row.adversary,
        feasible: row.feasible,
        collision_step: scores.collision_step,
        adversarial_reward: scores.adversarial_reward,
        kinematic_penalty: scores.kinematic_penalty,
        behavior_penalty: scores.behavior_penalty,
    }
}
