//! Policies in scenes with known answers, and the at-fault rule.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::{f64::consts::FRAC_PI_2, sync::Arc};

use hand_made::{car, prepared, road, scene};
use insta::assert_snapshot;
use sage_core::scene::{Map, Track, TrackKind};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    drive::{Drive, Simulation, drive},
    fault::{FaultClass, classify},
    policy::{EgoPolicy, Knowledge, Start, policies},
    vehicle::Vehicle,
};
use serde_json::json;

fn policy(name: &str) -> Box<dyn EgoPolicy> {
    policies().unwrap().build_default(name).unwrap()
}

fn driven(scene: &Arc<SimScene>, policy: &dyn EgoPolicy) -> Drive {
    let mut simulation = Simulation::new(scene, &Arc::default(), None, policy, 0).unwrap();
    drive(&mut simulation).unwrap()
}

fn on_road(tracks: Vec<Track>) -> Arc<SimScene> {
    prepared(scene(road(), tracks))
}

const REACTING: [&str; 4] = ["idm", "expert", "expert-release", "idm-release"];

#[test]
fn every_policy_drives_every_kind_of_scene() {
    for kind in Kind::ALL {
        let scene = prepared(generate(kind, 2, 0).unwrap());
        for entry in
            policies().unwrap().entries().iter().filter(|entry| !["path", "process"].contains(&entry.name))
        {
            let drive = driven(&scene, policy(entry.name).as_ref());
            assert_eq!(drive.motions.len(), 91, "{} in {kind:?}", entry.name);
            assert!(drive.motions.iter().all(|motion| motion.is_finite()));
        }
    }
}

#[test]
fn drivers_stop_behind_a_standing_car() {
    let scene = on_road(vec![car("ego", [0.0, 0.0], 0.0, 8.0), car("wall", [60.0, 0.0], 0.0, 0.0)]);
    assert_eq!(driven(&scene, policy("constant-speed").as_ref()).contacts.len(), 1);
    for name in REACTING {
        let drive = driven(&scene, policy(name).as_ref());
        assert_eq!(drive.contacts.len(), 0, "{name}");
        assert!(drive.progress > 20.0, "{name} stops at {} m", drive.progress);
    }
}

#[test]
fn drivers_follow_a_slower_car_without_contact() {
    // The route is the ego's log, which passes through the slower car.
    let scene = on_road(vec![car("ego", [0.0, 0.0], 0.0, 12.0), car("slow", [30.0, 0.0], 0.0, 6.0)]);
    for name in ["idm", "expert", "expert-release"] {
        let drive = driven(&scene, policy(name).as_ref());
        assert_eq!(drive.contacts.len(), 0, "{name}");
        let end = drive.motions[90];
        assert!((3.0..9.0).contains(&end.speed()), "{name} ends at {} m/s", end.speed());
    }
}

#[test]
fn the_expert_brakes_for_a_crossing_car_and_idm_does_not_see_it() {
    // At 12 m/s the ego is at x = 60 after 5 s; the crossing car after 4.5 s, and it is slow.
    let crossing = car("crossing", [60.0, -27.0], FRAC_PI_2, 6.0);
    let scene = on_road(vec![car("ego", [0.0, 0.0], 0.0, 12.0), crossing]);
    let slowest =
        |drive: &Drive| drive.motions.iter().map(|motion| motion.speed()).fold(f64::INFINITY, f64::min);
    let expert = driven(&scene, policy("expert").as_ref());
    assert!(expert.contacts.is_empty() && slowest(&expert) < 8.0, "slowest {}", slowest(&expert));
    let idm = driven(&scene, policy("idm").as_ref());
    assert!(slowest(&idm) > 9.0 || !idm.contacts.is_empty(), "slowest {}", slowest(&idm));
}

#[test]
fn a_standing_ego_faces_along_its_heading() {
    let mut map = Map::default();
    map.points.extend((0..=60).map(|k| [0.0, -100.0 + 5.0 * f64::from(k), 0.0]));
    let (points, kind) = (0..map.points.len(), sage_core::scene::MapKind::LaneSurfaceStreet);
    map.features.push(sage_core::scene::MapFeature {
        id: "north".to_owned(),
        kind,
        points,
        lane: Some(Box::default()),
    });
    let scene = prepared(scene(map, vec![car("ego", [0.0, 0.0], FRAC_PI_2, 0.0)]));
    let still = driven(&scene, policy("constant-speed").as_ref());
    assert!((still.motions[90].heading - FRAC_PI_2).abs() < 1e-9);
    for name in ["idm", "expert"] {
        let end = driven(&scene, policy(name).as_ref()).motions[90];
        assert!(end.position[0].abs() < 0.5 && end.position[1] > 20.0, "{name} ends at {:?}", end.position);
    }
}

#[test]
fn idm_changes_to_a_free_parallel_lane_and_drives_on() {
    let mut map = Map::default();
    for (id, y) in [("right", 0.0), ("left", 3.6)] {
        let start = map.points.len();
        map.points.extend((0..=80).map(|k| [-100.0 + 5.0 * f64::from(k), y, 0.0]));
        let points = start..map.points.len();
        let neighbor = |lane| sage_core::scene::Neighbor { lane, own: [0, 80], other: [0, 80] };
        let neighbors = if id == "right" { [vec![neighbor(1)], vec![]] } else { [vec![], vec![neighbor(0)]] };
        let lane = sage_core::scene::Lane { speed_limit: Some(15.0), neighbors, ..Default::default() };
        let kind = sage_core::scene::MapKind::LaneSurfaceStreet;
        map.features.push(sage_core::scene::MapFeature {
            id: id.to_owned(),
            kind,
            points,
            lane: Some(Box::new(lane)),
        });
    }
    let scene = |tracks| prepared(scene(map.clone(), tracks));
    let slow = || car("slow", [35.0, 0.0], 0.0, 4.0);
    let ego = || car("ego", [0.0, 0.0], 0.0, 12.0);
    let changed = driven(&scene(vec![ego(), slow()]), policy("idm").as_ref());
    assert!(changed.contacts.is_empty());
    assert!(changed.motions.iter().any(|motion| motion.position[1] > 3.0), "it changes lanes");
    // No change without the option, and none into an occupied lane.
    let without = policies().unwrap().build("idm", &json!({"lane_changes": null})).unwrap();
    let stays = driven(&scene(vec![ego(), slow()]), without.as_ref());
    assert!(stays.motions.iter().all(|motion| motion.position[1].abs() < 0.5));
    assert!(changed.progress > stays.progress + 10.0);
    let beside = car("beside", [0.0, 3.6], 0.0, 12.0);
    let occupied = driven(&scene(vec![ego(), slow(), beside]), policy("idm").as_ref());
    assert!(occupied.contacts.is_empty());
    assert!(occupied.motions[..20].iter().all(|motion| motion.position[1].abs() < 0.5));
}

#[test]
fn knowledge_is_declared() {
    let knows = |name: &str| policy(name).knows();
    assert_eq!(knows("expert-release"), Knowledge::Everything);
    assert_eq!(knows("replay"), Knowledge::OwnLog);
    assert_eq!(knows("expert"), Knowledge::None);
    // The expert without knowledge drives the same whatever the log says of the future.
    let mut liar = car("other", [30.0, 0.0], 0.0, 2.0);
    let honest = on_road(vec![car("ego", [0.0, 0.0], 0.0, 12.0), liar.clone()]);
    for frame in 21..91 {
        liar.position[frame] = [500.0, 0.0, 0.75];
        liar.heading[frame] = 1.5;
    }
    let lying = on_road(vec![car("ego", [0.0, 0.0], 0.0, 12.0), liar]);
    let until_20 =
        |scene: &Arc<SimScene>, name: &str| driven(scene, policy(name).as_ref()).motions[..=20].to_vec();
    for name in ["idm", "idm-release", "expert"] {
        assert_eq!(until_20(&honest, name), until_20(&lying, name), "{name}");
    }
    assert_ne!(until_20(&honest, "expert-release"), until_20(&lying, "expert-release"));
}

#[test]
fn a_path_is_driven_pose_by_pose_and_bad_files_are_named() {
    let scene = on_road(vec![car("ego", [0.0, 0.0], 0.0, 10.0)]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("drive.json");
    let build = |text: &str| {
        std::fs::write(&file, text).unwrap();
        policies().unwrap().build("path", &json!({ "file": &file }))
    };
    let poses: Vec<[f64; 3]> = (0..91).map(|k| [0.5 * f64::from(k), 0.01 * f64::from(k), 0.02]).collect();
    for text in [json!(poses).to_string(), json!({ "hand-made": poses }).to_string()] {
        let drive = driven(&scene, build(&text).unwrap().as_ref());
        for (motion, pose) in drive.motions.iter().zip(&poses).skip(1) {
            assert_eq!([motion.position[0], motion.position[1], motion.heading], *pose);
        }
        let recorded = drive.scene_as_driven(&scene);
        assert_eq!(recorded.ego().point(50), [25.0, 0.5]);
        assert_eq!(recorded.ego().size[50], scene.log().size[10]);
    }
    let error = build("[[1, 2]]").err().unwrap().to_string();
    assert_snapshot!(error.replace(&folder.path().display().to_string(), "[folder]"), @"options of policy `path`: `[folder]/drive.json`: expected a JSON list of [x, y, heading], or an object with such a list for each scene id: invalid length 2, expected an array of length 3 at line 1 column 7");
    let mut far = poses.clone();
    far[40] = [1e300, 0.0, 0.0];
    let mut jumping = poses.clone();
    jumping[40] = [500.0, 0.0, 0.0];
    let [far, jumping] = [far, jumping].map(|poses| build(&json!(poses).to_string()).unwrap());
    let short = build("[[1, 2, 3]]").unwrap();
    let start = |policy: &dyn EgoPolicy| {
        let start = Start::new(&scene, 0, Knowledge::None, 0);
        let error = policy.start(&start).err().unwrap().to_string();
        error.replace(&folder.path().display().to_string(), "[folder]")
    };
    assert_snapshot!(start(far.as_ref()), @"scene `hand-made`: row 40 of the drive in `[folder]/drive.json` is [1e300, 0.0, 0.0]; expected numbers within ±1e8");
    assert_snapshot!(start(jumping.as_ref()), @"scene `hand-made`: row 40 of the drive in `[folder]/drive.json` is 481 m from the position before; expected at most 100 m a frame");
    assert_snapshot!(start(short.as_ref()), @"scene `hand-made`: the drive in `[folder]/drive.json` has 1 poses; expected 91, one a frame");
    let other = build(r#"{"another": []}"#).unwrap();
    assert_snapshot!(start(other.as_ref()), @"scene `hand-made`: `[folder]/drive.json` has no drive of this scene");
}

#[test]
fn options_out_of_range_are_refused() {
    let registry = policies().unwrap();
    let wrong = [
        ("idm", json!({"limits": [1.0, 2.0]})),
        ("idm", json!({"model": {"standing_gap": 0.0}})),
        ("idm", json!({"sped": 1})),
        ("idm", json!({"lane_changes": {"politeness": -1.0}})),
        ("expert", json!({"brakes": []})),
        ("constant", json!({"steer": 2.0})),
    ];
    let said = wrong.map(|(name, options)| {
        let error = registry.build(name, &options).err().unwrap();
        format!("{name}{options} -> {error}")
    });
    assert_snapshot!(said.join("\n"), @r#"
    idm{"limits":[1.0,2.0]} -> options of policy `idm`: `limits` is [1, 2]; expected a number below 0 and one above
    idm{"model":{"standing_gap":0.0}} -> options of policy `idm`: `model.standing_gap` is 0; expected a number above 0
    idm{"sped":1} -> options of policy `idm`: unknown field `sped`, expected one of `model`, `speed_limits`, `curves`, `limits`, `lane_changes`, `red_lights`, `people`
    idm{"lane_changes":{"politeness":-1.0}} -> options of policy `idm`: `lane_changes.politeness` is -1; expected a number, at least 0
    expert{"brakes":[]} -> options of policy `expert`: `brakes` is []; expected numbers below 0, at least one
    constant{"steer":2.0} -> options of policy `constant`: `steer` is 2; expected a number from -1 to 1
    "#);
}

/// Class of the first contact of a replayed ego with another car.
fn class(ego: Track, other: Track) -> FaultClass {
    let scene = on_road(vec![ego, other]);
    let drive = driven(&scene, policy("replay").as_ref());
    classify(&drive.contacts[0], &Vehicle::default(), scene.index())
}

#[test]
fn faults_follow_nuplans_table() {
    let ego = || car("ego", [0.0, 0.0], 0.0, 10.0);
    let standing = || car("ego", [30.0, 0.0], 0.0, 0.0);
    // The ego runs into a moving and a standing car ahead.
    assert_eq!(class(ego(), car("slow", [20.0, 0.0], 0.0, 4.0)), FaultClass::ActiveFront);
    assert_eq!(class(ego(), car("parked", [20.0, 0.0], 0.0, 0.0)), FaultClass::StoppedTrack);
    // Rear-ended while moving, and hit at a standstill.
    assert_eq!(class(ego(), car("fast", [-20.0, 0.0], 0.0, 16.0)), FaultClass::ActiveRear);
    assert_eq!(class(standing(), car("fast", [0.0, 0.0], 0.0, 10.0)), FaultClass::StoppedEgo);
    // Head-on in the ego's lane; crossing, the ego's front into its side.
    assert_eq!(
        class(ego(), car("oncoming", [60.0, 0.0], std::f64::consts::PI, 10.0)),
        FaultClass::ActiveFront
    );
    assert_eq!(class(ego(), car("crossing", [34.0, -29.0], FRAC_PI_2, 10.0)), FaultClass::ActiveFront);
    // Drifting into the side of an ego that keeps its lane, and of one that is off its lane.
    let drifting = |y: f64| {
        let mut other = car("drifting", [-2.0, y + 4.0], 0.0, 10.0);
        other.position.iter_mut().enumerate().for_each(|(frame, p)| p[1] -= 0.05 * frame as f64);
        other
    };
    assert_eq!(class(ego(), drifting(0.0)), FaultClass::LateralInLane);
    assert_eq!(class(car("ego", [0.0, 1.2], 0.0, 10.0), drifting(1.2)), FaultClass::LateralOffLane);
    // A cone is an object, whatever its speed.
    let mut cone = car("cone", [20.0, 0.0], 0.0, 1.0);
    cone.kind = TrackKind::Other("TRAFFIC_CONE".to_owned());
    assert_eq!(class(ego(), cone), FaultClass::StoppedTrack);
    assert_eq!(FaultClass::ActiveFront.is_at_fault(), Some(true));
    assert_eq!((FaultClass::LateralInLane.rule(), FaultClass::LateralInLane.is_at_fault()), (5, Some(false)));
}
