//! Times of learning a driving policy: an update of TD3, an action, and a thousand steps of training by TD3 and by PPO.

use std::{sync::Arc, time::Instant};

use anyhow::Result;
use sage_core::{scene::SceneIndex, seed::Rng};
use sage_data::procedural::{Kind, generate};
use sage_learn::{
    Algorithm, PpoOptions, ReplayBuffer, Setting, Td3Learner, Td3Options, Training, TrainingOptions,
    TrainingState, Transition, TransitionBatch, curricula::curricula, scene_sampler::scene_samplers,
};
use sage_sim::{SimScene, actor::SingleRow, observation::LENGTH};

use super::timing::{Timing, measure, timing};

/// Transitions in the buffer of the row of an update.
const TRANSITIONS: usize = 100_000;
/// Updates or actions that one measurement takes together.
const TOGETHER: usize = 20;
/// Steps that a reported time of a training is for.
const STEPS: u64 = 1000;
/// Scenes of the trainings.
const SCENES: u64 = 14;

/// Times learning; the targets are those of a machine with AVX-512.
///
/// *Errors*: none on built-in scenes.
pub(super) fn run(repeat: usize, report: &mut impl FnMut(Timing) -> Result<()>) -> Result<()> {
    let options = Td3Options::default();
    let mut learner = Td3Learner::<f32>::new(options.clone(), [LENGTH, 2], 0)?;
    let buffer = filled();
    let mut batch = TransitionBatch::new(options.batch, LENGTH, 2);
    let (mut rows, mut noise) = (Rng::new(0, "speed", "batch"), Rng::new(0, "speed", "noise"));
    let each = |times: Vec<f64>| times.into_iter().map(|time| time / TOGETHER as f64).collect();
    let updates = measure(repeat, || {
        let start = Instant::now();
        for _ in 0..TOGETHER {
            buffer.draw(&mut rows, &mut batch);
            batch.noise.fill_with(|| noise.normal() as f32);
            learner.update(&batch);
        }
        (start.elapsed(), ())
    });
    report(timing("TD3: an update, batch 256, drawn from 100 000 transitions", each(updates), Some(4.0)))?;
    let (mut memory, mut action) = (SingleRow::default(), [0.0; 2]);
    let actions = measure(repeat, || {
        let start = Instant::now();
        (0..TOGETHER).for_each(|_| learner.act(&batch.observations[..LENGTH], &mut memory, &mut action));
        (start.elapsed(), ())
    });
    report(timing("TD3: an action", each(actions), Some(0.03)))?;
    let random = options.batch as u64;
    let count = repeat.div_ceil(25);
    let td3 = TrainingOptions {
        td3: Td3Options { random_steps: random, ..Td3Options::default() },
        updates: (count as u64 + 1) * STEPS,
        ..TrainingOptions::default()
    };
    let times = training(td3, random, [STEPS, count as u64])?;
    report(timing("TD3: 1000 steps of training, an update each, everything", times, Some(4000.0)))?;
    let batch = PpoOptions::default().batch() as u64;
    let ppo = TrainingOptions {
        algorithm: Algorithm::Ppo,
        ppo_steps: (count as u64 + 1) * batch,
        evaluations: 1,
        ..TrainingOptions::default()
    };
    let times = training(ppo, batch, [batch, count as u64])?;
    report(timing("PPO: 1000 steps of training, everything", times, Some(60.0)))
}

/// A buffer of random transitions.
fn filled() -> ReplayBuffer {
    let mut rng = Rng::new(0, "speed", "transitions");
    let mut observation = || -> Vec<f32> { (0..LENGTH).map(|_| rng.unit() as f32).collect() };
    let mut buffer = ReplayBuffer::new(TRANSITIONS, [LENGTH, 2]);
    let mut at = buffer.start(&observation());
    for _ in 0..TRANSITIONS {
        let (action, next) = ([0.1, -0.2], observation());
        at = buffer.step(&Transition {
            from: at,
            action: &action,
            reward: 0.5,
            is_terminal: false,
            next: &next,
        });
    }
    buffer
}

/// Milliseconds of a thousand steps of a training without attacks on procedural scenes, after some steps that do not count: a
/// number of measurements of so many steps each.
fn training(options: TrainingOptions, before: u64, [steps, count]: [u64; 2]) -> Result<Vec<f64>> {
    let kinds = Kind::ALL.iter().cycle();
    let scenes = (0..SCENES).zip(kinds).filter_map(|(number, kind)| generate(*kind, 0, number));
    let scenes: Vec<Arc<SimScene>> = scenes
        .map(|scene| {
            let index = SceneIndex::new(scene.map.clone());
            SimScene::new(Arc::new(scene), index)
        })
        .collect::<Result<_, _>>()?;
    let (curricula, samplers) = (curricula()?, scene_samplers()?);
    let (curriculum, sampler) = (curricula.build_default("paper")?, samplers.build_default("uniform")?);
    let state = TrainingState::new(&options, scenes.len())?;
    let setting = Setting {
        scenes: &scenes,
        evaluation: &[],
        attacker: None,
        examiner: None,
        curriculum: &*curriculum,
        sampler: &*sampler,
        teacher: None,
        second_kind: None,
    };
    let mut run = Training::new(options, setting, state);
    run.advance(before, |_| ())?;
    let mut times = Vec::new();
    for _ in 0..count {
        let (before, start) = (run.state().counters().steps, Instant::now());
        run.advance(before + steps, |_| ())?;
        // A part of the last episode comes on top.
        let steps = run.state().counters().steps - before;
        times.push(1e3 * start.elapsed().as_secs_f64() / steps as f64 * STEPS as f64);
    }
    Ok(times)
}
