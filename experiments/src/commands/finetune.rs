//! `sage finetune`: tunes experts from a prior: a realistic, an adversarial and a lawful one, unless a config
//! names others.

mod curves;
mod options;
mod report;

use std::{sync::Arc, time::Instant};

use advsage::{Registries, weights::NamedNetwork};
use anyhow::{Context as _, Result, ensure};
use sage_backbones::{
    Backbone,
    backbone::Shared,
    device,
    features::EdgeKinds,
    parameters::Header,
    training::{CheckpointFile, FinetuneOptions, FinetuneRow, Measures, PreparedScene, Tunes, finetune},
    weights::PRIOR_FILE,
};
use sage_bench::csv_text::of_table;
use sage_core::{objective::Objective, scene::SceneData, text::table::Table};
use sage_generators::DIAL_FILE;
use sage_merging::ExpertFile;
use sage_run::{
    Outcome, networks,
    output::{self, Folder, Producer, Run, RunState},
    progress,
    scenes::{self, Scenes},
};
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::cli::FinetuneArgs;
use options::{EDGES, Expert, RunOptions};
use report::Tuned;

/// Maximum number of prepared scenes in memory, about 12 GB.
const MOST_PREPARED: usize = 8192;

/// The prior with some edges in its features. A network without this option keeps its features, also with the shipped
/// variants; other edges that are asked for are an error.
fn with_edges(
    loaded: NamedNetwork,
    run_options: &RunOptions,
    registries: &Registries,
) -> Result<NamedNetwork> {
    let NamedNetwork { network, mut header, name } = loaded;
    let mut options = network.options().clone();
    let Some(edges) = options.get_mut(EDGES) else {
        ensure!(
            run_options.edges.is_none() || run_options.edges_are_shipped,
            "the network `{}` has no option `edges`; omit --edges and `edges`",
            network.name()
        );
        return Ok(NamedNetwork { network, header, name });
    };
    *edges = serde_json::to_value(run_options.edges.unwrap_or(EdgeKinds::All))?;
    let changed = registries.backbones.build(network.name(), &options)?;
    let network = changed.with_parameters(network.parameters().clone())?;
    header.options = options;
    Ok(NamedNetwork { network, header, name })
}

/// What identifies the run.
#[derive(Serialize)]
struct Identity<'a> {
    data: &'a str,
    prior: String,
    network: &'a Value,
    device: &'a str,
    seed: u64,
    roles: usize,
    /// Options of each expert.
    options: Map<String, Value>,
    #[serde(flatten)]
    by: Producer,
    /// Hashes of files that the objectives read.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    contents: Vec<String>,
}

/// All inputs of the command.
struct Job<'a> {
    args: &'a FinetuneArgs,
    options: RunOptions,
    measures: Measures,
    prior: Arc<dyn Backbone>,
    /// Header of the prior's file.
    header: Header,
    training: Scenes,
    train: Vec<SceneData>,
    dev: Vec<SceneData>,
    /// Scenes that could not be used.
    failed: usize,
    /// Description of the training scenes.
    data: String,
}

/// The scenes with every goal decoded and evaluated.
struct Goals {
    /// Role assignments for training, and then their mirror images.
    train: Vec<PreparedScene>,
    /// How many of them are no mirror images.
    plain: usize,
    dev: Vec<PreparedScene>,
}

pub(crate) fn run(args: &FinetuneArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let mut job = Job::new(args, registries)?;
    let identity = job.identity()?;
    let (run, state) = job.start(identity.clone())?;
    if state == RunState::Done {
        return Ok(Outcome::Done);
    }
    let goals = job.goals()?;
    progress::say(&format!(
        "decoded and evaluated every goal of {} role assignments (a scene with an ego and an adversary) ({:.0} s)",
        goals.plain,
        clock.elapsed().as_secs_f64()
    ));
    let mut table = Table::new("", &HEADS);
    let mut reports = Vec::new();
    for expert in &job.options.experts {
        job.tune(expert, &goals, run.folder(), &identity, &mut table, &mut reports)?;
    }
    job.prior.parameters().save(&job.header, &run.folder().path().join(PRIOR_FILE))?;
    run.folder().write("finetune.csv", of_table(&table).as_bytes())?;
    if args.variants.is_some() {
        for (file, svg) in curves::draw(&table)? {
            run.folder().write(file, svg.as_bytes())?;
        }
    }
    run.finish(&json!({"experts": reports}), clock.elapsed().as_secs_f64())?;
    progress::say(&format!(
        "prior and experts are in `{}` ({:.0} s)",
        args.folder.out.display(),
        clock.elapsed().as_secs_f64()
    ));
    Ok(scenes::outcome_without(job.failed))
}

impl<'a> Job<'a> {
    /// Checks all options, loads the prior and reads the scenes.
    ///
    /// *Errors*: a wrong option; a prior or a folder of scenes that cannot be used.
    fn new(args: &'a FinetuneArgs, registries: &Registries) -> Result<Self> {
        let options = RunOptions::of(args, registries)?;
        let objectives: Vec<&Objective> = options.experts.iter().map(|expert| &expert.objective).collect();
        let measures = Measures::of(&objectives, &registries.rewards, &registries.feasibilities);
        let measures = measures.context("the experts of one run")?;
        let loaded =
            with_edges(NamedNetwork::load(&registries.backbones, &args.prior)?, &options, registries)?;
        networks::announce(&loaded);
        let network = device::on(&*loaded.network, &args.device)?;
        let training = Scenes::of(&args.paths, &args.split.filter(), args.procedural, args.seed)?;
        let validation = args.dev.as_ref().map(|dev| Scenes::under(std::slice::from_ref(dev))).transpose()?;
        let train = training.read_all()?;
        let dev = validation.as_ref().map(Scenes::read_all).transpose()?.unwrap_or_default();
        Ok(Self {
            args,
            options,
            measures,
            prior: network.into(),
            header: loaded.header,
            failed: training.failure_count() + validation.as_ref().map_or(0, Scenes::failure_count),
            data: scenes::describe(&train),
            training,
            train,
            dev,
        })
    }

    fn identity(&self) -> Result<Value> {
        let experts = &self.options.experts;
        let options =
            experts.iter().map(|expert| Ok((expert.name.clone(), serde_json::to_value(&expert.options)?)));
        let identity = Identity {
            data: &self.data,
            prior: self.prior.parameters().hash()?,
            network: self.prior.options(),
            seed: self.args.seed,
            device: device::kind(&self.args.device),
            roles: self.options.roles,
            options: options.collect::<Result<_>>()?,
            by: Producer::own(),
            contents: experts.iter().flat_map(|expert| expert.objective.contents()).collect(),
        };
        Ok(serde_json::to_value(identity)?)
    }

    fn start(&self, identity: Value) -> Result<(Run, RunState)> {
        let names = |ending: &str| -> Vec<String> {
            self.options.experts.iter().map(|expert| format!("{}.{ending}", expert.name)).collect()
        };
        let states = names("state");
        let mut results = names("safetensors");
        results.extend([PRIOR_FILE.to_owned(), "finetune.csv".to_owned()]);
        Ok(Run::start(
            &self.args.folder.out,
            identity,
            self.args.folder.force,
            &states.iter().map(String::as_str).collect::<Vec<_>>(),
            // A dial of other experts must not be used for these.
            &[DIAL_FILE],
            &results.iter().map(String::as_str).collect::<Vec<_>>(),
        )?)
    }

    /// Decodes and evaluates every goal of all scenes.
    ///
    /// *Errors*: more scenes than are held in memory.
    fn goals(&mut self) -> Result<Goals> {
        let train = scenes::with_other_roles(std::mem::take(&mut self.train), self.options.roles);
        let is_mirrored = self.options.experts.iter().any(|expert| expert.options.mirror);
        let images = if is_mirrored { 2 } else { 1 };
        let prepared = images * train.len() + self.dev.len();
        ensure!(
            prepared <= MOST_PREPARED,
            "{} role assignments ({images} mirror images of each) and {} scenes of --dev make {prepared} prepared scenes; at most {MOST_PREPARED} are held in memory (1.5 MB each): use fewer scenes or a smaller --roles",
            train.len(),
            self.dev.len()
        );
        let all = |scenes: &[SceneData], mirrored: bool| {
            PreparedScene::all(&*self.prior, scenes, mirrored, &self.measures, |data, defect| {
                self.training.fail(&data.name, &defect);
            })
        };
        let (plain, dev) = (all(&train, false)?, all(&self.dev, false)?);
        let mirrored = if is_mirrored { all(&train, true)? } else { Vec::new() };
        let count = plain.len();
        Ok(Goals { train: plain.into_iter().chain(mirrored).collect(), plain: count, dev })
    }

    /// Tunes an expert and writes its file, adds its epochs to the table and its report to the others.
    ///
    /// *Errors*: a training that cannot go on; a file that cannot be written.
    fn tune(
        &self,
        Expert { name, options, objective }: &Expert,
        goals: &Goals,
        folder: &Folder,
        identity: &Value,
        table: &mut Table,
        reports: &mut Vec<Value>,
    ) -> Result<()> {
        let prior = &*self.prior;
        let train = if options.mirror { &goals.train[..] } else { &goals.train[..goals.plain] };
        let state = folder.path().join(format!("{name}.state"));
        let identity = json!({"run": identity, "expert": name});
        let checkpoint = CheckpointFile { file: &state, identity, header: Header::default() };
        let weights = finetune(prior, train, &self.measures, objective, options, Some(&checkpoint), |row| {
            progress::say(&epoch_message(name, row));
            table.row(name, cells(row));
        })?;
        let content = ExpertFile::content(prior, &weights, options.tunes);
        content.save(&self.header_of(name, options)?, &folder.path().join(format!("{name}.safetensors")))?;
        let expert = Tuned { prior: &self.prior, weights, options, objective };
        reports.extend(match prior.shared() {
            Shared::Trajectories => expert.by_modes(name, &goals.train[..goals.plain], &goals.dev)?,
            Shared::Encodings | Shared::Nothing => {
                expert.by_own_samples(name, &self.dev, &goals.dev, &self.measures)?
            }
        });
        reports.push(json!({"expert": name, "options": options}));
        Ok(())
    }

    /// Header of the file of an expert.
    fn header_of(&self, name: &str, options: &FinetuneOptions) -> Result<Header> {
        let mut header = Header {
            backbone: self.prior.name().to_owned(),
            options: self.prior.options().clone(),
            seed: self.args.seed,
            data: self.data.clone(),
            command: output::command(),
            license: self.header.license.clone(),
            ..Header::default()
        };
        header.notes.insert(ExpertFile::EXPERT.to_owned(), name.to_owned());
        header.notes.insert(ExpertFile::PRIOR.to_owned(), self.prior.parameters().hash()?);
        header.notes.insert("options".to_owned(), serde_json::to_string(options)?);
        if options.tunes == Tunes::All {
            header.notes.insert(ExpertFile::TUNES.to_owned(), "all".to_owned());
        }
        Ok(header)
    }
}

fn epoch_message(name: &str, r: &FinetuneRow) -> String {
    let mut line = format!(
        "{name} epoch {}: loss {:.4}, pairs {:.1} ({:.1} by feasibility), accuracy {:.2}, feasible {:.2}, best R_adv {:.2}, KL {:.2}",
        r.epoch, r.loss, r.pairs, r.pairs_by_feasibility, r.accuracy, r.feasible, r.best_reward, r.kl
    );
    if r.without_pairs > 0.2 {
        line += &format!("; warning: {:.0} % of the scenes gave no pair", 100.0 * r.without_pairs);
    }
    line
}

/// Columns of `finetune.csv`.
const HEADS: [&str; 17] = [
    "expert",
    "epoch",
    "loss",
    "margin",
    "accuracy",
    "pairs",
    "pairs_by_feasibility",
    "feasible",
    "best_reward",
    "kl",
    "without_pairs",
    "expected_feasible",
    "expected_attack",
    "expected_believable",
    "expected_reward",
    "expected_penalty",
    "seconds",
];

fn cells(r: &FinetuneRow) -> impl Iterator<Item = String> {
    let numbers = [
        r.loss,
        r.margin,
        r.accuracy,
        r.pairs,
        r.pairs_by_feasibility,
        r.feasible,
        r.best_reward,
        r.kl,
        r.without_pairs,
        r.expected_feasible,
        r.expected_attack,
        r.expected_believable,
        r.expected_reward,
        r.expected_penalty,
    ];
    let numbers = numbers.map(|x| x.to_string());
    std::iter::once(r.epoch.to_string()).chain(numbers).chain([format!("{:.2}", r.seconds)])
}
