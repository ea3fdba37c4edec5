//! `sage train-adversary goose`: a policy that moves the control points of the adversary's path, against a driver.

mod card;
mod curves;
mod measured;
mod memory;
mod options;
mod state;
mod training;

use std::time::Instant;

use advsage::{
    Registries,
    ego::{self, Ego},
    prepared::DriverInScene,
};
use anyhow::{Result, ensure};
use candle_core::{Device, Tensor};
use rayon::prelude::*;
use sage_backbones::{Parameters, parameters::Header};
use sage_baselines::goose::networks::{GOOSE_FILE, GooseWeights};
use sage_core::{objective::Context, scene::SceneData};
use sage_run::{
    Outcome,
    outcome::caught,
    output::{self, Producer, Run, RunState},
    progress::{self, count},
    scenes::{self, Scenes},
};
use sage_sim::{SimScene, attack_test::AttackTest};
use serde::Serialize;
use serde_json::{Value, json};

use self::{
    options::TrainingOptions,
    training::{Seat, Training},
};
use super::training_scenes::TrainingScenes;
use crate::cli::TrainGooseArgs;

/// File from which an interrupted training resumes.
const STATE: &str = "training.state";
/// Decisions from one state to the next.
const SAVED: u64 = 500;
/// Most role assignments of all scenes together, about 9 GB.
const MOST_SETTINGS: usize = 4096;

/// What identifies a training.
#[derive(Serialize)]
struct Identity<'a> {
    command: &'static str,
    options: &'a TrainingOptions,
    data: &'a str,
    dev: String,
    ego: Value,
    seed: u64,
    license: &'a str,
    #[serde(flatten)]
    by: Producer,
}

pub(crate) fn run(args: &TrainGooseArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let options = TrainingOptions::of(args)?;
    let ego = Ego::new(&args.planner.applied(&args.ego), registries)?;
    let license = args.license.clone().unwrap_or_else(|| "unspecified".to_owned());
    let mut list = TrainingScenes::read(&args.scenes, args.seed)?;
    let data = scenes::describe(&list.train);
    let identity = serde_json::to_value(Identity {
        command: "train-adversary goose",
        options: &options,
        data: &data,
        dev: scenes::describe(&list.dev),
        ego: ego::identity(&args.ego)?,
        seed: args.seed,
        license: &license,
        by: Producer::own(),
    })?;
    let results = [GOOSE_FILE, curves::TABLE, curves::PICTURE, card::FILE];
    let (run, state) =
        Run::start(&args.folder.out, identity.clone(), args.folder.force, &[STATE], &[], &results)?;
    if state == RunState::Done {
        return Ok(Outcome::Done);
    }
    let given = list.train.len();
    let train = scenes::with_other_roles(std::mem::take(&mut list.train), options.roles);
    let settings = train.len();
    ensure!(
        settings <= MOST_SETTINGS,
        "{settings} role assignments of the scenes; at most {MOST_SETTINGS} are held in memory (2 MB each): use fewer scenes or a smaller `roles`"
    );
    let tests = tests(&list.training, &train, given, &ego, args.seed);
    let seats = seats(&list.training, &tests, &options);
    ensure!(
        !seats.is_empty(),
        "nothing to learn in {}: the driver does not meet the adversary after now, or the recording's own curve reaches the goal",
        count(train.len(), "scene")
    );
    progress::say(&format!(
        "{} to learn in ({:.0} s)",
        count(seats.len(), "scene"),
        clock.elapsed().as_secs_f64()
    ));
    let mut learning = Training::new(&options, &seats, args.seed)?;
    let path = run.folder().path().join(STATE);
    state::resume(&mut learning, &identity, &path)?;
    while !learning.is_done() {
        learning.decide()?;
        if learning.decisions().is_multiple_of(SAVED) {
            state::save(&learning, &identity, &path)?;
            say(&learning, &options, &clock);
        }
    }
    let decisions = learning.decisions();
    learning.end_scenes()?;
    let parameters = parameters(&learning)?;
    let header = Header {
        backbone: "goose".to_owned(),
        options: serde_json::to_value(&options.networks)?,
        seed: args.seed,
        data,
        command: output::command(),
        license,
        notes: [
            ("training".to_owned(), serde_json::to_string(&options)?),
            ("driver".to_owned(), ego.label.clone()),
        ]
        .into(),
    };
    parameters.save(&header, &run.folder().path().join(GOOSE_FILE))?;
    curves::write(learning.ended(), learning.losses(), run.folder())?;
    let weights = GooseWeights::new(&parameters, &options.networks, GOOSE_FILE)?;
    let measured = measured::measure(&list.validation, &list.dev, &weights, &*ego.policy, args.seed);
    let summary = json!({
        "scenes": seats.len(), "decisions": decisions, "ended": learning.ended().len(),
        "success": curves::success(learning.ended(), options.decisions, seats.len()), "measured": measured,
    });
    run.folder().write(card::FILE, card::page(&header, &ego.label, &summary).as_bytes())?;
    let seconds = clock.elapsed().as_secs_f64();
    run.finish(&summary, seconds)?;
    progress::say(&format!("`{GOOSE_FILE}` is in `{}` ({seconds:.0} s)", args.folder.out.display()));
    Ok(list.outcome())
}

/// A driver in a scene, and the scene as it is attacked.
struct Tested<'e> {
    test: AttackTest<'e>,
    ctx: Context,
    /// The scene as the user knows it; `None` under other roles.
    name: Option<String>,
}

/// The driver in each scene that it can drive, with its drive without an attack, and the scene as it is attacked. Only the first
/// scenes, those that are given, are reported if it cannot: among other roles are egos that are absent at the start.
fn tests<'e>(list: &Scenes, train: &[SceneData], given: usize, ego: &'e Ego, seed: u64) -> Vec<Tested<'e>> {
    let one = |data: &SceneData| -> Result<DriverInScene<'e>> {
        let scene = SimScene::new(data.scene.clone(), data.index.clone())?;
        Ok(DriverInScene::of_test(AttackTest::new(&*ego.policy, &scene, seed)?)?)
    };
    let all: Vec<Result<_>> = train.par_iter().with_max_len(1).map(|data| caught(|| one(data))).collect();
    let mut kept = Vec::new();
    for (number, (found, data)) in all.into_iter().zip(train).enumerate() {
        match found {
            Ok(DriverInScene { test, ctx }) => {
                kept.push(Tested { test, ctx, name: (number < given).then(|| data.name.clone()) });
            }
            Err(error) if number < given => list.fail(&data.name, error.as_ref()),
            Err(_) => {}
        }
    }
    kept
}

/// The scenes in which something can be learnt.
fn seats<'a>(list: &Scenes, tests: &'a [Tested<'a>], options: &TrainingOptions) -> Vec<Seat<'a>> {
    let one = |Tested { test, ctx, name }: &'a Tested<'a>| match (Seat::new(test, ctx, options), name) {
        (Ok(seat), _) => Some(seat),
        (Err(error), Some(name)) => {
            list.fail(name, error.as_ref());
            None
        }
        (Err(_), None) => None,
    };
    tests.iter().filter_map(one).filter(|seat| seat.is_useful(options)).collect()
}

fn say(learning: &Training, options: &TrainingOptions, clock: &Instant) {
    let ended = learning.ended();
    let newest = &ended[ended.len().saturating_sub(200)..];
    let share = |of: fn(&training::Ended) -> bool| {
        100.0 * newest.iter().filter(|one| of(one)).count() as f64 / newest.len().max(1) as f64
    };
    progress::say(&format!(
        "decision {} of {}: goal reached in {:.0} %, contacts in {:.0} % of the last {} ({:.0} s)",
        learning.decisions(),
        options.decisions,
        share(|one| one.is_done),
        share(|one| one.is_hit),
        count(newest.len(), "scene"),
        clock.elapsed().as_secs_f64()
    ));
}

/// Encoder and actor.
fn parameters(learning: &Training) -> Result<Parameters> {
    let mut actor = Parameters::default();
    for tensor in learning.learner().tensors() {
        if let Some(name) = tensor.name.strip_prefix("actor.") {
            actor.insert(name, Tensor::from_slice(tensor.numbers, tensor.shape, &Device::Cpu)?);
        }
    }
    Ok(GooseWeights::file_parameters(&learning.encoder().weights()?, &actor))
}
