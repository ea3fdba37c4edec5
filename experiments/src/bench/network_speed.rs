//! Times of the networks: features, prediction, and a training step.

use std::{hint::black_box, path::PathBuf, sync::Arc, time::Instant};

use advsage::{Registries, generators::Generators, part::Part, selection};
use anyhow::{Context as _, Result};
use rayon::prelude::*;
use sage_backbones::{
    Backbone, backbones,
    candidates::Sampling,
    features::Features,
    nn::AdamWConfig,
    prediction::predict,
    training::{Examples, Trainer, recorded_sample, trainable},
};
use sage_core::{
    generator::{Generator, Mixture, OperatingPoint},
    objective::{Context, ContextOptions, Encounter},
    registry::Registry,
    scene::SceneData,
    seed::Rng,
    statistics::median,
};
use sage_merging::InterpolatedModel;
use sage_run::networks;
use sage_sim::avoidable::{Avoidance, AvoidanceOptions};

use super::timing::{CANDIDATES, Data, Timing, measure, timing};

/// Number of goals in published times.
const GOALS: usize = 2000;
/// Scenes of published times.
const PUBLISHED: [&str; 3] = ["0", "5", "18"];
/// Predictions distributed over threads.
const BATCH: usize = 32;

/// One scene with its adversary as the target.
struct Case {
    data: SceneData,
    target: usize,
}

/// Times the default network and the published one.
///
/// *Errors*: a scene cannot be read, or no scene has an adversary to predict.
pub(super) fn run(data: &Data, repeat: usize, mut report: impl FnMut(Timing) -> Result<()>) -> Result<()> {
    let files = data.files();
    let is_published =
        |file: &&PathBuf| PUBLISHED.iter().any(|name| file.file_stem().is_some_and(|stem| stem == *name));
    let mut chosen: Vec<&PathBuf> = files.iter().filter(is_published).collect();
    if chosen.is_empty() {
        chosen = files.iter().take(PUBLISHED.len()).collect();
    }
    let mut cases = Vec::new();
    for file in chosen {
        let data = SceneData::new(file.display().to_string(), data.scene(file)?);
        data.index.build_all();
        let usable = Examples::of(std::slice::from_ref(&data));
        let target = usable.list().iter().find(|e| Some(e.track) == data.scene.adversary).map(|e| e.track);
        cases.extend(target.map(|target| Case { data, target }));
    }
    let registry = backbones()?;
    let ours = registry.build_default("densetnt")?;
    let published = registry.build_default("densetnt-cat")?;
    cases.first().context("none of the scenes has an adversary to predict")?;

    report(timing(
        "features of one target, median of scenes",
        over(&cases, repeat, |case| Ok(ours.features(&case.data.observe()?, case.target, None)?))?,
        Some(1.0),
    ))?;
    report(timing(
        "predict: 2000 goals scored, 32 decoded, median of scenes",
        forward(&*ours, &cases, repeat)?,
        Some(6.0),
    ))?;
    report(timing(
        "training step: forward, backward, update, 2000 goals, median of scenes",
        step(&*ours, &cases, repeat)?,
        Some(24.0),
    ))?;
    let second = registry.build_default("query-transformer")?;
    report(timing("query-transformer: predict, median of scenes", forward(&*second, &cases, repeat)?, None))?;
    report(timing(
        "densetnt-cat: predict, 2000 goals, median of scenes",
        forward(&*published, &cases, repeat.div_ceil(4))?,
        None,
    ))?;
    report(timing(
        "densetnt-cat: training step, 2000 goals, median of scenes",
        step(&*published, &cases, repeat.div_ceil(4))?,
        None,
    ))?;

    attacks(&registry, &cases, repeat, &mut report)?;

    let batch = features(&*ours, &cases[0])?;
    for (name, threads) in [("32 predictions, one thread", 1), ("32 predictions, two threads", 2)] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let all = |features: &Arc<Features>| {
            (0..BATCH).into_par_iter().with_max_len(1).for_each(|_| {
                let _ = black_box(predict(
                    &*ours,
                    features.clone(),
                    CANDIDATES,
                    Sampling::TopK,
                    &mut Rng::new(0, "", ""),
                ));
            });
        };
        let times = measure(repeat.div_ceil(5), || {
            let start = Instant::now();
            pool.install(|| all(&batch));
            (start.elapsed(), ())
        });
        report(timing(name, times, None))?;
    }
    Ok(())
}

/// Times an attack and a change of λ, with the experts in the binary.
fn attacks(
    registry: &Registry<dyn Backbone>,
    cases: &[Case],
    repeat: usize,
    report: &mut impl FnMut(Timing) -> Result<()>,
) -> Result<()> {
    let experts = networks::load_experts(registry, "procedural")?;
    let registries = Registries::shipped()?;
    let selection = selection::Selection::of(&registries, "natural", None)?;
    let generators = Generators::new(&registries, &Part::named("linear"), &selection, 0)?;
    let generators = generators.with_experts(&experts);
    let inputs = generators.inputs();
    let sage = registries.generators.build_default("sage")?.build(inputs)?;
    let at = |lambda: f64| OperatingPoint::at(lambda, lambda);
    let sweep: Vec<OperatingPoint> = (0..11).map(|k| at(f64::from(k) / 10.0)).collect();
    let half = [at(0.5)];
    let (mut attacks, mut sweeps) = (Vec::new(), Vec::new());
    for case in cases {
        let ctx = Context::new(&case.data.scene, &case.data.index, &ContextOptions::default())?;
        let case = std::slice::from_ref(case);
        attacks.extend(over(case, repeat, |_| Ok(sage.attacks(&ctx, &half, 0)?))?);
        sweeps.extend(over(case, repeat.div_ceil(4), |_| Ok(sage.attacks(&ctx, &sweep, 0)?))?);
    }
    ways_out(&*sage, cases, repeat, report)?;
    let further: Vec<f64> = sweeps.iter().zip(&attacks).map(|(all, one)| (all - one) / 10.0).collect();
    report(timing("attack: indexed scene to selected trajectory, median of scenes", attacks, Some(10.0)))?;
    report(timing("attack: each further lambda of eleven, median of scenes", further, None))?;
    for (name, target) in [("king", 20.0), ("adv-traj-opt", 10.0), ("rule", 1.0)] {
        let generator = registries.generators.build_default(name)?.build(inputs)?;
        let mut times = Vec::new();
        for case in cases {
            let ctx = Context::new(&case.data.scene, &case.data.index, &ContextOptions::default())?;
            let case = std::slice::from_ref(case);
            times.extend(over(case, repeat.div_ceil(4), |_| Ok(generator.attacks(&ctx, &half, 0)?))?);
        }
        report(timing(format!("attack by `{name}`, median of scenes"), times, Some(target)))?;
    }
    for entry in registries.mergers.entries() {
        let merger = registries.mergers.build_default(entry.name)?;
        let Some(tensors) = merger.tensors() else { continue };
        let mut model = InterpolatedModel::new(&experts, tensors, 0)?;
        let mut lambda = 0.0;
        let changes = measure(repeat, || {
            lambda = (lambda + 0.37) % 1.0;
            let at = Mixture::between(lambda);
            let start = Instant::now();
            let changed = model.set(&at);
            (start.elapsed(), black_box(changed))
        });
        report(timing(format!("change of lambda in place, merger {}", entry.name), changes, Some(1.0)))?;
    }
    Ok(())
}

/// Times the search for evasive manoeuvres: from the selected attack, and from its first candidates that hit the ego.
fn ways_out(
    sage: &dyn Generator,
    cases: &[Case],
    repeat: usize,
    report: &mut impl FnMut(Timing) -> Result<()>,
) -> Result<()> {
    let (mut one, mut many) = (Vec::new(), Vec::new());
    for case in cases {
        let ctx = Context::new(&case.data.scene, &case.data.index, &ContextOptions::default())?;
        let attack = sage.attacks(&ctx, &[OperatingPoint::at(1.0, 1.0)], 0)?.remove(0);
        let chosen = ctx.candidate(attack.trajectory().clone());
        if Encounter::of(&chosen, ctx.ego()).contact.is_none() {
            continue;
        }
        let all = attack.candidates.iter().take(CANDIDATES).map(|p| ctx.candidate(p.trajectory.clone()));
        let all: Vec<_> = all.collect();
        let (case, repeat) = (std::slice::from_ref(case), repeat.div_ceil(10));
        let search = || Avoidance::new(&ctx, AvoidanceOptions::default());
        one.extend(over(case, repeat, |_| Ok(search()?.of(&chosen)))?);
        many.extend(over(case, repeat, |_| {
            let search = search()?;
            Ok(all.iter().map(|candidate| search.of(candidate)).collect::<Vec<_>>())
        })?);
    }
    report(timing("avoidable: one attack, median of scenes", one, Some(5.0)))?;
    report(timing("avoidable: 32 candidates, median of scenes", many, Some(60.0)))
}

/// Features with exactly [`GOALS`] goals: the goals of the case, repeated.
fn features(network: &dyn Backbone, case: &Case) -> Result<Arc<Features>> {
    let features = network.features(&case.data.observe()?, case.target, None)?;
    let keep: Vec<usize> = (0..features.modes()).cycle().take(GOALS).collect();
    Ok(Arc::new(features.with_goals(&keep)))
}

/// The median time of each case, milliseconds.
fn over<T>(cases: &[Case], repeat: usize, mut run: impl FnMut(&Case) -> Result<T>) -> Result<Vec<f64>> {
    let mut medians = Vec::new();
    for case in cases {
        // This run returns errors; the timed runs ignore them.
        run(case)?;
        medians.extend(median(&measure(repeat, || {
            let start = Instant::now();
            let result = run(case);
            (start.elapsed(), black_box(result))
        })));
    }
    Ok(medians)
}

fn forward(network: &dyn Backbone, cases: &[Case], repeat: usize) -> Result<Vec<f64>> {
    let mut medians = Vec::new();
    for case in cases {
        let features = features(network, case)?;
        medians.extend(over(std::slice::from_ref(case), repeat, |_| {
            Ok(predict(network, features.clone(), CANDIDATES, Sampling::TopK, &mut Rng::new(0, "", ""))?)
        })?);
    }
    Ok(medians)
}

fn step(network: &dyn Backbone, cases: &[Case], repeat: usize) -> Result<Vec<f64>> {
    let mut medians = Vec::new();
    for case in cases {
        let mut sample = recorded_sample(&case.data, case.target, trainable(network)?)?;
        let all = Arc::unwrap_or_clone(sample.features);
        let keep: Vec<usize> = (0..all.modes()).cycle().take(GOALS).collect();
        sample.features = Arc::new(all.with_goals(&keep));
        let mut trainer = Trainer::new(
            network,
            |name| network.parameter_group(name).is_pretrained(),
            AdamWConfig::default(),
        )?;
        medians.extend(over(std::slice::from_ref(case), repeat, |_| {
            let loss = trainer.trainable()?.loss(&sample)?;
            let gradient = trainer.gradient(&loss, "bench")?;
            Ok(trainer.update(&[gradient], 1e-4, 5.0)?)
        })?);
    }
    Ok(medians)
}
