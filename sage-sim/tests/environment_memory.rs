//! Memory of the environment over many episodes, in a process of its own: other tests would disturb the measurement.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod driving;
mod hand_made;
mod reference;

use std::sync::Arc;

use sage_sim::{
    environment::{Environment, EnvironmentOptions},
    observation::LENGTH,
    vehicle::Action,
};

/// Resident memory, KiB, where the system tells it.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[test]
fn ten_thousand_resets_leave_memory_flat() {
    let scenes = driving::scenes();
    let options = Arc::new(EnvironmentOptions::training());
    let mut seen = [0.0; LENGTH];
    let mut reset = |count: usize| {
        for k in 0..count {
            let scene = scenes[k % scenes.len()].clone();
            let mut episode = Environment::reset(scene, options.clone(), None, k as u64).unwrap();
            episode.step(Action::default()).unwrap();
            episode.observe(&mut seen);
        }
    };
    reset(1000);
    let before = resident();
    reset(10_000);
    if let (Some(before), Some(after)) = (before, resident()) {
        assert!(after < before + 4096, "{before} KiB, then {after} KiB");
    }
}
