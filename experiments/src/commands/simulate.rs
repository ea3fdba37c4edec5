//! `sage simulate`: drives scenes with policies, with or without attacks, and writes pages that play them.

mod attack_file;
mod attacks;
mod check_planner;
mod index;
mod scene;
mod summary;

use std::{path::PathBuf, sync::Arc};

use advsage::{
    Registries,
    attacked_files::LONGEST_FILE_NAME,
    driver_spec::{DriverSpec, DriverSpecs},
    ego::{self, Ego},
    named_generator::{GeneratorIdentity, NamedGenerator},
};
use anyhow::{Result, bail};
use sage_data::ReadOptions;
use sage_run::{
    Outcome, networks,
    output::{self, Counts, DatasetRun, Ended, Extent, Inputs, MANIFEST, Producer, RECORD},
    progress,
    scene_queue::{self, Input, Report, ReportWords, Scenes, Worked, work_on},
};
use sage_sim::policy::StepTimes;
use serde::Serialize;
use serde_json::Value;

use crate::cli::SimulateArgs;
use attack_file::AttackFile;
use scene::page_file;

/// What attacks the drivers.
enum Attacked {
    /// Nothing: the scene is driven as it is.
    AsItIs,
    /// An attack from a file.
    FromFile(Box<AttackFile>),
    /// A generator, at operating points.
    Generated(Box<NamedGenerator>),
}

/// What identifies a run.
#[derive(Serialize)]
struct Identity<'a> {
    #[serde(flatten)]
    generator: Option<GeneratorIdentity<'a>>,
    /// Without a generator, which has its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    seed: Option<u64>,
    /// Hash of the file of the attack.
    #[serde(skip_serializing_if = "Option::is_none")]
    attack: Option<&'a str>,
    command: String,
    #[serde(flatten)]
    by: Producer,
    ego: Vec<Value>,
    adversary: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reading: Option<ReadOptions>,
}

/// All inputs of the command except the scenes.
struct Job<'a> {
    args: &'a SimulateArgs,
    egos: Vec<Ego>,
    /// Times of the steps of each driver in this run.
    times: Vec<Arc<StepTimes>>,
    attacked: Attacked,
    /// Says on each page what attacks.
    subtitle: String,
}

impl<'a> Job<'a> {
    /// Checks all arguments except the scenes; reads weights and the attack.
    ///
    /// *Errors*: an argument is out of range or names an unknown part; a file cannot be read.
    fn new(args: &'a SimulateArgs, registries: &Registries) -> Result<Self> {
        let parts = drivers(args);
        let egos = Ego::all(&parts, registries)?;
        let (attacked, subtitle) = match (&args.method, &args.attack) {
            (Some(method), _) => {
                let generator =
                    networks::build_generator(args.options.spec(Some(method), None)?, registries)?;
                let subtitle =
                    format!("attacks by {}, each planned against the drive without it", generator.method);
                (Attacked::Generated(Box::new(generator)), subtitle)
            }
            (None, file) => {
                refuse_attack_options(args)?;
                match file {
                    Some(file) => {
                        let subtitle = format!("attack of {}", file.display());
                        (Attacked::FromFile(Box::new(AttackFile::read(file)?)), subtitle)
                    }
                    None => (Attacked::AsItIs, "the scene as it is".to_owned()),
                }
            }
        };
        let times = egos.iter().map(|_| Arc::default()).collect();
        Ok(Self { args, egos, times, attacked, subtitle })
    }

    /// Name of each attack, as part of file names; empty without a generator.
    fn variants(&self) -> &[String] {
        match &self.attacked {
            Attacked::Generated(generator) => &generator.variants,
            _ => const { &[String::new()] },
        }
    }

    /// Drivers (by number), attacks and files of a scene's rows, in the order of the rows.
    fn files<'s>(&'s self, scene: &'s str) -> impl Iterator<Item = (usize, &'s str, String)> {
        let rows = (0..self.egos.len()).flat_map(|ego| self.variants().iter().map(move |v| (ego, &**v)));
        rows.map(move |(ego, variant)| {
            let dash = if variant.is_empty() { "" } else { "-" };
            (ego, variant, format!("{scene}-{}{dash}{variant}.json", self.file_name(ego)))
        })
    }

    /// A driver's name as part of file names. Drivers whose names differ only in other characters get a number.
    fn file_name(&self, ego: usize) -> String {
        let name = self.egos[ego].file_name();
        match self.egos[..ego].iter().filter(|other| other.file_name() == name).count() {
            0 => name,
            before => format!("{name}-{}", before + 1),
        }
    }

    /// Identity of this run. The folder of another run is refused.
    ///
    /// *Errors*: the file of a `path` or of the attack cannot be read.
    fn identity(&self) -> Result<Value> {
        let seed = self.args.options.generator.seed;
        let (generator, seed, attack) = match &self.attacked {
            Attacked::Generated(generator) => (Some(generator.identity()?), None, None),
            Attacked::FromFile(file) => (None, Some(seed), Some(file.hash())),
            Attacked::AsItIs => (None, Some(seed), None),
        };
        let identity = Identity {
            generator,
            seed,
            attack,
            command: output::command(),
            by: Producer::own(),
            ego: drivers(self.args).iter().map(ego::identity).collect::<advsage::Result<_>>()?,
            adversary: self.args.options.adversary.as_deref(),
            reading: output::reading_identity(self.args.reading.options()),
        };
        Ok(serde_json::to_value(identity)?)
    }
}

/// The drivers that are named, in their order.
fn drivers(args: &SimulateArgs) -> Vec<DriverSpec> {
    let all = args.ego.iter().flat_map(|DriverSpecs(parts)| parts);
    all.map(|extent| args.planner.applied(extent)).collect()
}

/// Refuses options of an attack if nothing generates one.
fn refuse_attack_options(args: &SimulateArgs) -> Result<()> {
    match args.options.first_given() {
        Some(name) => bail!("{name} needs a generator; name it with --method, such as --method sage"),
        None => Ok(()),
    }
}

pub(crate) fn run(args: &SimulateArgs, extent: Extent, registries: &Registries) -> Result<Outcome> {
    let simulation = Job::new(args, registries)?;
    let scenes = Scenes::find(&args.scene, &args.reading.options())?;
    let (inputs, own) = (&scenes.all, scenes.of_part(extent));
    if inputs.len() > 1 && args.attack.is_some() {
        bail!(
            "--attack is on one scene, and `{}` holds {}; to drive a folder of attacked scenes, give it as SCENE",
            args.scene.display(),
            inputs.len()
        );
    }
    if args.check_planner && extent != Extent::Join {
        let mut planners = drivers(args);
        planners.retain(DriverSpec::is_program);
        check_planner::check(args, &planners, registries, inputs)?;
    }
    let outputs = |input: &Input| -> Vec<String> {
        let rows = simulation.files(&input.scene).map(|(.., file)| file);
        rows.chain([page_file(&input.scene)]).collect()
    };
    let mut written: Vec<PathBuf> = inputs.iter().flat_map(outputs).map(PathBuf::from).collect();
    if let Some(long) = written.iter().find(|name| name.as_os_str().len() > LONGEST_FILE_NAME) {
        bail!(
            "`{}` would be the name of an output, longer than a file name can be; rename the scene",
            long.display()
        );
    }
    written.extend([index::FILE, RECORD, MANIFEST].map(PathBuf::from));
    let mut read = scenes.files.clone();
    read.extend(args.attack.clone());
    read.extend(drivers(args).iter().flat_map(DriverSpec::files));
    output::protect_inputs(std::slice::from_ref(&args.scene), &read, &args.folder.out, &written)?;
    // The folder of a row has a record and a manifest of its own.
    Inputs::of(&args.attack).refuse_folder(&args.folder.out)?;
    let out = &args.folder.out;
    let outdated = || {
        let of_scenes = own.iter().copied().flat_map(outputs);
        of_scenes.chain([index::FILE, MANIFEST, output::PLANNER_LOGS].map(str::to_owned)).collect()
    };
    let run =
        DatasetRun::start(out, simulation.identity()?, args.folder.force, extent, &[MANIFEST], outdated)?;
    output::keep_planner_logs(run.folder(), extent, &simulation.egos)?;
    let report = |count| {
        Report::new(run.folder().path(), args.json, count, ReportWords { done: "driven", result: "drive" })
    };
    let worked = Worked::on(&scenes, extent, &run, report, |input| work_on(&simulation, &run, input))?;
    let (records, folder, hash) = (&worked.records, run.folder().path().to_owned(), run.hash().to_owned());
    match extent {
        Extent::Shard(shard) => run.finish_shard(shard, records)?,
        Extent::Whole | Extent::Join => {
            index::write(run.folder(), &simulation, inputs, &hash)?;
            run.finish(Ended {
                records,
                shards: &worked.shards,
                results: scene_queue::results(records),
                seconds_per_attack: worked.median_seconds(),
                has_pickles: false,
                is_done: Counts::of(records).failure_count() == 0,
            })?;
        }
    }
    if let Some(table) = summary::table(&simulation, &folder, &scenes.reported_by(extent), &hash) {
        sage_run::printing::print_table(&table, args.json)?;
        let names = simulation.egos.iter().map(|ego| &*ego.label);
        sage_run::printing::print_step_times(names.zip(simulation.times.iter().map(|times| &**times)));
    }
    let page = if inputs.len() == 1 { page_file(&inputs[0].scene) } else { index::FILE.to_owned() };
    if worked.has_results() && out.join(&page).is_file() {
        progress::say(&format!("to watch, open `{}` in a browser", out.join(page).display()));
    }
    let again = match simulation.egos.iter().any(|ego| ego.is_program) {
        true => "run the same command again; after a change of a planner with --force, or into another --out",
        false => scene_queue::AGAIN,
    };
    Ok(scene_queue::outcome(records, extent, out, "driven", again))
}
