//! The driver that generators may query: its drives are those of a test, whatever was asked before.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::sync::Arc;

use sage_core::{
    generator::DriverUnderTest as _,
    motion::{HORIZON, NOW, Trajectory},
    scene::SceneIndex,
};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    policy::{EgoPolicy, policies},
    queried::QueriedDriver,
};

fn scene(kind: Kind, seed: u64) -> Arc<SimScene> {
    let scene = Arc::new(generate(kind, seed, 0).unwrap());
    SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone())).unwrap()
}

fn policy(name: &str) -> Box<dyn EgoPolicy> {
    policies().unwrap().build_default(name).unwrap()
}

/// From the adversary's place now straight to where the recorded ego is after some steps, and on.
fn plan(scene: &SimScene, meets: usize) -> Trajectory {
    let scene = scene.scene();
    let [x, y] = scene.adversary().unwrap().point(NOW);
    let [to_x, to_y] = scene.ego().point(NOW + meets);
    let at = |step: usize| {
        let share = step as f64 / meets as f64;
        [x + share * (to_x - x), y + share * (to_y - y)]
    };
    Trajectory::new("straight", (1..=HORIZON).map(at).collect()).unwrap()
}

#[test]
fn its_drives_are_those_of_the_test_in_any_order() {
    let mut hits = 0;
    for name in ["idm", "expert", "idm-release", "replay"] {
        let policy = policy(name);
        for (kind, seed) in [(Kind::FourWay, 1), (Kind::Straight, 2), (Kind::Roundabout, 1)] {
            let scene = scene(kind, seed);
            let test = AttackTest::new(&*policy, &scene, 3).unwrap();
            let driver = QueriedDriver::new(&test);
            let adversary = scene.scene().adversary_index().unwrap();
            for meets in [60, 25, 45, 60] {
                let plan = plan(&scene, meets);
                let driven = driver.drive(&plan).unwrap();
                let expected = test.attack(&plan, true).unwrap().episode;
                let positions = |pose: &Option<sage_core::motion::Pose>| pose.unwrap().position;
                let found: Vec<_> = driven.poses.iter().map(positions).collect();
                let all: Vec<_> = expected.drive.motions.iter().map(|motion| motion.position).collect();
                assert_eq!(found, all, "{name}, {kind:?}, {meets}");
                let is_hit = expected.first_contacts().any(|c| c.contact.other.track == adversary);
                assert_eq!(driven.hits_adversary, is_hit);
                hits += usize::from(is_hit);
            }
        }
    }
    assert!(hits > 10, "some plans hit: {hits}");
}
