//! The work of `sage generate`: writes adversarial variants of scenes as a data set.

mod attack;
mod index;
mod job;
mod measured;
mod names;
mod options;
mod scored;
mod summary;
mod view;

use std::path::{Path, PathBuf};

use advsage::{Registries, attacked_files::names_of_file, rows::attack::AttackRow};
use rayon::prelude::*;
use sage_data::Format;

use crate::{
    Outcome, Result,
    output::{self, Counts, DatasetRun, Ended, Extent, MANIFEST, SceneRecord, State},
    printing, progress,
    scene_queue::{self, Input, Report, ReportWords, Scenes, Worked, is_row_of, work_on},
};

pub use options::GenerateOptions;

use job::Job;
use names::{INDEX, page_file, picture_file, row_file};
use summary::Tally;

/// Attacks the scenes of a part of a run.
///
/// *Errors*: wrong options; the folder is of another run, or cannot be written to. What is wrong with a scene ends only that scene.
pub fn run(options: &GenerateOptions, extent: Extent, registries: &Registries) -> Result<Outcome> {
    let job = Job::new(options, registries)?;
    let scenes = Scenes::find(&options.scene, &options.reading)?;
    let (all, own) = (&scenes.all, scenes.of_part(extent));
    scenes.protect(&options.out, Vec::new())?;
    let out = &options.out;
    let outdated = || {
        let of_scenes = own.iter().flat_map(|input| outputs(&job, out, input));
        of_scenes.chain([INDEX, MANIFEST].map(str::to_owned)).collect()
    };
    let run = DatasetRun::start(out, job.identity()?, options.force, extent, &[MANIFEST], outdated)?;
    output::keep_planner_logs(run.folder(), extent, std::slice::from_ref(&job.ego))?;
    let report = |count| {
        let report = Report::new(
            run.folder().path(),
            options.json,
            count,
            ReportWords { done: "attacked", result: "attempt" },
        );
        if options.quiet { report.quiet() } else { report }
    };
    let worked = Worked::on(&scenes, extent, &run, report, |input| work_on(&job, &run, input))?;
    let (records, folder, hash) = (&worked.records, run.folder().path().to_owned(), run.hash().to_owned());
    let has_any = Counts::of(records).done > 0;
    match extent {
        Extent::Shard(shard) => run.finish_shard(shard, records)?,
        Extent::Whole | Extent::Join => {
            let has_page = |record: &SceneRecord| folder.join(page_file(&record.scene)).is_file();
            let mut done = records.iter().filter(|record| record.state == State::Done);
            // Shards with --no-pages and others may be joined.
            if has_any && !options.no_pages && done.all(has_page) {
                index::write(&job, run.folder(), &hash, all)?;
            }
            let listed = run.finish(Ended {
                records,
                shards: &worked.shards,
                results: scene_queue::results(records),
                seconds_per_attack: worked.median_seconds(),
                has_pickles: job.options.format.has(Format::Pickle),
                is_done: Counts::of(records).failure_count() == 0,
            })?;
            note_others(out, listed.saturating_sub(all.len() * job.variants().len()), records);
        }
    }
    if has_any {
        print_table(&job, &folder, &hash, &scenes.reported_by(extent), options.json)?;
        if out.join(INDEX).is_file() {
            progress::say(&format!("to look at the attacks, open `{}`", out.join(INDEX).display()));
        }
    }
    Ok(scene_queue::outcome(records, extent, out, "attacked", scene_queue::AGAIN))
}

/// Says that the summary of a folder lists scenes that this run did not write.
fn note_others(out: &Path, others: usize, records: &[SceneRecord]) {
    if others > 0 && Counts::of(records).failure_count() == 0 {
        progress::say(&format!(
            "note: the summary of `{}` also lists {} that other runs left there",
            out.display(),
            progress::count(others, "scene")
        ));
    }
}

/// Prints what came of the attacks of this run, and how to find out why one is none.
fn print_table(job: &Job, folder: &Path, run_hash: &str, own: &[&Input], json: bool) -> Result<()> {
    // Rows are large, so only what they count for is kept.
    let tallied = |mut tally: Tallied, number: usize| {
        for (variant, row) in rows(job, folder, run_hash, own[number]) {
            tally.of_variant[variant].add(&row);
            if !row.outcome.is_attack() {
                let file = folder.join(row_file(&row.scene, &row.variant));
                tally.without = tally.without.max(Some((number, variant, file, row.files.is_empty())));
            }
        }
        tally
    };
    let empty = || Tallied { of_variant: vec![Tally::default(); job.variants().len()], without: None };
    let all = (0..own.len()).into_par_iter().fold(empty, tallied).reduce(empty, Tallied::and);
    if own.len() * job.variants().len() > 1 {
        printing::print_table(&summary::table(job, &all.of_variant), json)?;
    }
    if let Some((number, _, file, has_no_scene)) = all.without {
        let of = if has_no_scene { format!(" --of {}", own[number].file.display()) } else { String::new() };
        progress::say(&format!("why there is no attack: `sage explain {}{of}`", file.display()));
    }
    Ok(())
}

/// What the rows of a run count for.
struct Tallied {
    of_variant: Vec<Tally>,
    /// The last row without an attack: numbers of scene and variant, its file, and whether it has no scene file.
    without: Option<(usize, usize, PathBuf, bool)>,
}

impl Tallied {
    fn and(self, other: Self) -> Self {
        let sum = |(own, other): (Tally, &Tally)| own.and(other);
        Self {
            of_variant: self.of_variant.into_iter().zip(&other.of_variant).map(sum).collect(),
            without: self.without.max(other.without),
        }
    }
}

/// Rows of a scene that this run has, with the number of their variant.
fn rows<'a>(
    job: &'a Job<'a>,
    folder: &'a Path,
    run_hash: &'a str,
    input: &'a Input,
) -> impl Iterator<Item = (usize, AttackRow)> + 'a {
    let names = job.variants().iter().map(|variant| folder.join(row_file(&input.scene, variant)));
    let own = names.enumerate().filter(|(_, path)| is_row_of(path, run_hash));
    own.filter_map(|(variant, path)| Some((variant, AttackRow::read_head(&path)?)))
}

/// Existing outputs of a scene: its rows, the scene files that they name, and its picture.
fn outputs(job: &Job, folder: &Path, input: &Input) -> Vec<String> {
    let mut names = vec![picture_file(&input.scene), page_file(&input.scene)];
    for variant in job.variants() {
        let (row, name) = (row_file(&input.scene, variant), format!("{}-{variant}", input.scene));
        let is_own = |file: &String| names_of_file(file).contains(&&*name) && !file.contains(['/', '\\']);
        // The row is removed last, because it alone knows the names.
        if let Some(found) = AttackRow::read(&folder.join(&row)) {
            names.extend(found.files.into_iter().filter(is_own));
        }
        names.push(row);
    }
    names
}
