//! `sage rate`: how likely drivers fail.

mod index;
mod picture;
mod player;
mod scene;
mod table;

use advsage::{
    Registries,
    driver_spec::{DriverSpec, DriverSpecs},
    ego::{self, Ego},
    rate::{DensitySpec, NamedRate, RateSpec, hash},
    rows::{rate::RateRow, search::row_file},
};
use anyhow::{Result, ensure};
use sage_core::text::table::Table;
use sage_data::ReadOptions;
use sage_run::{
    Outcome, networks,
    output::{self, Counts, DatasetRun, Ended, Extent, MANIFEST, Producer},
    progress,
    scene_queue::{self, Input, Report, ReportWords, Scenes, Worked, is_row_of, work_on},
};
use sage_sim::{fault::FaultRule, rate::Given, search::Requirement};
use serde::Serialize;
use serde_json::Value;

use crate::cli::RateArgs;

/// What identifies a run.
#[derive(Serialize)]
struct Identity<'a> {
    command: String,
    #[serde(flatten)]
    by: Producer,
    ego: Vec<Value>,
    weights: &'a str,
    prior: String,
    temperature: f64,
    shifts: &'a [f64],
    aware: bool,
    feasibility: Value,
    budget: Option<usize>,
    events: Vec<&'static str>,
    require: Requirement,
    given: Given,
    references: &'a [String],
    fault: FaultRule,
    adversary: Option<&'a str>,
    seed: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    reading: Option<ReadOptions>,
}

/// All inputs of the command except the scenes.
struct Job<'a> {
    args: &'a RateArgs,
    egos: Vec<Ego>,
    rate: NamedRate,
}

impl<'a> Job<'a> {
    fn new(args: &'a RateArgs, registries: &Registries) -> Result<Self> {
        let egos = Ego::all(&drivers(args), registries)?.into_iter().map(|ego| {
            let ego = ego.with_references(&args.reference, registries)?;
            Ok(Ego { fault: args.fault, ..ego })
        });
        let egos = egos.collect::<Result<Vec<_>>>()?;
        for (k, ego) in egos.iter().enumerate() {
            let is_twice = egos[..k].iter().any(|other| other.file_name() == ego.file_name());
            ensure!(
                !is_twice,
                "two drivers have the file name `{}`; name one: NAME={}",
                ego.file_name(),
                ego.label
            );
        }
        let rate = RateSpec {
            weights: args.weights.clone(),
            density: DensitySpec {
                temperature: args.temperature,
                profiles: args.profiles,
                aware: args.aware,
            },
            feasibility: args.feasibility.clone(),
            budget: args.budget.0,
            require: args.require,
            given: args.given,
            seed: args.seed,
        };
        let rate = rate.build_with(registries, networks::announce)?;
        progress::say(&format!("note: temperature {:.2}", rate.density.temperature));
        rate.density.notes.iter().for_each(|note| progress::say(&format!("warning: {note}")));
        Ok(Self { args, egos, rate })
    }

    /// Names of the rows of a scene, driver by driver.
    fn files(&self, scene: &str) -> Vec<String> {
        self.egos.iter().map(|ego| row_file(&format!("{scene}-{}", ego.file_name()))).collect()
    }

    fn identity(&self) -> Result<Value> {
        let Self { args, rate, .. } = self;
        let identity = Identity {
            command: output::command(),
            by: Producer::own(),
            ego: drivers(args).iter().map(ego::identity).collect::<advsage::Result<_>>()?,
            weights: &rate.density.weights,
            prior: hash(&*rate.density.prior)?,
            temperature: rate.density.temperature,
            shifts: &rate.density.shifts,
            aware: rate.density.is_aware,
            feasibility: serde_json::to_value(&rate.rule.objective.spec().feasibility)?,
            budget: rate.spec.budget,
            events: args.event.iter().map(|event| event.name()).collect(),
            require: args.require,
            given: args.given,
            references: &args.reference,
            fault: args.fault,
            adversary: args.adversary.as_deref(),
            seed: args.seed,
            reading: output::reading_identity(args.reading.options()),
        };
        Ok(serde_json::to_value(identity)?)
    }
}

/// The drivers that are named, in their order.
fn drivers(args: &RateArgs) -> Vec<DriverSpec> {
    let all = args.ego.iter().flat_map(|DriverSpecs(parts)| parts);
    all.map(|part| args.planner.applied(part)).collect()
}

/// Name of the picture beside a row.
fn picture_file(row: &str) -> String {
    format!("{}.svg", row.trim_end_matches(".json"))
}

/// Name of the page beside a row that plays its likeliest failure.
fn page_file(row: &str) -> String {
    format!("{}.html", row.trim_end_matches(".json"))
}

pub(crate) fn run(args: &RateArgs, extent: Extent, registries: &Registries) -> Result<Outcome> {
    let job = Job::new(args, registries)?;
    let scenes = Scenes::find(&args.scene, &args.reading.options())?;
    let own = scenes.of_part(extent);
    scenes.protect(&args.folder.out, drivers(args).iter().flat_map(DriverSpec::files).collect())?;
    let out = &args.folder.out;
    let outdated = || {
        let of_scenes = own.iter().flat_map(|input: &&Input| job.files(&input.scene));
        let with_pictures = of_scenes.flat_map(|row| [picture_file(&row), page_file(&row), row]);
        with_pictures.chain([MANIFEST, index::FILE].map(str::to_owned)).collect()
    };
    let run = DatasetRun::start(
        out,
        job.identity()?,
        args.folder.force,
        extent,
        &[MANIFEST, index::FILE],
        outdated,
    )?;
    output::keep_planner_logs(run.folder(), extent, &job.egos)?;
    let report = |count| {
        Report::new(run.folder().path(), args.json, count, ReportWords { done: "rated", result: "rate" })
    };
    let worked = Worked::on(&scenes, extent, &run, report, |input| work_on(&job, &run, input))?;
    let (records, folder, hash) = (&worked.records, run.folder().path().to_owned(), run.hash().to_owned());
    let rows: Vec<Vec<Option<RateRow>>> = scenes
        .reported_by(extent)
        .into_iter()
        .map(|input| {
            let read = |file: &String| {
                let path = folder.join(file);
                if is_row_of(&path, &hash) { RateRow::read(&path) } else { None }
            };
            job.files(&input.scene).iter().map(read).collect()
        })
        .collect();
    let labels: Vec<&str> = job.egos.iter().map(|ego| &*ego.label).collect();
    let tables = table::tables(args.given, &labels, &args.event, &rows);
    if !matches!(extent, Extent::Shard(_)) {
        let reliability = table::reliability(&job.rate.density.coverage);
        let with_coverage: Vec<Table> = tables.iter().cloned().chain(reliability).collect();
        index::write(
            run.folder(),
            (args.given, args.aware),
            &with_coverage,
            rows.iter().flatten().flatten(),
        )?;
    }
    match extent {
        Extent::Shard(shard) => run.finish_shard(shard, records)?,
        Extent::Whole | Extent::Join => run
            .finish(Ended {
                records,
                shards: &worked.shards,
                results: scene_queue::results(records),
                seconds_per_attack: worked.median_seconds(),
                has_pickles: false,
                is_done: Counts::of(records).failure_count() == 0,
            })
            .map(drop)?,
    }
    for table in &tables {
        let wide = if args.wide { table.aligned() } else { table.terminal() };
        match args.json {
            true => progress::say_lines(&wide),
            false => output::print(&format!("\n{wide}"))?,
        }
    }
    Ok(scene_queue::outcome(records, extent, out, "rated", scene_queue::AGAIN))
}
