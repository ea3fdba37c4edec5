//! Times of the main components: reading, indexing, scoring, networks.

use std::{
    hint::black_box,
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::Arc,
    time::Instant,
};

use advsage::ego::Ego;
use anyhow::{Context as _, Result, bail};
use sage_core::{
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::{Candidate, Context, ContextOptions, Encounter, Feasibility, Scorer, realism_penalty},
    registry::Registry,
    scene::{Scene, SceneIndex},
    seed::Rng,
    statistics::median,
};
use sage_data::{Recording, checks::Summary, folder, pickle::Document, womd};

pub use super::timing::{CANDIDATES, Data, Timing};

use super::{
    learning_speed, network_speed, simulation_speed,
    timing::{measure, timing},
};

/// Scenes whose median is reported.
const SCENES: usize = 12;

/// Alternating turns of Python's reader and ours.
const TURNS: usize = 5;

/// Times every component on some scenes.
///
/// *Errors*: a scene cannot be read.
pub fn run(data: &Data, repeat: u32, mut report: impl FnMut(Timing) -> Result<()>) -> Result<()> {
    let repeat = repeat as usize;
    let files = data.files();
    // Published times are of scene 0.
    let zero = files.iter().find(|file| file.file_stem().is_some_and(|stem| stem == "0"));
    let first = zero.or(files.first()).context("no scene to measure")?;
    // Python's reader executes code in a pickle. So it never gets the file, but a pickle that we write from
    // plain values. Both readers get the same bytes.
    let recording = Recording::from_bytes(first, data.bytes(first)?)?;
    let (bytes, scenario) = (recording.to_pickle()?, womd::frame(&recording.to_scenario()?.data));
    // A record has the name of its shard, which a pickle must not have.
    let [scene, record] = ["scene", "scene.tfrecord"].map(Path::new);
    // The readers alternate, because the machine's speed changes from second to second.
    let (mut python, mut loads) = (Vec::new(), Vec::new());
    for _ in 0..TURNS {
        python.extend(python_loads(&bytes, repeat.div_ceil(TURNS)).unwrap_or_default());
        loads.extend(measure(repeat.div_ceil(TURNS), || {
            let copy = bytes.clone();
            let start = Instant::now();
            let recording = black_box(Recording::from_bytes(scene, copy));
            (start.elapsed(), recording)
        }));
    }
    let python_median = median(&python);
    if python_median.is_some() {
        report(timing("CPython pickle.loads, one scene", python, None))?;
    }
    report(timing("pickle to checked scene, one scene", loads, python_median))?;
    let parse = measure(repeat, || {
        let copy = bytes.clone();
        let start = Instant::now();
        let document = black_box(Document::parse(copy));
        (start.elapsed(), document)
    });
    report(timing("of this: pickle to values", parse, None))?;

    let read = |path: &Path, bytes: &Vec<u8>| {
        measure(repeat, || {
            let copy = bytes.clone();
            let start = Instant::now();
            let recording = black_box(Recording::from_bytes(path, copy));
            (start.elapsed(), recording)
        })
    };
    report(timing("record of a TFRecord file to checked scene, one scene", read(record, &scenario), None))?;
    let json = read(scene, &recording.to_gpudrive()?.json);
    report(timing("JSON of GPUDrive to checked scene, one scene", json, None))?;
    let native = read(scene, &recording.to_native()?);
    report(timing("native file to checked scene, one scene", native, Some(0.4)))?;

    let chosen = spread(files, SCENES);
    let mut by_rule = RULES.map(|_| Vec::new());
    let (mut indexing, mut contexts, mut scoring, mut full, mut inspecting) =
        (vec![], vec![], vec![], vec![], vec![]);
    for path in chosen {
        let scene = Arc::new(data.scene(&path)?);
        if scene.frames <= NOW + HORIZON || scene.adversary.is_none() {
            continue;
        }
        indexing.extend(median(&measure(repeat, || {
            let start = Instant::now();
            let index = SceneIndex::new(scene.map.clone());
            index.boundaries();
            (start.elapsed(), index)
        })));
        let index = SceneIndex::new(scene.map.clone());
        index.build_all();
        let options = ContextOptions::default();
        contexts.extend(median(&measure(repeat, || {
            let start = Instant::now();
            let ctx = Context::new(&scene, &index, &options).map(black_box).is_ok();
            (start.elapsed(), ctx)
        })));
        let ctx = Context::new(&scene, &index, &options)?;
        let trajectories = arcs(&scene, CANDIDATES)?;
        let rules: Registry<dyn Feasibility> = sage_core::objective::feasibilities()?;
        let rule = rules.build_default("paper")?;
        scoring.extend(median(&measure(repeat, || {
            let start = Instant::now();
            let sum = rewards_and_feasibility(&ctx, rule.as_ref(), &trajectories);
            (start.elapsed(), sum)
        })));
        let candidates: Vec<Candidate> = trajectories.iter().map(|t| ctx.candidate(t.clone())).collect();
        for ((name, _), times) in RULES.iter().zip(&mut by_rule) {
            let rule = rules.build_default(name)?;
            times.extend(median(&measure(repeat, || {
                let start = Instant::now();
                let count: usize = candidates.iter().map(|c| rule.violations(c, &ctx).len()).sum();
                (start.elapsed(), black_box(count))
            })));
        }
        let scorer = Scorer::new(&ctx);
        full.extend(median(&measure(repeat.div_ceil(5), || {
            let start = Instant::now();
            for t in &trajectories {
                black_box(scorer.scores(&ctx.candidate(t.clone())));
            }
            (start.elapsed(), ())
        })));
        inspecting.extend(median(&measure(repeat.div_ceil(5), || {
            let start = Instant::now();
            let summary = Summary::of("scene", &scene);
            (start.elapsed(), summary)
        })));
    }
    if scoring.is_empty() {
        bail!("none of the scenes has an adversary and all 91 frames");
    }
    report(timing("index of the map for scoring, median of scenes", indexing, Some(2.0)))?;
    report(timing("context of a scene, median of scenes", contexts, None))?;
    report(timing("paper rewards and feasibility, 32 candidates, median of scenes", scoring, Some(1.0)))?;
    for ((_, row), times) in RULES.into_iter().zip(by_rule) {
        report(timing(row, times, None))?;
    }
    report(timing("every measure of `score`, 32 candidates, median of scenes", full, None))?;
    report(timing("summary and warnings of a scene, median of scenes", inspecting, None))?;

    network_speed::run(data, repeat, &mut report)?;
    simulation_speed::run(data, repeat, &mut report)?;
    learning_speed::run(repeat, &mut report)?;

    if files.len() > 1 {
        let start = Instant::now();
        let mut tracks = 0;
        let read = |path: &Path| Recording::read(path).map(|r| Summary::of("scene", &r.scene));
        folder::in_order(files, read, |_, summary| {
            tracks += summary?.tracks.len();
            Ok::<(), sage_data::Error>(())
        })?;
        black_box(tracks);
        let elapsed = start.elapsed().as_secs_f64() * 1e3;
        let target = (files.len() == 430).then_some(4000.0);
        report(timing("all scenes inspected, all threads", vec![elapsed], target))?;
    }
    Ok(())
}

/// Times drivers on all scenes.
///
/// *Errors*: a scene cannot be read or driven.
pub fn drivers(data: &Data, egos: &[Ego], mut report: impl FnMut(Timing) -> Result<()>) -> Result<()> {
    simulation_speed::drivers(data, egos, &mut report)
}

/// Feasibility rules that are timed.
const RULES: [(&str, &str); 2] = [
    ("paper", "rule `paper`, 32 candidates, median of scenes"),
    ("drivable", "rule `drivable`, 32 candidates, median of scenes"),
];

/// The paper's measures of candidates, as a generator computes them.
pub fn rewards_and_feasibility(ctx: &Context, rule: &dyn Feasibility, trajectories: &[Trajectory]) -> f64 {
    let value = |trajectory: &Trajectory| {
        let candidate: Candidate = ctx.candidate(trajectory.clone());
        let reward = Encounter::of(&candidate, ctx.ego()).reward(ctx.convention());
        let penalty = realism_penalty(candidate.profile());
        let feasible = rule.is_feasible(&candidate, ctx);
        reward - penalty + f64::from(u8::from(feasible))
    };
    trajectories.iter().map(value).sum()
}

/// Drivable arcs from the adversary's state *now*: constant yaw rate and acceleration, seeded.
///
/// *Errors*: the scene has no adversary.
pub fn arcs(scene: &Scene, n: usize) -> Result<Vec<Trajectory>> {
    let adversary = scene.adversary()?;
    let [vx, vy] = adversary.velocity[NOW];
    let speed = vx.hypot(vy);
    let mut rng = Rng::new(1, &scene.id, "bench arcs");
    let mut arcs = Vec::with_capacity(n);
    for k in 0..n {
        let mut at = adversary.point(NOW);
        let (mut heading, mut v) = (adversary.heading[NOW], speed);
        let (yaw_rate, gain) = (rng.uniform(-0.2, 0.2), rng.uniform(-2.0, 2.0));
        let points = (0..HORIZON)
            .map(|_| {
                v = (v + gain * DT).clamp(0.0, 30.0);
                heading += if v > 0.0 { yaw_rate * DT } else { 0.0 };
                at = [at[0] + v * DT * heading.cos(), at[1] + v * DT * heading.sin()];
                at
            })
            .collect();
        arcs.push(Trajectory::new(&format!("arc {k}"), points)?);
    }
    Ok(arcs)
}

/// About `n` evenly spaced items.
fn spread(files: &[PathBuf], n: usize) -> Vec<PathBuf> {
    let step = files.len().div_ceil(n).max(1);
    files.iter().step_by(step).cloned().collect()
}

/// Times of CPython's own reader, milliseconds; `None` without Python and numpy. The pickle must be one
/// that we wrote.
fn python_loads(pickle: &[u8], repeat: usize) -> Option<Vec<f64>> {
    const PROGRAM: &str = "import pickle, sys, time\n\
        import numpy\n\
        data = sys.stdin.buffer.read()\n\
        pickle.loads(data)\n\
        for _ in range(int(sys.argv[1])):\n\
        \x20   start = time.perf_counter(); value = pickle.loads(data); print((time.perf_counter() - start) * 1e3)\n";
    let mut child = Command::new("python3")
        // Isolated mode: no module of the current folder can shadow numpy.
        .args(["-I", "-c", PROGRAM])
        .arg(repeat.to_string())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    // The program reads all input before it writes, so this cannot deadlock.
    child.stdin.take()?.write_all(pickle).ok()?;
    let run = child.wait_with_output().ok()?;
    let text = String::from_utf8(run.stdout).ok().filter(|_| run.status.success())?;
    text.lines().map(|line| line.parse().ok()).collect()
}
