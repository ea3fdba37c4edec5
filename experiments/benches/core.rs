//! Times of reading and scoring, on the shipped scene, or on a recorded one if `SAGE_DATA` names the
//! unpacked folder.

use std::{hint::black_box, path::PathBuf, sync::Arc};

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use experiments::bench::speed::{CANDIDATES, arcs, rewards_and_feasibility};
use sage_core::{
    objective::{Context, ContextOptions, Scorer, feasibilities},
    scene::SceneIndex,
};
use sage_data::{Recording, checks::Summary, pickle::Document};

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
    group.bench_function("pickle to checked scene", |b| {
        b.iter_batched(|| bytes.clone(), |bytes| Recording::from_bytes(&path, bytes), BatchSize::LargeInput);
    });
    let recording = Recording::read(&path).expect("it is a scene");
    group.bench_function("scene to pickle", |b| b.iter(|| recording.to_pickle()));
    group.bench_function("summary and warnings", |b| b.iter(|| Summary::of("scene", &recording.scene)));
    group.finish();
}

fn scoring(c: &mut Criterion) {
    let scene = Arc::new(Recording::read(&scene_file()).expect("it is a scene").scene);
    let index = SceneIndex::new(scene.map.clone());
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
    let trajectories = arcs(&scene, CANDIDATES).expect("it has an adversary");
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

criterion_group!(benches, reading, scoring);
criterion_main!(benches);
