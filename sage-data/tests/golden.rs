//! Values of the published functions on real scenes: 250 trajectories on 50 scenes in both conventions.
//! Needs `SAGE_DATA` (the unpacked scenes) and `SAGE_REFERENCE` (the fixtures).

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod real;

use std::collections::HashMap;
use std::sync::Arc;

use sage_core::{
    motion::Trajectory,
    objective::{Context, ContextOptions, Convention, Encounter, LoggedProfile, Scorer, Violations},
    scene::SceneIndex,
};
use serde::Deserialize;

#[derive(Deserialize)]
struct Golden {
    entries: Vec<Entry>,
}

#[derive(Deserialize)]
struct Entry {
    scene: u32,
    split: String,
    kind: String,
    trajectory: Vec<[f64; 2]>,
    outputs: Release,
    outputs_correct_boxes: CorrectBoxes,
    outputs_paper: Paper,
}

#[derive(Deserialize)]
struct Release {
    adv_reward: f64,
    collision: bool,
    kinematic_penalty: f64,
    behavior_penalty: f64,
    cross_solid_line: f64,
    crash_object: f64,
    wd_vel: f64,
    wd_acc: f64,
    wd_yaw_rate: f64,
    wd_vel_script: f64,
    wd_acc_script: f64,
    wd_yaw_rate_script: f64,
}

#[derive(Deserialize)]
struct CorrectBoxes {
    cross_solid_line: f64,
    crash_object: f64,
    collision: bool,
}

#[derive(Deserialize)]
struct Paper {
    adv_reward: f64,
    collision: bool,
    collision_step: usize,
    min_distance: f64,
    kinematic_penalty: f64,
    behavior_penalty: f64,
    cross_boundary_step: usize,
    crash_any_step: usize,
    crash_vehicle_step: usize,
    crash_static_step: usize,
    feasible: bool,
}

/// Relative 1e-9, absolute 1e-12 near zero: the tolerance of the fixture's own double check.
fn close(what: &str, found: f64, expected: f64) {
    let tolerance = (1e-9 * expected.abs()).max(1e-12);
    assert!((found - expected).abs() <= tolerance, "{what}: {found} instead of {expected}");
}

#[test]
fn published_and_independent_values_are_reproduced() {
    let Some(data) = real::data() else { return };
    let Some(golden) = real::reference("sage_release_golden.json") else { return };
    let golden: Golden = serde_json::from_slice(&std::fs::read(golden).unwrap()).unwrap();
    assert_eq!(golden.entries.len(), 250);
    let mut scenes = HashMap::new();
    for entry in &golden.entries {
        let path = data.join(&entry.split).join(format!("{}.pkl", entry.scene));
        scenes.entry(entry.scene).or_insert_with(|| {
            Arc::new(sage_data::Recording::read(&path).unwrap().scene.as_observed().into_owned())
        });
    }
    for entry in &golden.entries {
        let what = |field: &str| format!("scene {} {}: {field}", entry.scene, entry.kind);
        let scene = &scenes[&entry.scene];
        let index = SceneIndex::new(scene.map.clone());
        let trajectory = Trajectory::new("golden", entry.trajectory.clone()).unwrap();
        let context = |convention, mirrored_boxes| {
            let options = ContextOptions { convention, mirrored_boxes, ..ContextOptions::default() };
            Context::new(scene, &index, &options).unwrap()
        };

        let ctx = context(Convention::Release, None);
        let found = Scorer::new(&ctx).scores(&ctx.candidate(trajectory.clone()));
        let expected = &entry.outputs;
        assert_eq!(found.collision, Some(expected.collision), "{}", what("collision"));
        assert_eq!(found.cross_line, Some(expected.cross_solid_line), "{}", what("cross_line"));
        assert_eq!(found.crash_object, expected.crash_object, "{}", what("crash_object"));
        let distances = found.distances;
        for (field, found, expected) in [
            ("adversarial_reward", found.adversarial_reward, expected.adv_reward),
            ("kinematic_penalty", found.kinematic_penalty, expected.kinematic_penalty),
            ("behavior_penalty", found.behavior_penalty, expected.behavior_penalty),
            ("wd_speed", distances.wd_speed.unwrap(), expected.wd_vel),
            ("wd_acceleration", distances.wd_acceleration.unwrap(), expected.wd_acc),
            ("wd_yaw_rate", distances.wd_yaw_rate.unwrap(), expected.wd_yaw_rate),
        ] {
            close(&what(&format!("release {field}")), found, expected);
        }
        let published = LoggedProfile::published(ctx.adversary());
        let distances = published.distances(&ctx.candidate(trajectory.clone()), Convention::Release);
        for (field, found, expected) in [
            ("wd_vel_script", distances.wd_speed, expected.wd_vel_script),
            ("wd_acc_script", distances.wd_acceleration, expected.wd_acc_script),
            ("wd_yaw_rate_script", distances.wd_yaw_rate, expected.wd_yaw_rate_script),
        ] {
            close(&what(field), found.unwrap(), expected);
        }

        let ctx = context(Convention::Release, Some(false));
        let found = Scorer::new(&ctx).scores(&ctx.candidate(trajectory.clone()));
        let expected = &entry.outputs_correct_boxes;
        assert_eq!(found.collision, Some(expected.collision), "{}", what("collision, right boxes"));
        assert_eq!(found.cross_line, Some(expected.cross_solid_line), "{}", what("cross_line, right boxes"));
        assert_eq!(found.crash_object, expected.crash_object, "{}", what("crash_object, right boxes"));

        let ctx = context(Convention::Paper, None);
        let candidate = ctx.candidate(trajectory);
        let found = Scorer::new(&ctx).scores(&candidate);
        let expected = &entry.outputs_paper;
        let step = |step: Option<usize>| step.unwrap_or(0);
        let violations = Violations::of(&candidate, &ctx);
        assert_eq!(found.collision, Some(expected.collision), "{}", what("paper collision"));
        // Beyond the paper, no plan turns by more than 90° in a frame, as some noisy ones do.
        let is_feasible = expected.feasible && candidate.half_turn().is_none();
        assert_eq!(found.feasible, is_feasible, "{}", what("paper feasible"));
        for (field, found, expected) in [
            ("collision_step", step(found.collision_step), expected.collision_step),
            ("boundary", step(violations.boundary.map(|c| c.step)), expected.cross_boundary_step),
            ("agent", step(violations.agent.map(|c| c.step)), expected.crash_any_step),
            ("vehicle", step(violations.vehicle.map(|c| c.step)), expected.crash_vehicle_step),
            ("static", step(violations.static_vehicle.map(|c| c.step)), expected.crash_static_step),
        ] {
            assert_eq!(found, expected, "{}", what(field));
        }
        for (field, found, expected) in [
            ("adversarial_reward", found.adversarial_reward, expected.adv_reward),
            ("kinematic_penalty", found.kinematic_penalty, expected.kinematic_penalty),
            ("behavior_penalty", found.behavior_penalty, expected.behavior_penalty),
        ] {
            close(&what(&format!("paper {field}")), found, expected);
        }
        // The fixture's least distance covers all steps, ours the steps up to the contact.
        if !expected.collision {
            let least = Encounter::of(&candidate, ctx.ego()).least_distance;
            close(&what("min_distance"), least, expected.min_distance);
        }
    }
}
