//! Times of the simulation, on the shipped scene, or on a recorded one if `SAGE_DATA` names the unpacked
//! folder.

use std::{hint::black_box, path::PathBuf, sync::Arc};

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use sage_core::{scene::SceneIndex, seed::Rng};
use sage_data::Recording;
use sage_sim::{
    SimScene,
    drive::{Simulation, drive},
    environment::{Environment, EnvironmentOptions},
    observation::LENGTH,
    policy::policies,
    vehicle::Action,
};

fn scene() -> Arc<SimScene> {
    let file = match std::env::var_os("SAGE_DATA") {
        Some(data) => PathBuf::from(data).join("pretrain/0.pkl"),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.pkl"),
    };
    let scene = Arc::new(Recording::read(&file).expect("it is a scene").scene);
    let index = SceneIndex::new(scene.map.clone());
    SimScene::new(scene, index).expect("the ego is valid at frame 0")
}

fn environment(c: &mut Criterion) {
    let scene = scene();
    let options = Arc::new(EnvironmentOptions::training());
    let reset = || Environment::reset(scene.clone(), options.clone(), None, 0).expect("the scene starts");
    let mut group = c.benchmark_group("environment");
    group.sample_size(20);
    group.bench_function("reset", |b| b.iter(reset));
    let start = reset();
    group.bench_function("step", |b| {
        b.iter_batched(|| start.clone(), |mut e| e.step(Action::default()), BatchSize::SmallInput);
    });
    for (name, sees) in [("an episode with observations", true), ("an episode", false)] {
        group.bench_function(name, |b| b.iter(|| episode(reset(), sees)));
    }
    let mut seen = [0.0; LENGTH];
    group.bench_function("observation", |b| b.iter(|| start.observe(black_box(&mut seen))));
    group.finish();
}

/// Drives an episode to its end with random actions. Returns its steps.
fn episode(mut episode: Environment, sees: bool) -> usize {
    let (mut rng, mut steps, mut seen) = (Rng::new(0, "bench", "actions"), 0, [0.0; LENGTH]);
    while !episode.is_over() {
        let action = Action { steer: rng.uniform(-0.1, 0.1), throttle: rng.uniform(-0.3, 0.6) };
        episode.step(action).expect("it is not over");
        if sees {
            episode.observe(black_box(&mut seen));
        }
        steps += 1;
    }
    steps
}

fn policy_drives(c: &mut Criterion) {
    let scene = scene();
    let registry = policies().expect("names are unique");
    let mut group = c.benchmark_group("a drive of 90 steps");
    group.sample_size(10);
    for name in ["replay", "idm", "expert", "pdm"] {
        let policy = registry.build_default(name).expect("it is registered");
        group.bench_function(name, |b| {
            b.iter(|| {
                let simulation = Simulation::new(&scene, &Arc::default(), None, policy.as_ref(), 0);
                drive(&mut simulation.expect("the scene starts"))
            });
        });
    }
    group.finish();
}

criterion_group!(benches, environment, policy_drives);
criterion_main!(benches);
