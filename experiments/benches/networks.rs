//! Times of the networks: features, prediction, training and attacks, on the shipped scene, or on a recorded one if
//! `SAGE_DATA` names the unpacked folder. If cargo starts it, candle uses one thread.

use std::{path::PathBuf, sync::Arc};

use advsage::{Registries, generators::Generators, part::Part, selection::Selection};
use criterion::{Criterion, criterion_group, criterion_main};
use sage_backbones::{
    backbones,
    candidates::Sampling,
    features::Features,
    nn::AdamWConfig,
    prediction::predict,
    training::{Trainer, recorded_sample, trainable},
};
use sage_core::{
    generator::OperatingPoint,
    objective::{Context, ContextOptions, Encounter},
    scene::SceneData,
    seed::Rng,
};
use sage_data::Recording;
use sage_run::networks::load_experts;
use sage_sim::avoidable::{Avoidance, AvoidanceOptions};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Number of goals in published times.
const GOALS: usize = 2000;

fn scene() -> SceneData {
    let path = match std::env::var_os("SAGE_DATA") {
        Some(data) => PathBuf::from(data).join("pretrain/0.pkl"),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.pkl"),
    };
    let data = SceneData::new("bench", Recording::read(&path).expect("the scene is there").scene);
    data.index.build_all();
    data
}

/// Features with exactly [`GOALS`] goals: those of the scene, repeated.
fn with_goals(features: &Features) -> Arc<Features> {
    let keep: Vec<usize> = (0..features.modes()).cycle().take(GOALS).collect();
    Arc::new(features.clone().with_goals(&keep))
}

fn networks(c: &mut Criterion) {
    let data = scene();
    let target = data.scene.adversary.expect("it has an adversary");
    let registry = backbones().expect("no two of one name");
    let mut group = c.benchmark_group("networks");
    group.sample_size(20);
    for name in ["densetnt", "query-transformer", "lane-graph"] {
        let network = registry.build_default(name).expect("its defaults are sound");
        let features_of_target = || network.features(&data.observe()?, target, None);
        let features = with_goals(&features_of_target().expect("the adversary is there now"));
        group.bench_function(format!("{name}: features"), |b| b.iter(features_of_target));
        group.bench_function(format!("{name}: predict, 2000 goals, 32 candidates"), |b| {
            b.iter(|| predict(&*network, features.clone(), 32, Sampling::TopK, &mut Rng::new(0, "", "")));
        });
    }
    let network = registry.build_default("densetnt").expect("its defaults are sound");
    let mut sample = recorded_sample(&data, target, trainable(&*network).expect("it learns"))
        .expect("the adversary is there now");
    sample.features = with_goals(&sample.features);
    let trained = |name: &str| network.parameter_group(name).is_pretrained();
    let mut trainer = Trainer::new(&*network, trained, AdamWConfig::default()).expect("it is a CPU");
    group.bench_function("densetnt: training step, 2000 goals", |b| {
        b.iter(|| {
            let loss = trainer.trainable()?.loss(&sample, &mut Rng::new(0, "", "loss"))?;
            let gradient = trainer.gradient(&loss, "bench")?;
            trainer.update(&[gradient], 1e-4, 5.0)
        });
    });
    group.finish();
}

fn attacks(c: &mut Criterion) {
    let (data, registries) = (scene(), Registries::shipped().expect("no two of one name"));
    let experts = load_experts(&registries.backbones, "procedural").expect("they are in the binary");
    let selection = Selection::of(&registries, "natural", None).expect("it is shipped");
    let generators =
        Generators::new(&registries, &Part::named("linear"), &selection, 0).expect("they are shipped");
    let generators = generators.with_experts(&experts);
    let ctx =
        Context::new(&data.scene, &data.index, &ContextOptions::default()).expect("it has an adversary");
    let mut group = c.benchmark_group("attacks");
    group.sample_size(20);
    for name in ["sage", "king", "adv-traj-opt", "rule"] {
        let generator = registries.generators.build_default(name).expect("it is shipped");
        let generator = generator.build(generators.inputs()).expect("it has its inputs");
        let at = |lambda: f64| generator.attacks(&ctx, &[OperatingPoint::at(lambda, lambda)], 0);
        group.bench_function(format!("{name}: indexed scene to selected trajectory"), |b| b.iter(|| at(0.5)));
        let chosen = ctx.candidate(at(1.0).expect("it attacks").remove(0).trajectory().clone());
        if name == "sage" && Encounter::of(&chosen, ctx.ego()).contact.is_some() {
            group.bench_function("avoidable: one attack", |b| {
                b.iter(|| Avoidance::new(&ctx, AvoidanceOptions::default()).map(|search| search.of(&chosen)));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, networks, attacks);
criterion_main!(benches);
