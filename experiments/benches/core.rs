//! Times of reading and scoring, on the shipped scene, or on a recorded one if `SAGE_DATA` names the
//! unpacked folder.

use std::{
    hint::black_box,
    path::{Path, PathBuf},
    sync::Arc,
};

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use sage_core::{
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::{
        Candidate, Context, ContextOptions, Encounter, Feasibility, Scorer, feasibilities, realism_penalty,
    },
    scene::{Scene, SceneIndex},
    seed::Rng,
};
use sage_data::{Recording, checks::Summary, pickle::Document, womd};

/// That of the command.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Number of candidates that are scored together.
const CANDIDATES: usize = 32;

fn scene_file() -> PathBuf {
    match std::env::var_os("SAGE_DATA") {
        Some(data) => PathBuf::from(data).join("pretrain/0.pkl"),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.pkl"),
    }
}

fn reading(c: &mut Criterion) {
    let path = scene_file();
    let bytes = std::fs::read(&path).expect("the scene is there");
    let mut group = c.benchmark_group("reading");
    group.sample_size(20);
    group.bench_function("pickle to values", |b| {
        b.iter_batched(|| bytes.clone(), Document::parse, BatchSize::LargeInput);
    });
    let recording = Recording::read(&path).expect("it is a scene");
    let native = recording.to_native().expect("it is whole");
    let json = recording.to_gpudrive().expect("it is whole").json;
    let record = womd::frame(&recording.to_scenario().expect("it is whole").data);
    // A record has the name of its shard.
    for (name, bytes, file) in [
        ("pickle", bytes, "scene"),
        ("native file", native, "scene"),
        ("JSON of GPUDrive", json, "scene"),
        ("record of a TFRecord file", record, "scene.tfrecord"),
    ] {
        group.bench_function(format!("{name} to checked scene"), |b| {
            let read = |bytes| Recording::from_bytes(Path::new(file), bytes);
            b.iter_batched(|| bytes.clone(), read, BatchSize::LargeInput);
        });
    }
    group.bench_function("scene to pickle", |b| b.iter(|| recording.to_pickle()));
    group.bench_function("summary and warnings", |b| b.iter(|| Summary::of("scene", &recording.scene)));
    group.finish();
}

fn scoring(c: &mut Criterion) {
    let scene = Arc::new(Recording::read(&scene_file()).expect("it is a scene").scene);
    let index = SceneIndex::new(scene.map.clone());
    index.build_all();
    let options = ContextOptions::default();
    let mut group = c.benchmark_group("scoring");
    group.sample_size(20);
    group.bench_function("boundaries indexed", |b| {
        b.iter_batched(
            || SceneIndex::new(scene.map.clone()),
            |index| black_box(index.boundaries().segments().len()),
            BatchSize::LargeInput,
        );
    });
    group.bench_function("context", |b| b.iter(|| Context::new(&scene, &index, &options).is_ok()));
    let ctx = Context::new(&scene, &index, &options).expect("it has an adversary");
    let rule = feasibilities().and_then(|rules| rules.build_default("paper")).expect("it is shipped");
    let trajectories = arcs(&scene);
    for name in ["paper", "drivable"] {
        let rule = feasibilities().and_then(|rules| rules.build_default(name)).expect("it is shipped");
        let candidates: Vec<Candidate> = trajectories.iter().map(|t| ctx.candidate(t.clone())).collect();
        group.bench_function(format!("rule {name}, 32 candidates"), |b| {
            b.iter(|| candidates.iter().map(|c| rule.violations(c, &ctx).len()).sum::<usize>());
        });
    }
    group.bench_function("paper rewards and feasibility, 32 candidates", |b| {
        b.iter(|| rewards_and_feasibility(&ctx, rule.as_ref(), &trajectories));
    });
    let scorer = Scorer::new(&ctx);
    group.bench_function("every measure, 32 candidates", |b| {
        b.iter(|| {
            trajectories
                .iter()
                .map(|t| scorer.scores(&ctx.candidate(t.clone())))
                .filter(|s| s.feasible)
                .count()
        });
    });
    group.finish();
}

/// The paper's measures of candidates, as a generator computes them.
fn rewards_and_feasibility(ctx: &Context, rule: &dyn Feasibility, trajectories: &[Trajectory]) -> f64 {
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
fn arcs(scene: &Scene) -> Vec<Trajectory> {
    let adversary = scene.adversary().expect("it has an adversary");
    let [vx, vy] = adversary.velocity[NOW];
    let mut rng = Rng::new(1, &scene.id, "bench arcs");
    let arc = |k: usize| {
        let (mut at, mut heading, mut v) = (adversary.point(NOW), adversary.heading[NOW], vx.hypot(vy));
        let (yaw_rate, gain) = (rng.uniform(-0.2, 0.2), rng.uniform(-2.0, 2.0));
        let points = (0..HORIZON).map(|_| {
            v = (v + gain * DT).clamp(0.0, 30.0);
            heading += if v > 0.0 { yaw_rate * DT } else { 0.0 };
            at = [at[0] + v * DT * heading.cos(), at[1] + v * DT * heading.sin()];
            at
        });
        Trajectory::new(&format!("arc {k}"), points.collect()).expect("it is finite")
    };
    (0..CANDIDATES).map(arc).collect()
}

criterion_group!(benches, reading, scoring);
criterion_main!(benches);
