//! Laws of reference drivers.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::sync::Arc;

use sage_core::{
    geometry::{Point, distance},
    motion::{HORIZON, NOW, Pose, Trajectory},
    scene::SceneIndex,
};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    Error, SimScene,
    attack_test::AttackTest,
    fault::{FaultClass, FaultRule},
    policy::{Driver, EgoPolicy, Start, View, policies},
    reference::Reference,
    search::passing::{Asked, TestDrive},
    vehicle::Motion,
    world::Control,
};
use serde_json::json;

fn policy(name: &str, options: serde_json::Value) -> Box<dyn EgoPolicy> {
    policies().unwrap().build(name, &options).unwrap()
}

fn named(name: &str) -> Reference {
    Reference { name: name.to_owned(), policy: policy(name, json!({})) }
}

/// Scenes, each with plans straight to where the recorded ego is after some steps.
fn scenes() -> Vec<(Arc<SimScene>, Vec<Trajectory>)> {
    let kinds = [Kind::FourWay, Kind::Merge, Kind::Straight, Kind::Curve];
    let scene = |(seed, kind): (u64, Kind)| {
        let scene = generate(kind, seed, 0)?;
        let index = SceneIndex::new(scene.map.clone());
        let simulated = SimScene::new(Arc::new(scene), index).unwrap();
        let [x, y] = simulated.scene().adversary().unwrap().point(NOW);
        let plan = |meets: usize| {
            let [to_x, to_y] = simulated.scene().ego().point(NOW + meets);
            let at = |step: usize| {
                let share = step as f64 / meets as f64;
                [x + share * (to_x - x), y + share * (to_y - y)]
            };
            Trajectory::new("straight", (1..=HORIZON).map(at).collect()).unwrap()
        };
        let plans = [15, 25, 35, 50].map(plan).to_vec();
        Some((simulated, plans))
    };
    (0..12).zip(kinds.into_iter().cycle()).filter_map(scene).collect()
}

#[test]
fn a_reference_drives_as_the_policy_that_takes_over() {
    let tested = policy("idm", json!({}));
    let (mut prevented, mut not) = (0, 0);
    for (scene, plans) in scenes() {
        for name in ["r157", "pdm", "expert", "idm"] {
            let references = [named(name)];
            let test = AttackTest::new(&*tested, &scene, 3).unwrap().with_references(&references);
            let watching = test.watching().unwrap();
            let takeover = policy("takeover", json!({"first": {"name": "idm"}, "then": {"name": name}}));
            let other = AttackTest::new(&*takeover, &scene, 3).unwrap();
            for plan in &plans {
                let prevention = watching.prevention(plan).unwrap();
                let outcome = other.attack(plan, true).unwrap();
                let driven = &outcome.episode.drive.motions[NOW..];
                let shared = driven.len().min(prevention.motions.len());
                assert_eq!(driven[..shared], prevention.motions[..shared], "{name}: the same bits");
                let adversary = scene.scene().adversary_index().unwrap();
                let contacts = &outcome.episode.contacts;
                let fails = |contact: &sage_sim::episode::EpisodeContact| {
                    contact.contact.other.track == adversary || contact.class.is_at_fault() == Some(true)
                };
                let is_whole = prevention.motions.len() == scene.scene().frames.min(91) - NOW;
                if prevention.by() == Some(name) {
                    assert!(!contacts.iter().any(fails) && is_whole);
                    prevented += 1;
                } else {
                    not += 1;
                    // What it fails at is seen in the episode, unless that ended with a contact that is not its fault.
                    let is_off = outcome.episode.drive.off_road.step().is_some();
                    assert!(is_off || !contacts.is_empty(), "{name}");
                }
            }
        }
    }
    assert!(prevented > 20 && not > 20, "{prevented} prevented, {not} not");
}

#[test]
fn references_are_asked_in_their_order_up_to_the_first_that_prevents() {
    let tested = policy("constant", json!({"throttle": 1.0}));
    // One that stands cannot be at fault with anybody who moves; one that accelerates can.
    let stands =
        || Reference { name: "stands".to_owned(), policy: policy("constant", json!({"throttle": -1.0})) };
    let again =
        || Reference { name: "again".to_owned(), policy: policy("constant", json!({"throttle": 1.0})) };
    let orders = [vec![stands(), again()], vec![again(), stands()], vec![again()], vec![]];
    let mut asked = [0; 4];
    for (scene, plans) in scenes() {
        for (k, references) in orders.iter().enumerate() {
            let test = AttackTest::new(&*tested, &scene, 0).unwrap().with_references(references);
            let watching = test.watching().unwrap();
            for plan in &plans {
                let answers = watching.prevention(plan).unwrap().answers;
                let until = answers.iter().position(|answer| answer.prevents == Some(true));
                let expected = until.map_or(references.len(), |first| first + 1);
                assert_eq!(answers.len(), expected, "{answers:?}");
                let names = references.iter().map(|reference| &reference.name);
                assert!(answers.iter().map(|answer| &answer.reference).eq(names.take(expected)));
                asked[k] += answers.len();
            }
        }
    }
    assert!(asked[0] > asked[2] && asked[3] == 0, "{asked:?}");
}

#[test]
fn a_takeover_of_itself_is_no_other_driver() {
    for (scene, plans) in scenes().into_iter().take(4) {
        let own = policy("pdm", json!({}));
        let twice = policy("takeover", json!({"first": {"name": "pdm"}, "then": {"name": "pdm"}}));
        let [own, twice] = [&own, &twice].map(|policy| AttackTest::new(&**policy, &scene, 1).unwrap());
        for plan in &plans {
            let [own, twice] = [&own, &twice].map(|test| test.attack(plan, true).unwrap().episode);
            assert_eq!(own, twice);
        }
    }
    let error = |options| policies().unwrap().build("takeover", &options).err().unwrap().to_string();
    assert!(error(json!({"first": {"name": "takeover"}})).contains("expected another policy"));
    assert!(error(json!({"then": {"name": "nobody"}})).contains("nobody"));
}

#[test]
fn the_careful_rule_excuses_an_ego_that_has_braked_in_its_lane_and_no_other() {
    let tested = policy("idm", json!({}));
    let (mut excused, mut same) = (0, 0);
    for (scene, plans) in scenes() {
        let test = |rule| AttackTest::new(&*tested, &scene, 2).unwrap().with_fault(rule);
        let [plain, careful] = [FaultRule::Nuplan, FaultRule::Careful].map(test);
        for plan in &plans {
            let [plain, careful] = [&plain, &careful].map(|test| test.attack(plan, true).unwrap().episode);
            assert_eq!(plain.drive, careful.drive);
            for (plain, careful) in plain.contacts.iter().zip(&careful.contacts) {
                if plain.class == careful.class {
                    same += 1;
                    continue;
                }
                excused += 1;
                assert_eq!((plain.class.is_at_fault(), careful.class), (Some(true), FaultClass::SlowedEgo));
                let contact = &careful.contact;
                assert!(contact.car.speed() < 3.0 && contact.other.speed() >= contact.car.speed() + 2.0);
            }
        }
    }
    assert!(same > 10, "{same} contacts keep their class, {excused} are excused");
}

/// A driver that goes along given motions, one for each frame.
#[derive(Clone)]
struct Along {
    motions: Arc<Vec<Motion>>,
    frame: usize,
}

impl EgoPolicy for Along {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}

impl Driver for Along {
    fn control(&mut self, _: &View) -> Result<Control, Error> {
        self.frame += 1;
        let Motion { position, heading, velocity, .. } = self.motions[self.frame.min(self.motions.len() - 1)];
        Ok(Control::Pose { pose: Pose { position, heading }, velocity: Some(velocity) })
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}

#[test]
fn a_driver_at_thirty_percent_of_the_speed_of_the_reference_passes_no_test_that_asks_for_progress() {
    let tested = policy("idm", json!({}));
    let references = ["r157", "pdm", "expert"].map(named);
    let mut asked = 0;
    for (scene, plans) in scenes() {
        let test = AttackTest::new(&*tested, &scene, 3).unwrap().with_references(&references);
        let watching = test.watching().unwrap();
        for plan in &plans {
            let prevention = watching.prevention(plan).unwrap();
            if prevention.by().is_none() {
                continue;
            }
            // Along the way of the reference, at each frame 0.3 times as far.
            let points: Vec<Point> = prevention.motions.iter().map(|motion| motion.position).collect();
            let mut along = vec![0.0];
            for pair in points.windows(2) {
                along.push(along[along.len() - 1] + distance(pair[0], pair[1]));
            }
            let slowed = |step: usize| {
                let wanted = 0.3 * along[step];
                let k = along.iter().rposition(|a| *a <= wanted).unwrap().min(points.len() - 2);
                let share = (wanted - along[k]) / (along[k + 1] - along[k]).max(1e-9);
                let at = prevention.motions[k];
                let position =
                    [0, 1].map(|axis| points[k][axis] + share * (points[k + 1][axis] - points[k][axis]));
                Motion { position, velocity: prevention.motions[step].velocity.map(|v| 0.3 * v), ..at }
            };
            let before = test.unattacked().motions[..=NOW].iter().copied();
            let motions = before.chain((1..prevention.motions.len()).map(slowed)).collect();
            let slow = Along { motions: Arc::new(motions), frame: 0 };
            let slow_test = AttackTest::new(&slow, &scene, 3).unwrap();
            let drive = TestDrive::new(&slow_test, &watching, plan).unwrap().0;
            if drive.progress.is_asked() {
                asked += 1;
                assert!(drive.shortfall(Asked::default()).is_some(), "{drive:?}");
            }
        }
    }
    assert!(asked > 10, "{asked} tests ask for progress");
}

#[test]
fn a_driver_that_brakes_before_now_passes_no_test_in_which_the_recording_drives_on() {
    let tested = policy("constant", json!({"throttle": -1.0}));
    let references = ["r157", "idm", "pdm", "expert"].map(named);
    let mut asked = 0;
    for (scene, plans) in scenes() {
        let ego = scene.scene().ego();
        let test = AttackTest::new(&*tested, &scene, 3).unwrap().with_references(&references);
        let watching = test.watching().unwrap();
        for plan in &plans {
            let drive = TestDrive::new(&test, &watching, plan).unwrap().0;
            let steps = drive.contact.as_ref().map_or(HORIZON, |met| met.step as usize);
            if distance(ego.point(NOW), ego.point(NOW + steps)) > 10.0 && drive.progress.made < 2.0 {
                asked += 1;
                assert!(drive.shortfall(Asked::default()).is_some(), "{drive:?}");
            }
        }
    }
    assert!(asked > 5, "{asked} drives");
}
