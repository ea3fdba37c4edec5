//! Times of the networks: features, prediction and training, on the shipped scene, or on a recorded one if
//! `SAGE_DATA` names the unpacked folder. If cargo starts it, candle uses one thread.

use std::{path::PathBuf, sync::Arc};

use criterion::{Criterion, criterion_group, criterion_main};
use sage_backbones::{
    backbones,
    candidates::Sampling,
    nn::AdamWConfig,
    prediction::predict,
    training::{Trainer, recorded_sample, trainable},
};
use sage_core::{scene::SceneData, seed::Rng};
use sage_data::Recording;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn networks(c: &mut Criterion) {
    let path = match std::env::var_os("SAGE_DATA") {
        Some(data) => PathBuf::from(data).join("pretrain/0.pkl"),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.pkl"),
    };
    let scene = Recording::read(&path).expect("the scene is there").scene;
    let target = scene.adversary.expect("it has an adversary");
    let data = SceneData::new("bench", scene);
    data.index.build_all();
    let registry = backbones().expect("no two of one name");
    let mut group = c.benchmark_group("networks");
    group.sample_size(20);
    for name in ["densetnt", "query-transformer", "lane-graph"] {
        let network = registry.build_default(name).expect("its defaults are sound");
        let features_of_target = || network.features(&data.observe()?, target, None);
        let features = Arc::new(features_of_target().expect("the adversary is there now"));
        group.bench_function(format!("{name}: features"), |b| b.iter(features_of_target));
        group.bench_function(format!("{name}: 32 candidates"), |b| {
            b.iter(|| predict(&*network, features.clone(), 32, Sampling::TopK, &mut Rng::new(0, "", "")));
        });
    }
    let network = registry.build_default("densetnt").expect("its defaults are sound");
    let sample = recorded_sample(&data, target, trainable(&*network).expect("it learns"))
        .expect("the adversary is there now");
    let trained = |name: &str| network.parameter_group(name).is_pretrained();
    let mut trainer = Trainer::new(&*network, trained, AdamWConfig::default()).expect("it is a CPU");
    group.bench_function("densetnt: forward, backward, update", |b| {
        b.iter(|| {
            let loss = trainer.trainable()?.loss(&sample)?;
            let gradient = trainer.gradient(&loss, "bench")?;
            trainer.update(&[gradient], 1e-4, 5.0)
        });
    });
    group.finish();
}

criterion_group!(benches, networks);
criterion_main!(benches);
