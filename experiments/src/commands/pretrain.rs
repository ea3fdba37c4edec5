//! `sage pretrain`: trains a prior on recorded or procedural scenes.

mod curve;

use std::time::{Duration, Instant};

use advsage::{Registries, weights::NamedNetwork};
use anyhow::{Context as _, Result};
use sage_backbones::{
    Backbone, device,
    parameters::Header,
    training::{EpochRow, Observer, PretrainOptions, pretrain},
    weights::PRIOR_FILE,
};
use sage_run::{
    Outcome, input,
    output::{self, Folder, Producer, Run, RunState},
    progress::{self, count},
    scenes::{self, Scenes},
};
use serde::Serialize;
use serde_json::{Value, json};

use crate::cli::PretrainArgs;

/// File of the training state.
const STATE: &str = "last.safetensors";
/// Procedural scenes for validation if `--dev` is not given.
const VALIDATION_SCENES: u64 = 60;
/// Least time between two progress lines.
const REPORT_INTERVAL: Duration = Duration::from_secs(10);

/// What identifies a training.
#[derive(Serialize)]
struct Identity<'a> {
    backbone: &'a str,
    network: &'a Value,
    options: &'a PretrainOptions,
    data: &'a str,
    /// Where the weights come from that it starts with.
    start: &'a str,
    device: &'a str,
    #[serde(flatten)]
    by: Producer,
}

pub(crate) fn run(args: &PretrainArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let options = options(args)?;
    let given = args.network.as_deref().unwrap_or("{}");
    let given = serde_json::from_str(given).with_context(|| format!("--network: `{given}` is not JSON"))?;
    let mut network = registries.backbones.build(&args.backbone, &given)?;
    if let Some(from) = &args.from {
        let loaded = NamedNetwork::load(&registries.backbones, from)?;
        let parameters = loaded.network.parameters().clone();
        network = network.load_parameters(parameters, &format!("weights `{from}`"))?;
    }
    let network = device::on(&*network, &args.device)?;
    let train = if args.paths.is_empty() {
        Scenes::procedural(args.procedural, options.seed)
    } else {
        Scenes::under(&args.paths)?
    };
    let dev = match &args.dev {
        Some(dev) => Scenes::under(std::slice::from_ref(dev))?,
        // Another seed, so that no training scene is among them.
        None => Scenes::procedural(VALIDATION_SCENES, !options.seed),
    };
    let (training, validation) = (train, dev);
    let (train, dev) = (training.read_all()?, validation.read_all()?);
    let failed = training.failure_count() + validation.failure_count();
    let header = Header {
        backbone: network.name().to_owned(),
        options: network.options().clone(),
        seed: options.seed,
        data: format!("{}, validated on {}", scenes::describe(&train), scenes::describe(&dev)),
        command: output::command(),
        license: args.license.clone().unwrap_or_default(),
        notes: [("start".to_owned(), initial_weights(args, &*network)?)].into(),
    };
    let identity = serde_json::to_value(Identity {
        backbone: &header.backbone,
        network: &header.options,
        options: &options,
        data: &header.data,
        start: &header.notes["start"],
        device: device::kind(&args.device),
        by: Producer::own(),
    })?;
    let outdated = [STATE, PRIOR_FILE, "curve.csv", "curve.svg"];
    let (run, state) = Run::start(&args.folder.out, identity, args.folder.force, &[], &outdated, &outdated)?;
    if state == RunState::Done {
        return Ok(Outcome::Done);
    }
    let folder = run.folder();
    progress::say(&format!(
        "{} network `{}` ({} parameters), {} scenes, validation on {}",
        if state == RunState::Unfinished { "resuming" } else { "training" },
        network.name(),
        network.parameters().numbers(),
        train.len(),
        dev.len()
    ));
    let mut watcher = Watcher::new(folder, options.epochs);
    let done = pretrain(&*network, &train, &dev, &options, &header, folder.path(), &mut watcher)?;
    watcher.outcome?;
    let rows = done.rows;
    let best = rows.iter().min_by(|a, b| a.nll.total_cmp(&b.nll)).context("there is no epoch")?;
    curve::write(folder, &rows)?;
    run.finish(&json!({"best": best, "epochs": rows.len()}), clock.elapsed().as_secs_f64())?;
    progress::say(&format!(
        "best of {}: {} with nll {:.3} and minFDE6 {:.2} m; its weights are `{}`",
        count(rows.len(), "epoch"),
        best.epoch,
        best.nll,
        best.min_fde6,
        folder.path().join(PRIOR_FILE).display()
    ));
    Ok(scenes::outcome_without(failed))
}

/// Description of the initial weights.
fn initial_weights(args: &PretrainArgs, network: &dyn Backbone) -> Result<String> {
    let from = args.from.as_deref().unwrap_or("first values");
    Ok(format!("{from} ({})", network.parameters().hash()?))
}

fn options(args: &PretrainArgs) -> Result<PretrainOptions> {
    let mut options: PretrainOptions = match &args.config {
        Some(path) => {
            let text = input::read_config(path)?;
            serde_json::from_str(&text).with_context(|| format!("`{}`", path.display()))?
        }
        None => PretrainOptions::default(),
    };
    if let Some(seed) = args.seed {
        options.seed = seed;
    }
    if let Some(epochs) = args.epochs {
        options.epochs = epochs;
    }
    if let Some(rate) = args.rate {
        options.rate = rate;
    }
    options.check()?;
    Ok(options)
}

/// Reports steps and epochs, and writes the curves.
struct Watcher<'f> {
    folder: &'f Folder,
    epochs: u32,
    rows: Vec<EpochRow>,
    shown: Instant,
    /// Whether the curves could be written.
    outcome: Result<()>,
}

impl<'f> Watcher<'f> {
    fn new(folder: &'f Folder, epochs: u32) -> Self {
        let now = Instant::now();
        Self { folder, epochs, rows: Vec::new(), shown: now, outcome: Ok(()) }
    }
}

impl Observer for Watcher<'_> {
    fn resumed(&mut self, rows: &[EpochRow]) {
        self.rows = rows.to_vec();
        if let Some(last) = rows.last() {
            progress::say(&format!("epoch {} is the last in the training state", last.epoch));
        }
    }

    fn step(&mut self, epoch: u32, step: usize, steps: usize, loss: f64) {
        if self.shown.elapsed() < REPORT_INTERVAL {
            return;
        }
        self.shown = Instant::now();
        progress::say(&format!("epoch {epoch} of {}, step {step} of {steps}, loss {loss:.3}", self.epochs));
    }

    fn epoch(&mut self, row: &EpochRow) {
        self.rows.push(row.clone());
        let left = f64::from(self.epochs - row.epoch) * row.seconds;
        progress::say(&format!(
            "epoch {}: loss {:.3} (goals) + {:.3} (trajectories), minFDE6 {:.2} m, nll {:.3}; about {:.0} min left",
            row.epoch,
            row.goal,
            row.trajectory,
            row.min_fde6,
            row.nll,
            left / 60.0
        ));
        if self.outcome.is_ok() {
            self.outcome = curve::write(self.folder, &self.rows);
        }
    }
}
