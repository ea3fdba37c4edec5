//! Times of the simulation: steps with and without observation, and resets.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use advsage::ego::Ego;
use anyhow::{Context as _, Result};
use sage_core::{scene::SceneIndex, seed::Rng};
use sage_sim::{
    SimScene,
    batch::{AutoReset, Batch, BatchOptions, BatchOutput, SceneOrder, Setting},
    drive::{Simulation, drive},
    environment::{Environment, EnvironmentOptions},
    observation::LENGTH,
    policy::{EgoPolicy, policies},
    vehicle::Action,
};

use serde_json::json;

use super::timing::{Data, Timing, timing};

/// Steps that one row times.
const STEPS: f64 = 1000.0;
/// Scenes on which the bars are set: every 20th number.
const EVERY: u64 = 20;
const LAST: u64 = 480;
/// Environments of the row on all threads, and steps of each.
const BATCH: usize = 64;
const BATCH_STEPS: usize = 100;
/// Fewest repetitions of a row.
const LEAST: usize = 3;

/// Times the simulation on the scenes 0, 20, 40 … 480 that are there, or on all.
///
/// *Errors*: a scene cannot be read or driven.
pub(super) fn run(data: &Data, repeat: usize, report: &mut impl FnMut(Timing) -> Result<()>) -> Result<()> {
    let files = data.files();
    let number = |file: &Path| file.file_stem()?.to_str()?.parse::<u64>().ok();
    let is_named = |file: &Path| number(file).is_some_and(|n| n % EVERY == 0 && n <= LAST);
    let named: Vec<_> = files.iter().filter(|file| is_named(file)).collect();
    let chosen = if named.is_empty() { files.iter().collect() } else { named };
    let scenes = prepared(data, &chosen)?;
    if scenes.is_empty() {
        return Ok(());
    }
    let training = Arc::new(EnvironmentOptions::training());
    let all_agents = Arc::new(EnvironmentOptions::training().with_parked(true));
    let repeat = repeat.div_ceil(10).max(LEAST);
    let rows: [(&'static str, &Arc<EnvironmentOptions>, bool, f64); 4] = [
        ("simulation: 1000 steps with observation, no parked cars", &training, true, 15_000.0),
        ("simulation: 1000 steps without observation, no parked cars", &training, false, 30_000.0),
        ("simulation: 1000 steps with observation, every agent", &all_agents, true, 6_000.0),
        ("simulation: 1000 steps without observation, every agent", &all_agents, false, 10_000.0),
    ];
    let mut resets = Vec::new();
    for (name, options, sees, target) in rows {
        let mut times = Vec::with_capacity(repeat);
        // The first pass builds the lines of each map.
        for round in 0..=repeat {
            let pass = pass(&scenes, options, sees, round as u64)?;
            if round > 0 {
                times.push(1e3 * pass.seconds / pass.steps as f64 * STEPS);
                resets.extend(pass.resets);
            }
        }
        report(timing(name, times, Some(1e3 * STEPS / target)))?;
    }
    report(timing("simulation: reset, map indexed", resets, Some(0.2)))?;
    for (name, threads) in [
        ("simulation: 1000 steps of 64 environments, one thread", 1),
        ("simulation: 1000 steps of 64 environments, two threads", 2),
    ] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().context("no threads")?;
        let times = (0..repeat).map(|_| batch(&scenes, &training, &pool)).collect::<Result<Vec<_>>>()?;
        report(timing(name, times, None))?;
    }
    for (name, options, target) in [
        ("simulation: 1000 steps of driver `idm`", ("idm", json!({})), None),
        ("simulation: 1000 steps of driver `expert`", ("expert", json!({})), None),
        ("simulation: 1000 steps of driver `pdm`", ("pdm", json!({})), Some(2000.0)),
        (
            "simulation: 1000 steps of driver `pdm` with `brake`",
            ("pdm", json!({"brake": true})),
            Some(2000.0),
        ),
    ] {
        let policy = policies()?.build(options.0, &options.1)?;
        let times = (0..LEAST).map(|_| driver(&scenes, &*policy)).collect::<Result<Vec<_>>>()?;
        report(timing(name, times, target))?;
    }
    Ok(())
}

/// Scenes with all that is built once.
fn prepared(data: &Data, files: &[&PathBuf]) -> Result<Vec<Arc<SimScene>>> {
    let mut scenes = Vec::with_capacity(files.len());
    for file in files {
        let scene = Arc::new(data.scene(file)?);
        let index = SceneIndex::new(scene.map.clone());
        index.build_all();
        if scene.ego().is_valid(0) {
            scenes.push(SimScene::new(scene, index)?);
        }
    }
    Ok(scenes)
}

/// Times drivers on all scenes: a median over the scenes.
///
/// *Errors*: a scene cannot be read or driven.
pub(super) fn drivers(
    data: &Data,
    egos: &[Ego],
    report: &mut impl FnMut(Timing) -> Result<()>,
) -> Result<()> {
    let scenes = prepared(data, &data.files().iter().collect::<Vec<_>>())?;
    for ego in egos {
        // The first drive starts a planner, and builds what a scene keeps.
        for scene in &scenes {
            driver(std::slice::from_ref(scene), &*ego.policy)?;
        }
        let times = scenes.iter().map(|scene| driver(std::slice::from_ref(scene), &*ego.policy));
        let name = format!("1000 steps of driver `{}`, median of scenes", ego.label);
        report(timing(name, times.collect::<Result<Vec<_>>>()?, None))?;
    }
    Ok(())
}

/// Time of [`STEPS`] steps of a driver through all scenes, milliseconds.
fn driver(scenes: &[Arc<SimScene>], policy: &dyn EgoPolicy) -> Result<f64> {
    let (mut steps, start) = (0, Instant::now());
    for scene in scenes {
        let mut simulation = Simulation::new(scene, &Arc::default(), None, policy, 0)?;
        steps += drive(&mut simulation)?.motions.len() - 1;
    }
    Ok(1e3 * start.elapsed().as_secs_f64() * STEPS / steps as f64)
}

/// One episode in each scene.
struct Pass {
    steps: usize,
    /// Time of all steps and resets.
    seconds: f64,
    /// Times of the resets, milliseconds.
    resets: Vec<f64>,
}

fn pass(scenes: &[Arc<SimScene>], options: &Arc<EnvironmentOptions>, sees: bool, seed: u64) -> Result<Pass> {
    let (mut steps, mut resets, mut seen) = (0, Vec::with_capacity(scenes.len()), [0.0; LENGTH]);
    let start = Instant::now();
    for scene in scenes {
        let reset = Instant::now();
        let mut episode = Environment::reset(scene.clone(), options.clone(), None, seed)?;
        resets.push(1e3 * reset.elapsed().as_secs_f64());
        let mut rng = Rng::new(seed, &scene.scene().id, "speed of the simulation");
        while !episode.is_over() {
            let action = Action { steer: rng.uniform(-0.1, 0.1), throttle: rng.uniform(-0.3, 0.6) };
            episode.step(action)?;
            if sees {
                episode.observe(&mut seen);
            }
            steps += 1;
        }
    }
    Ok(Pass { steps, seconds: start.elapsed().as_secs_f64(), resets })
}

/// Time of [`STEPS`] steps of a batch in a pool, milliseconds.
fn batch(
    scenes: &[Arc<SimScene>],
    options: &Arc<EnvironmentOptions>,
    pool: &rayon::ThreadPool,
) -> Result<f64> {
    let setting = Setting {
        scenes: Arc::new(scenes.to_vec()),
        order: SceneOrder::Random,
        rules: options.clone(),
        adversary: None,
    };
    let batch_options = BatchOptions {
        count: BATCH,
        auto_reset: AutoReset::SameStep,
        share_experience: false,
        parallel: true,
    };
    let mut batch = Batch::new(setting, batch_options)?;
    let (actions, mut out) = ([[0.02, 0.2]; BATCH], BatchOutput::default());
    batch.reset_all(0, &mut out)?;
    let start = Instant::now();
    for _ in 0..BATCH_STEPS {
        pool.install(|| batch.step(&actions, &mut out))?;
    }
    Ok(1e3 * start.elapsed().as_secs_f64() * STEPS / (BATCH * BATCH_STEPS) as f64)
}
