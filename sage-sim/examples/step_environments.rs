//! Steps per second of environments in Rust, for comparison with those in Python (`sage-python/measure_gym.py`).
//!
//! `step_environments FILE...` steps one environment a scene in lockstep, then one after another, then a single one through all
//! scenes, each 20 000 steps, and prints a line of JSON: steps per second of CPU time, and the sums of the rewards.

#![allow(clippy::print_stdout)] // The program prints its result.

use std::{error::Error, path::Path, sync::Arc, time::Instant};

use sage_core::scene::SceneIndex;
use sage_data::Recording;
use sage_sim::{
    SimScene,
    batch::{AutoReset, Batch, BatchOptions, BatchOutput, Reset, SceneOrder, Setting},
    environment::EnvironmentOptions,
};

const STEPS: usize = 20_000;

fn main() -> Result<(), Box<dyn Error>> {
    let mut scenes = Vec::new();
    for file in std::env::args().skip(1) {
        let scene = Arc::new(Recording::read(Path::new(&file))?.scene);
        let index = SceneIndex::new(scene.map.clone());
        index.build_all();
        scenes.push(SimScene::new(scene, index)?);
    }
    let count = scenes.len();
    let mut rows = Vec::new();
    for (name, count, auto_reset, together) in [
        ("lockstep", count, AutoReset::SameStep, true),
        ("roll_out", count, AutoReset::SameStep, false),
        ("single", 1, AutoReset::Off, true),
    ] {
        let setting = Setting {
            scenes: Arc::new(scenes.clone()),
            order: SceneOrder::Sequential { first: 0, workers: count },
            rules: Arc::new(EnvironmentOptions::training()),
            adversary: None,
        };
        let options = BatchOptions { count, auto_reset, share_experience: false, parallel: false };
        let mut batch = Batch::new(setting, options)?;
        let mut out = BatchOutput::default();
        // The first round builds what a scene keeps.
        for _ in 0..2 {
            batch.reset_all(0, &mut out)?;
            let (clock, mut rewards) = (Instant::now(), 0.0);
            let steps = STEPS / count;
            if together {
                for step in 0..steps {
                    batch.step(&vec![action(step); count], &mut out)?;
                    rewards += out.rewards.iter().sum::<f64>();
                    if auto_reset == AutoReset::Off && (out.terminated[0] || out.truncated[0]) {
                        batch.reset(&[Reset { number: 0, seed: None, scene: None }], &mut out)?;
                    }
                }
            } else {
                // As many steps as a policy gradient takes before an update.
                for first in (0..steps).step_by(125) {
                    let own: Vec<_> = (first..first + 125).map(action).collect();
                    batch.roll_out(125, &own.repeat(count), &mut out)?;
                    rewards += out.rewards.iter().sum::<f64>();
                }
            }
            let rate = (steps * count) as f64 / clock.elapsed().as_secs_f64();
            rows.push((name, rate, rewards));
        }
    }
    let rows: Vec<String> = rows
        .iter()
        .skip(1)
        .step_by(2)
        .map(|(name, rate, rewards)| format!(r#""{name}": {rate:.0}, "{name}_rewards": {rewards:.3}"#))
        .collect();
    println!("{{{}}}", rows.join(", "));
    Ok(())
}

/// The action of a step, which Python computes as well.
fn action(step: usize) -> [f32; 2] {
    [((step * 7 % 11) as f32 - 5.0) / 50.0, ((step * 5 % 13) as f32 - 3.0) / 20.0]
}
