//! Values of the published functions on synthetic trajectories, lengths 1 to 80. Needs `SAGE_REFERENCE`.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod real;

use sage_core::{
    motion::{
        Pose,
        kinematics::{paper, release},
    },
    objective::{behavior_penalty, kinematic_penalty, release_reward},
};
use serde::Deserialize;

#[derive(Deserialize)]
struct Golden {
    synthetic: Synthetic,
}

#[derive(Deserialize)]
struct Synthetic {
    single: Vec<Single>,
    pairs: Vec<Pair>,
}

#[derive(Deserialize)]
struct Single {
    name: String,
    trajectory: Vec<[f64; 2]>,
    yaw: Vec<f64>,
    kinematic_penalty: f64,
    behavior_penalty: f64,
    speed: Vec<f64>,
    acc_magnitude: Vec<f64>,
    yaw_rate: Vec<f64>,
    paper: Option<Paper>,
}

#[derive(Deserialize)]
struct Paper {
    p0: [f64; 2],
    psi_log: f64,
    kinematic_penalty: f64,
    behavior_penalty: f64,
    speed: Vec<f64>,
    heading: Vec<f64>,
    yaw_rate: Vec<f64>,
    a_long: Vec<f64>,
}

#[derive(Deserialize)]
struct Pair {
    name: String,
    adv: Vec<[f64; 2]>,
    ego: Vec<[f64; 2]>,
    adv_length: f64,
    adv_width: f64,
    ego_length: f64,
    ego_width: f64,
    adv_reward: f64,
    collision: bool,
}

/// Relative 1e-9, absolute 1e-12 near zero. For differences of rounded numbers the tolerance is their own
/// rounding, scaled by 1 / dt per difference.
fn close(what: &str, found: &[f64], expected: &[f64], floor: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (k, (f, e)) in found.iter().zip(expected).enumerate() {
        assert!((f - e).abs() <= (1e-9 * e.abs()).max(floor), "{what}[{k}]: {f} instead of {e}");
    }
}

#[test]
fn synthetic_trajectories_have_the_published_values() {
    let Some(path) = real::reference("sage_release_golden.json") else { return };
    let Golden { synthetic } = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    assert_eq!((synthetic.single.len(), synthetic.pairs.len()), (13, 12));
    for case in &synthetic.single {
        let name = &case.name;
        let profile = release::profile(&case.trajectory);
        close(&format!("{name} yaw"), &release::headings(&case.trajectory), &case.yaw, 1e-12);
        close(&format!("{name} speed"), &profile.speed, &case.speed, 1e-12);
        close(&format!("{name} acceleration"), &profile.acceleration_norm, &case.acc_magnitude, 1e-11);
        close(&format!("{name} yaw rate"), &profile.yaw_rate, &case.yaw_rate, 1e-11);
        close(&format!("{name} P_kin"), &[kinematic_penalty(&profile)], &[case.kinematic_penalty], 1e-12);
        close(&format!("{name} P_beh"), &[behavior_penalty(&profile)], &[case.behavior_penalty], 1e-12);
        if let Some(expected) = &case.paper {
            let start = Pose { position: expected.p0, heading: expected.psi_log };
            let profile = paper::profile(&case.trajectory, &start);
            close(&format!("{name} paper speed"), &profile.speed, &expected.speed, 1e-12);
            close(&format!("{name} paper heading"), &profile.heading, &expected.heading, 1e-12);
            close(&format!("{name} paper yaw rate"), &profile.yaw_rate, &expected.yaw_rate, 1e-11);
            close(&format!("{name} paper acceleration"), &profile.acceleration, &expected.a_long, 1e-11);
            close(
                &format!("{name} paper P_kin"),
                &[kinematic_penalty(&profile)],
                &[expected.kinematic_penalty],
                1e-12,
            );
            close(
                &format!("{name} paper P_beh"),
                &[behavior_penalty(&profile)],
                &[expected.behavior_penalty],
                1e-12,
            );
        }
    }
    for case in &synthetic.pairs {
        let (reward, collision) = release_reward(
            &case.adv,
            [case.adv_length, case.adv_width],
            &case.ego,
            [case.ego_length, case.ego_width],
        );
        assert_eq!(collision, case.collision, "{}", case.name);
        close(&case.name, &[reward], &[case.adv_reward], 1e-12);
    }
}
