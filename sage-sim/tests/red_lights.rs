//! Red lights: which drivers stop at them, where, and who runs over red.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test; tests say what they leave out.

mod hand_made;
mod reference;

use std::{env, f64::consts::FRAC_PI_2, path::PathBuf, sync::Arc};

use hand_made::{FRAMES, car, prepared, road, scene};
use sage_core::{
    scene::{Lane, LightState, Map, MapFeature, MapKind, SceneIndex, Track, TrafficLight},
    statistics,
};
use sage_data::Recording;
use sage_sim::{
    SimScene,
    drive::{Drive, Simulation, drive},
    policy::{EgoPolicy, policies},
    red_lights::over_red,
};
use serde_json::{Value, json};

/// Half the length of the hand-made cars, metres.
const HALF: f64 = 2.25;
/// The policies with the option.
const STOPPING: [&str; 3] = ["idm", "pdm", "expert"];

fn policy(name: &str, options: &Value) -> Box<dyn EgoPolicy> {
    policies().unwrap().build(name, options).unwrap()
}

fn driven_by(scene: &Arc<SimScene>, policy: &dyn EgoPolicy) -> Drive {
    drive(&mut Simulation::new(scene, &Arc::default(), None, policy, 0).unwrap()).unwrap()
}

fn driven(scene: &Arc<SimScene>, name: &str) -> Drive {
    driven_by(scene, policy(name, &json!({})).as_ref())
}

/// A light of a lane, with its state at each frame.
fn light(lane: &str, stop: Option<[f64; 2]>, state: impl Fn(usize) -> LightState) -> TrafficLight {
    let stop_point = stop.map(|[x, y]| [x, y, 0.0]);
    TrafficLight { lane: lane.to_owned(), stop_point, states: (0..FRAMES).map(state).collect() }
}

fn lit(map: Map, ego: Track, lights: Vec<TrafficLight>) -> Arc<SimScene> {
    let mut scene = scene(map, vec![ego]);
    scene.lights = lights;
    prepared(scene)
}

/// A straight road with a light; the ego starts at x = 0.
fn straight(speed: f64, stop: f64, state: impl Fn(usize) -> LightState) -> Arc<SimScene> {
    lit(road(), car("ego", [0.0, 0.0], 0.0, speed), vec![light("lane", Some([stop, 0.0]), state)])
}

fn red(_: usize) -> LightState {
    LightState::Stop
}

/// Position of the front bumper along x at the end.
fn front(drive: &Drive) -> f64 {
    drive.motions[90].position[0] + HALF
}

/// Whether the car stands before the stop point, or creeps towards it. `expert` does not start towards an obstacle that it would reach within
/// four seconds, so it may stand far before it.
fn stands_before(drive: &Drive, stop: f64) -> bool {
    drive.motions[90].speed() < 0.5 && front(drive) <= stop && front(drive) > stop - 26.0
}

#[test]
fn drivers_stop_before_the_stop_point() {
    for name in STOPPING {
        for (speed, stop) in [(3.0, 15.0), (5.0, 20.0), (8.0, 25.0), (10.0, 30.0), (10.0, 50.0), (13.0, 50.0)]
        {
            let scene = straight(speed, stop, red);
            let drive = driven(&scene, name);
            assert!(
                stands_before(&drive, stop),
                "{name} at {speed} m/s: front at {} of {stop}",
                front(&drive)
            );
            assert_eq!(over_red(&scene, &drive.motions), Some(vec![]), "{name}");
        }
    }
    // From 10 m/s, 50 m ahead: the gap is the model's standing gap; `expert` stops as late as it can.
    for (name, range) in [("idm", 1.9..2.1), ("pdm", 0.7..1.3), ("expert", 0.0..1.0)] {
        let gap = 50.0 - front(&driven(&straight(10.0, 50.0, red), name));
        assert!(range.contains(&gap), "{name} stands {gap} m before the stop point");
    }
}

#[test]
fn a_car_at_rest_before_a_red_light_stays_behind_it() {
    for name in STOPPING {
        for gap in [0.3, 1.0, 3.0] {
            let scene = straight(0.0, HALF + gap, red);
            let drive = driven(&scene, name);
            assert!(stands_before(&drive, HALF + gap), "{name}, {gap} m: front at {}", front(&drive));
        }
    }
}

#[test]
fn no_light_but_red_changes_a_drive() {
    let without = lit(road(), car("ego", [0.0, 0.0], 0.0, 10.0), vec![]);
    let states = [LightState::Unknown, LightState::Caution, LightState::Go, LightState::FlashingStop];
    for name in STOPPING {
        let free = driven(&without, name);
        assert!(free.progress > 60.0);
        for state in states {
            let scene = straight(10.0, 40.0, |_| state);
            assert_eq!(driven(&scene, name).motions, free.motions, "{name}, {state:?}");
            assert_eq!(over_red(&scene, &free.motions), Some(vec![]));
        }
    }
    assert_eq!(over_red(&without, &driven(&without, "idm").motions), None);
}

#[test]
fn with_the_option_off_and_in_other_policies_that_do_not_see_them_lights_change_nothing() {
    let scenes = [straight(10.0, 40.0, red), lit(road(), car("ego", [0.0, 0.0], 0.0, 10.0), vec![])];
    let off = json!({"red_lights": false});
    let mut drivers: Vec<(&str, Value)> = STOPPING.iter().map(|name| (*name, off.clone())).collect();
    drivers.push(("r157", json!({"following": {"lane_changes": null, "speed_limits": false}})));
    let registry = policies().unwrap();
    let others = registry.entries().iter().map(|entry| entry.name);
    drivers.extend(
        others
            .filter(|name| !STOPPING.contains(name) && !["path", "process", "ppo", "takeover"].contains(name))
            .map(|name| (name, json!({}))),
    );
    assert!(drivers.len() > 10);
    for (name, options) in drivers {
        let policy = policy(name, &options);
        let [with, without] = [0, 1].map(|k| driven_by(&scenes[k], policy.as_ref()));
        assert_eq!(with.motions, without.motions, "{name}");
    }
    let careful = policy("r157", &json!({"following": {"lane_changes": null, "red_lights": true}}));
    assert!(stands_before(&driven_by(&scenes[0], careful.as_ref()), 40.0));
}

#[test]
fn the_defaults_say_who_stops() {
    for entry in policies().unwrap().entries() {
        let stops = entry.defaults.get("red_lights").is_some_and(|on| on == true);
        assert_eq!(stops, STOPPING.contains(&entry.name), "{}", entry.name);
    }
}

#[test]
fn a_light_that_turns_green_lets_the_car_go() {
    for name in STOPPING {
        let scene = straight(10.0, 40.0, |frame| if frame < 50 { LightState::Stop } else { LightState::Go });
        let drive = driven(&scene, name);
        assert!(drive.motions[..=50].iter().all(|motion| motion.position[0] + HALF <= 40.0), "{name}");
        assert!(front(&drive) > 42.0, "{name}: front at {}", front(&drive));
        assert_eq!(over_red(&scene, &drive.motions), Some(vec![]));
    }
}

#[test]
fn a_light_that_turns_red_stops_those_that_can_stop() {
    // The car needs 10²/6 = 17 m at 3 m/s². With 28 m left it stops, with 8 m left it drives on, and does not brake.
    for name in ["idm", "pdm"] {
        let turns = |stop: f64| {
            straight(10.0, stop, |frame| if frame < 10 { LightState::Caution } else { LightState::Stop })
        };
        assert!(stands_before(&driven(&turns(42.0), name), 42.0), "{name}");
        let late = turns(21.0);
        let drive = driven(&late, name);
        assert!(drive.motions.iter().all(|motion| motion.speed() > 9.0), "{name}");
        assert_eq!(over_red(&late, &drive.motions).map(|steps| steps.len()), Some(1), "{name}");
    }
    // `expert` brakes by up to 8 m/s²: 15²/16 = 14 m from the speed limit. It stops with 17 m left, and not with 12 m.
    let turns = |stop: f64| {
        straight(15.0, stop, |frame| if frame < 10 { LightState::Caution } else { LightState::Stop })
    };
    assert!(stands_before(&driven(&turns(34.25), "expert"), 34.25));
    assert!(front(&driven(&turns(29.25), "expert")) > 60.0);
}

#[test]
fn a_car_past_the_stop_point_drives_on_and_is_not_counted() {
    for name in STOPPING {
        let behind = straight(8.0, 1.0, red);
        let free = driven(&lit(road(), car("ego", [0.0, 0.0], 0.0, 8.0), vec![]), name);
        assert_eq!(driven(&behind, name).motions, free.motions, "{name}");
        assert_eq!(over_red(&behind, &free.motions), None);
        // Red begins at frame 40, when the car is past 20 m.
        let later = straight(8.0, 20.0, |frame| if frame < 40 { LightState::Go } else { LightState::Stop });
        assert_eq!(driven(&later, name).motions, free.motions, "{name}");
        assert_eq!(over_red(&later, &free.motions), Some(vec![]));
    }
}

#[test]
fn runs_over_red_are_counted_at_the_step_of_the_front_bumper() {
    // At 10 m/s the front is at 2.25 + n after n steps, so it crosses 40 in step 38.
    let scene = straight(10.0, 40.0, red);
    let drive = driven(&scene, "replay");
    assert_eq!(over_red(&scene, &drive.motions), Some(vec![38]));
    // The state of the frame before counts: the driver saw that.
    for (last, expected) in [(37, vec![38]), (36, vec![])] {
        let scene =
            straight(10.0, 40.0, |frame| if frame <= last { LightState::Stop } else { LightState::Go });
        assert_eq!(over_red(&scene, &drive.motions), Some(expected), "red up to {last}");
    }
    // Up to 0.5 m/s it creeps.
    for (speed, count) in [(0.45, 0), (0.6, 1)] {
        let scene = straight(speed, HALF + 1.0, red);
        let found = over_red(&scene, &driven(&scene, "replay").motions).unwrap();
        assert_eq!(found.len(), count, "{speed} m/s");
    }
    // A drive that ends before does not reach it.
    assert_eq!(over_red(&scene, &drive.motions[..30]), Some(vec![]));
}

/// A lane through points, as a feature of the map.
fn lane(map: &mut Map, id: &str, points: &[[f64; 2]], exits: Vec<usize>) {
    let start = map.points.len();
    map.points.extend(points.iter().map(|[x, y]| [*x, *y, 0.0]));
    let lane = Lane { speed_limit: Some(12.0), exits, ..Lane::default() };
    let (points, kind) = (start..map.points.len(), MapKind::LaneSurfaceStreet);
    map.features.push(MapFeature { id: id.to_owned(), kind, points, lane: Some(Box::new(lane)) });
}

/// A quarter of a circle from (30, 0), heading east, to the left (1) or to the right (−1).
fn turn(radius: f64, side: f64) -> Vec<[f64; 2]> {
    let at = |k: i32| {
        let angle = f64::from(k) / 20.0 * FRAC_PI_2;
        [30.0 + radius * angle.sin(), side * radius * (1.0 - angle.cos())]
    };
    (0..=20).map(at).collect()
}

fn line([ax, ay]: [f64; 2], [bx, by]: [f64; 2]) -> Vec<[f64; 2]> {
    (0..=40).map(|k| f64::from(k) / 40.0).map(|s| [ax + s * (bx - ax), ay + s * (by - ay)]).collect()
}

/// A junction: the lane `in` ends at (30, 0), where `straight`, `left` and `right` begin.
fn junction() -> Map {
    let mut map = Map::default();
    lane(&mut map, "in", &line([-60.0, 0.0], [30.0, 0.0]), vec![1, 2, 3]);
    lane(&mut map, "straight", &line([30.0, 0.0], [60.0, 0.0]), vec![4]);
    lane(&mut map, "left", &turn(14.0, 1.0), vec![5]);
    lane(&mut map, "right", &turn(9.0, -1.0), vec![6]);
    lane(&mut map, "east", &line([60.0, 0.0], [200.0, 0.0]), vec![]);
    lane(&mut map, "north", &line([44.0, 14.0], [44.0, 120.0]), vec![]);
    lane(&mut map, "south", &line([39.0, -9.0], [39.0, -120.0]), vec![]);
    map
}

/// The ego at 6 m/s through lanes of the junction.
fn through(lanes: &[&str]) -> Track {
    let map = junction();
    let of = |id: &&str| map.features.iter().find(|feature| feature.id == **id).unwrap();
    let points: Vec<[f64; 2]> =
        lanes.iter().flat_map(|id| map.points_of(of(id)).iter().map(|p| [p[0], p[1]])).collect();
    let mut track = car("ego", [0.0, 0.0], 0.0, 6.0);
    for frame in 0..FRAMES {
        let mut left = 60.0 + 0.6 * frame as f64;
        for pair in points.windows(2) {
            let d = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
            let length = d[0].hypot(d[1]);
            if left <= length {
                let share = left / length.max(1e-9);
                track.position[frame] = [pair[0][0] + share * d[0], pair[0][1] + share * d[1], 0.75];
                track.heading[frame] = d[1].atan2(d[0]);
                track.velocity[frame] = [6.0 * d[0] / length, 6.0 * d[1] / length];
                break;
            }
            left -= length;
        }
    }
    track
}

#[test]
fn of_the_lanes_at_one_stop_point_that_of_the_route_counts() {
    let ways: [(&str, &[&str]); 3] = [
        ("straight", &["in", "straight", "east"]),
        ("left", &["in", "left", "north"]),
        ("right", &["in", "right", "south"]),
    ];
    for (own, lanes) in ways {
        for (shown, _) in ways {
            let state = |id: &str| if id == shown { LightState::Stop } else { LightState::Go };
            let lights = ways.iter().map(|(id, _)| light(id, Some([30.0, 0.0]), |_| state(id))).collect();
            let scene = lit(junction(), through(lanes), lights);
            assert_eq!(scene.lights().stops().len(), 1, "{own}");
            for name in STOPPING {
                let drive = driven(&scene, name);
                let is_behind = front(&drive) <= 30.0 && drive.motions[90].speed() < 0.5;
                let end = drive.motions[90];
                assert_eq!(is_behind, own == shown, "{name} goes {own}, {shown} is red: {end:?}");
            }
            let logged = over_red(&scene, &driven(&scene, "replay").motions).unwrap();
            assert_eq!(logged.len(), usize::from(own == shown));
        }
    }
}

#[test]
fn without_a_stop_point_the_start_of_the_lane_counts() {
    let scene = lit(junction(), through(&["in", "straight", "east"]), vec![light("straight", None, red)]);
    assert!((scene.lights().stops()[0].along - 30.0).abs() < 0.1, "{:?}", scene.lights());
    for name in STOPPING {
        assert!(front(&driven(&scene, name)) <= 30.0, "{name}");
    }
    // The ego is already in the lane that the light controls.
    let inside = lit(road(), car("ego", [0.0, 0.0], 0.0, 8.0), vec![light("lane", None, red)]);
    assert_eq!(over_red(&inside, &driven(&inside, "idm").motions), None);
}

#[test]
fn lights_of_other_lanes_are_not_on_the_route() {
    let mut map = road();
    lane(&mut map, "beside", &line([-100.0, 3.5], [300.0, 3.5]), vec![]);
    lane(&mut map, "oncoming", &line([300.0, 0.5], [-100.0, 0.5]), vec![]);
    lane(&mut map, "across", &line([40.0, -60.0], [40.0, 60.0]), vec![]);
    lane(&mut map, "bikes", &line([-100.0, 0.2], [300.0, 0.2]), vec![]);
    map.features.last_mut().unwrap().kind = MapKind::LaneBike;
    for (id, y) in [("beside", 3.5), ("oncoming", 0.5), ("across", 0.0), ("bikes", 0.2), ("nowhere", 0.0)] {
        let lights = vec![light(id, Some([40.0, y]), red)];
        let scene = lit(map.clone(), car("ego", [0.0, 0.0], 0.0, 8.0), lights);
        assert_eq!(scene.lights().stops(), [], "{id}");
        assert_eq!(over_red(&scene, &driven(&scene, "replay").motions), None, "{id}");
    }
}

#[test]
fn the_nearest_of_two_red_lights_counts() {
    let lights = |first, second| {
        let two = [(40.0, first), (50.0, second)];
        two.map(|(x, state)| light("lane", Some([x, 0.0]), move |_| state)).to_vec()
    };
    let scene = |lights| lit(road(), car("ego", [0.0, 0.0], 0.0, 10.0), lights);
    for name in STOPPING {
        let both = driven(&scene(lights(LightState::Stop, LightState::Stop)), name);
        let second = driven(&scene(lights(LightState::Go, LightState::Stop)), name);
        assert!(
            stands_before(&both, 40.0) && stands_before(&second, 50.0) && front(&second) > 42.0,
            "{name}"
        );
    }
}

#[test]
fn a_standing_car_before_the_light_is_still_a_leader() {
    let mut scene =
        scene(road(), vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("wall", [40.0, 0.0], 0.0, 0.0)]);
    scene.lights = vec![light("lane", Some([60.0, 0.0]), red)];
    let scene = prepared(scene);
    for name in STOPPING {
        let drive = driven(&scene, name);
        assert!(drive.contacts.is_empty() && front(&drive) < 40.0 - HALF, "{name}");
    }
}

#[test]
fn a_policy_that_drives_the_adversary_stops_too() {
    let mut scene =
        scene(road(), vec![car("ego", [-60.0, 0.0], 0.0, 0.0), car("other", [0.0, 0.0], 0.0, 10.0)]);
    scene.lights = vec![light("lane", Some([40.0, 0.0]), red)];
    let scene = prepared(scene);
    let idle = policy("constant", &json!({}));
    let start = Simulation::new(&scene, &Arc::default(), None, idle.as_ref(), 0).unwrap();
    let mut simulation = start.with_adversary(policy("idm", &json!({})).as_ref(), 0).unwrap();
    drive(&mut simulation).unwrap();
    let (motion, _) = simulation.world().adversary_motion().unwrap();
    assert!(motion.speed() < 0.1 && motion.position[0] + HALF <= 40.0, "{motion:?}");
}

#[test]
fn the_cases_of_public_reports_are_driven_as_they_must() {
    let Ok(folder) = env::var("SAGE_REFERENCE") else {
        return eprintln!("left out: SAGE_REFERENCE is not set");
    };
    let read = |name: &str| {
        let file = PathBuf::from(&folder).join("cases").join(name);
        let scene = Arc::new(Recording::read(&file).unwrap().scene);
        let index = SceneIndex::new(scene.map.clone());
        SimScene::new(scene, index).unwrap()
    };
    let (red, nuplan, none) = (read("light_red.pkl"), read("light_nuplan.pkl"), read("light_none.pkl"));
    assert!(nuplan.scene().lights[0].states.iter().all(|state| state.is_red()));
    for name in STOPPING {
        let drive = driven(&red, name);
        let end = &drive.motions[90];
        assert!(end.speed() < 0.1 && end.position[0] + 0.5 * red.ego_size()[0] <= 40.0, "{name}: {end:?}");
        assert!(driven(&none, name).motions[90].position[0] > 60.0, "{name}");
    }
}

/// Above 3 % the mapping of lights to routes would be wrong.
#[test]
fn few_recorded_egos_run_over_red() {
    let (mut all, mut with_light, mut over) = (0, 0, Vec::new());
    for scene in reference::scenes(&["pretrain", "dev", "val"]) {
        let index = SceneIndex::new(scene.map.clone());
        let scene = SimScene::new(scene, index).unwrap();
        let steps = over_red(&scene, &driven(&scene, "replay").motions);
        all += 1;
        with_light += usize::from(steps.is_some());
        over.extend(steps.filter(|steps| !steps.is_empty()).map(|steps| (scene.scene().id.clone(), steps)));
    }
    if let (Some(of_all), Some(of_lights)) =
        (statistics::wilson(over.len(), all), statistics::wilson(over.len(), with_light))
    {
        eprintln!(
            "{} of {all} recorded egos run over red {of_all:?}; of {with_light} with a light {of_lights:?}",
            over.len()
        );
        assert!(of_all.value < 0.03, "{over:?}");
    }
}
