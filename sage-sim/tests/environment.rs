//! Laws of the environment: numbers in range, the same bits at any number of threads, automatic resets that
//! keep the last observation, episodes that end.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::sync::Arc;

use hand_made::{car, prepared, road, scene};
use insta::assert_snapshot;
use sage_core::{scene::TrackKind, seed::Rng};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    environment::{AutoReset, Batch, BatchOutput, Environment, EnvironmentOptions},
    observation::LENGTH,
    vehicle::Action,
};

fn scenes() -> Vec<Arc<SimScene>> {
    Kind::ALL.iter().filter_map(|kind| generate(*kind, 1, 0)).map(prepared).collect()
}

fn presets() -> [EnvironmentOptions; 3] {
    ["default", "training", "metadrive"].map(|name| EnvironmentOptions::preset(name).unwrap())
}

fn action(rng: &mut Rng) -> [f32; 2] {
    [rng.uniform(-1.0, 1.0) as f32, rng.uniform(-1.0, 1.0) as f32]
}

#[test]
fn observations_are_101_finite_numbers_from_0_to_1() {
    for options in presets().map(Arc::new) {
        for scene in scenes() {
            let mut rng = Rng::new(3, "environment", "range");
            let mut episode = Environment::reset(scene, options.clone(), None, u64::MAX).unwrap();
            let mut seen = [f32::NAN; LENGTH];
            while !episode.is_over() {
                episode.observe(&mut seen);
                assert!(seen.iter().all(|x| (0.0..=1.0).contains(x)), "{seen:?}");
                let [steer, throttle] = action(&mut rng).map(f64::from);
                let outcome = episode.step(Action { steer, throttle }).unwrap();
                assert!(outcome.reward.is_finite() && !(outcome.terminated && outcome.truncated));
            }
            assert!(episode.step(Action::default()).is_err(), "an episode that is over does not step");
        }
    }
}

#[test]
fn the_same_seeds_give_the_same_bits_at_any_number_of_threads() {
    let run = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = Arc::new(EnvironmentOptions::training());
        let mut batch = Batch::new(scenes(), options, AutoReset::SameStep, 13, seed).unwrap();
        let (mut out, mut all) = (BatchOutput::default(), Vec::new());
        let mut rng = Rng::new(seed, "environment", "threads");
        for _ in 0..150 {
            let actions: Vec<[f32; 2]> = (0..batch.len()).map(|_| action(&mut rng)).collect();
            pool.install(|| batch.step(&actions, &mut out)).unwrap();
            all.extend(out.observations.iter().map(|x| x.to_bits()));
            all.extend(out.rewards.iter().flat_map(|x| [x.to_bits() as u32, (x.to_bits() >> 32) as u32]));
            all.extend(out.info.scenes.iter().map(|x| *x as u32));
        }
        all
    };
    let first = run(1, 5);
    assert!(first == run(2, 5) && first == run(5, 5));
    assert!(first != run(1, 6), "another seed gives other scenes");
}

#[test]
fn an_automatic_reset_keeps_the_last_observation() {
    let options = Arc::new(EnvironmentOptions::default());
    let mut batch = Batch::new(scenes(), options.clone(), AutoReset::SameStep, 4, 9).unwrap();
    let mut out = BatchOutput::default();
    batch.observe(&mut out);
    let mut single: Vec<Environment> = (0..4).map(|k| batch.environment(k).unwrap().clone()).collect();
    let mut ended = 0;
    for _ in 0..90 {
        batch.step(&[[0.1, 0.5]; 4], &mut out).unwrap();
        for k in 0..4 {
            let Some(environment) = single.get_mut(k).filter(|environment| !environment.is_over()) else {
                continue;
            };
            let outcome = environment.step(Action { steer: f64::from(0.1f32), throttle: 0.5 }).unwrap();
            let mut seen = [0.0; LENGTH];
            environment.observe(&mut seen);
            let rows = k * LENGTH..(k + 1) * LENGTH;
            assert_eq!((outcome.reward, outcome.completion), (out.rewards[k], out.info.completion[k]));
            if environment.is_over() {
                ended += 1;
                assert_eq!(out.final_observations[rows.clone()], seen);
                assert_ne!(out.observations[rows], seen);
                assert_eq!(batch.environment(k).unwrap().world().step_count(), 0);
            } else {
                assert_eq!(out.observations[rows], seen);
            }
        }
    }
    assert_eq!(ended, 4);
}

#[test]
fn without_automatic_reset_the_caller_chooses_the_next_scene() {
    let options = Arc::new(EnvironmentOptions { max_steps: 3, ..EnvironmentOptions::default() });
    let mut batch = Batch::new(scenes(), options, AutoReset::Off, 2, 1).unwrap();
    let mut out = BatchOutput::default();
    for _ in 0..3 {
        batch.step(&[[0.0, 0.0]; 2], &mut out).unwrap();
    }
    assert!(out.truncated.iter().all(|cut| *cut));
    assert_snapshot!(batch.step(&[[0.0, 0.0]; 2], &mut out).unwrap_err(), @"scene `four-way-1-0`: the episode is over; start another one");
    for k in 0..2 {
        batch.reset_one(k, Some(4), None).unwrap();
    }
    batch.step(&[[0.0, 0.0]; 2], &mut out).unwrap();
    assert_eq!(out.info.scenes, [4, 4]);
    assert!(batch.reset_one(2, None, None).is_err() && batch.reset_one(0, Some(99), None).is_err());
    assert_snapshot!(batch.step(&[[0.0, 0.0]], &mut out).unwrap_err(), @"actions: 1 points, expected 2");
    assert!(Batch::new(vec![], Arc::default(), AutoReset::Off, 1, 0).is_err());
}

#[test]
fn endings_tell_termination_from_truncation() {
    let drive = |scene: &Arc<SimScene>, options: EnvironmentOptions, throttle: f64| {
        let mut episode = Environment::reset(scene.clone(), Arc::new(options), None, 0).unwrap();
        loop {
            let outcome = episode.step(Action { steer: 0.0, throttle }).unwrap();
            if episode.is_over() {
                return (outcome, episode.world().step_count());
            }
        }
    };
    let ego = || car("ego", [0.0, 0.0], 0.0, 10.0);
    let free = prepared(scene(road(), vec![ego()]));
    // 0.95 of 90 m at 10 m/s and 1 m/s² or so: arrival.
    let (outcome, _) = drive(&free, EnvironmentOptions::default(), 0.4);
    assert!(outcome.terminated && outcome.arrived && outcome.reward == 10.0 && outcome.cost == 0.0);
    // Braked: the end of the log.
    let (outcome, steps) = drive(&free, EnvironmentOptions::default(), -1.0);
    assert!(outcome.truncated && !outcome.terminated && steps == 90);
    // MetaDrive lets it stand for 251 steps, and calls that a termination.
    let (outcome, steps) = drive(&free, EnvironmentOptions::metadrive(), -1.0);
    assert!(outcome.terminated && !outcome.truncated && steps == 251);
    // A standing car ahead: contact, which ends the episode only if asked to.
    let blocked = prepared(scene(road(), vec![ego(), car("wall", [40.0, 0.0], 0.0, 0.0)]));
    let ends = EnvironmentOptions { contact_ends: true, ..EnvironmentOptions::default() };
    let (outcome, _) = drive(&blocked, ends, 0.2);
    assert!(outcome.terminated && outcome.vehicle_contact && outcome.reward == -1.0 && outcome.cost == 1.0);
    let (outcome, steps) = drive(&blocked, EnvironmentOptions::default(), 0.2);
    assert!(outcome.truncated && steps == 90);
    // A pedestrian: reported, without consequence.
    let mut person = car("person", [40.0, 0.0], 0.0, 0.0);
    person.kind = TrackKind::Pedestrian;
    let mut episode =
        Environment::reset(prepared(scene(road(), vec![ego(), person])), Arc::default(), None, 0).unwrap();
    let touched = (0..60).filter(|_| episode.step(Action::default()).unwrap().human_contact).count();
    assert!(touched > 0 && !episode.is_over());
}

#[test]
fn options_read_back_and_refuse_unknown_keys() {
    for options in presets() {
        let text = serde_json::to_string(&options).unwrap();
        assert_eq!(serde_json::from_str::<EnvironmentOptions>(&text).unwrap(), options);
    }
    let error = serde_json::from_str::<EnvironmentOptions>(r#"{"world": {"late_poze": true}}"#).unwrap_err();
    assert_snapshot!(error, @"unknown field `late_poze`, expected one of `traffic`, `strength`, `lines`, `late_pose`, `airborne_start`, `flat`, `whole_physics` at line 1 column 22");
    assert!(EnvironmentOptions::preset("other").is_none());
}
