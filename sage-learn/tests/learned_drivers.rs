//! What learnt drivers see, how their actions follow each other, and whether they stand without cause.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

#[path = "../../sage-sim/tests/hand_made/mod.rs"]
mod hand_made;

use std::sync::Arc;

use hand_made::{car, prepared, road, road_under_a_bridge, scene};
use sage_core::{scene::Track, seed::Rng};
use sage_learn::{Algorithm, PpoOptions, TrainingOptions};
use sage_sim::{
    SimScene,
    actor::{ActorPolicy, Network, PolicyCard, Shape, parse_policy, read_policy, write_policy},
    environment::{Environment, EnvironmentOptions},
    evaluation::drive_episode,
    observation::{LENGTH, ObservationKind},
    policy::policies,
};
use serde_json::json;

const CONTINUED: ObservationKind = ObservationKind::Continued;

fn on_road(tracks: Vec<Track>) -> Arc<SimScene> {
    prepared(scene(road(), tracks))
}

/// The numbers of the three road users that are described.
fn described(tracks: Vec<Track>) -> [[f64; 4]; 3] {
    let options = TrainingOptions { goes_on: true, ..TrainingOptions::default() }.rules().with_parked(true);
    let scene = prepared(scene(road_under_a_bridge(), tracks));
    let environment = Environment::reset(scene, Arc::new(options), None, 0).unwrap();
    let mut numbers = [0.0; LENGTH];
    environment.observe(&mut numbers);
    // Metres and metres a second again.
    let scales = [50.0, 50.0, 80.0 / 3.6, 80.0 / 3.6];
    std::array::from_fn(|k| {
        std::array::from_fn(|n| scales[n] * (2.0 * f64::from(numbers[59 + 4 * k + n]) - 1.0))
    })
}

fn assert_near(found: [f64; 4], expected: [f64; 4]) {
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() < 1e-4, "{found:?}, expected {expected:?}");
    }
}

#[test]
fn the_one_ahead_and_those_that_come_closest_are_described() {
    let ego = || car("ego", [0.0, 0.0], 0.0, 10.0);
    let ahead = car("ahead", [15.0, 0.0], 0.0, 0.0);
    let oncoming = car("oncoming", [48.0, 3.5], std::f64::consts::PI, 10.0);
    let parked = car("parked", [20.0, 6.0], 0.0, 0.0);
    // Near, but it never comes nearer.
    let beside = car("beside", [-8.0, 3.5], 0.0, 10.0);
    // On the bridge over the road.
    let mut above = car("above", [40.0, 0.0], 0.0, 0.0);
    above.position.iter_mut().for_each(|p| p[2] += 6.0);
    let [first, second, third] =
        described(vec![ego(), beside.clone(), parked, oncoming, ahead, above.clone()]);
    // From bumper to bumper: 15 m less twice half a length of 4.5 m.
    assert_near(first, [10.5, 0.0, -10.0, 0.0]);
    assert_near(second, [48.0, 3.5, -20.0, 0.0]);
    assert_near(third, [20.0, 6.0, -10.0, 0.0]);
    let [first, second, third] = described(vec![ego(), beside, above]);
    let absent = [50.0, 0.0, 0.0, 0.0];
    assert_near(first, absent);
    assert_near(second, [-8.0, 3.5, 0.0, 0.0]);
    assert_near(third, absent);
}

#[test]
fn who_brakes_for_nothing_stands_without_cause() {
    let brakes = policies().unwrap().build("constant", &json!({"throttle": -1.0})).unwrap();
    let rules = Arc::new(EnvironmentOptions::training().with_parked(true));
    let drive = |others: Vec<Track>| {
        let ego = car("ego", [0.0, 0.0], 0.0, 8.0);
        let tracks = std::iter::once(ego).chain(others).collect();
        drive_episode(&*brakes, &on_road(tracks), None, &rules, 0).unwrap()
    };
    let (row, alone) = drive(vec![]);
    assert!(row.standing && row.speed < 3.0, "{row:?}");
    let stops_at = alone.motions.last().unwrap().position[0];
    // Gaps from bumper to bumper.
    for (gap, stands_without_cause) in [(14.0, false), (16.0, true)] {
        let ahead = car("ahead", [stops_at + 4.5 + gap, 0.0], 0.0, 0.0);
        assert_eq!(drive(vec![ahead]).0.standing, stands_without_cause, "{gap} m");
    }
    let beside = car("beside", [stops_at + 10.0, 5.0], 0.0, 0.0);
    assert!(drive(vec![beside]).0.standing);
    let goes = policies().unwrap().build_default("idm").unwrap();
    let ego = car("ego", [0.0, 0.0], 0.0, 8.0);
    assert!(!drive_episode(&*goes, &on_road(vec![ego]), None, &rules, 0).unwrap().0.standing);
}

#[test]
fn a_policy_of_a_file_keeps_the_share_of_its_training() {
    let shape = Shape { inputs: LENGTH, hidden: [8, 8], outputs: 2 };
    let actor = Network::random(shape, &mut Rng::new(3, "", "kept"));
    let ppo = PpoOptions { kept: 0.6, ..PpoOptions::default() };
    let options =
        TrainingOptions { algorithm: Algorithm::Ppo, goes_on: true, ppo, ..TrainingOptions::default() };
    let card = PolicyCard::new(options.observation(), json!({}), json!({}), "none".to_owned());
    let card = PolicyCard { kept: options.kept_share(), ..card };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.safetensors");
    write_policy(&path, &actor, &card).unwrap();
    let (read, read_card) = read_policy(&path).unwrap();
    let rules = Arc::new(options.rules());
    let scene = on_road(vec![car("ego", [0.0, 0.0], 0.0, 8.0)]);
    let drive = |policy: ActorPolicy| drive_episode(&policy, &scene, None, &rules, 0).unwrap().1.motions;
    let trained = drive(options.policy(actor.clone()));
    assert!(trained == drive(read_card.policy(read)));
    assert!(trained != drive(ActorPolicy::new(actor.clone()).observing(CONTINUED)));
    write_policy(&path, &actor, &PolicyCard { kept: 1.0, ..card }).unwrap();
    assert!(read_policy(&path).unwrap_err().to_string().contains("keep a share of 1 of the last one"));
}

#[test]
fn the_shipped_driver_is_one_of_the_recipe() {
    let (_, card) = parse_policy(&sage_weights::PPO).unwrap();
    assert_eq!(card.training["algorithm"], "PPO");
    assert_eq!((card.observes(), card.kept), (CONTINUED, 0.6));
    assert_eq!(card.license, "MIT OR Apache-2.0");
}
