//! Laws of the environment: numbers in range, episodes that end.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::sync::Arc;

use hand_made::{car, prepared, road, scene};
use insta::assert_snapshot;
use sage_core::{scene::TrackKind, seed::Rng};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    environment::{Environment, EnvironmentOptions},
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
