//! Laws of the world: replay is exact, contacts are those of a plain test, saved states continue, bad input
//! gets errors.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

mod hand_made;
mod reference;

use std::sync::Arc;

use hand_made::{car, prepared, road, road_under_a_bridge, scene};
use sage_core::{
    geometry::{OrientedBox, distance},
    motion::{Pose, Trajectory},
    scene::SceneIndex,
};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    drive::{Simulation, Until, drive},
    fault::{FaultClass, classify},
    policy::{EgoPolicy, policies},
    traffic::{Plan, TrafficMode, TrafficOptions},
    vehicle::{Action, Tyres, Wheels},
    world::{Control, World, WorldOptions},
};

fn policy(name: &str) -> Box<dyn EgoPolicy> {
    policies().unwrap().build_default(name).unwrap()
}

/// Procedural scenes of every kind, and the recorded scenes of `dev` and `val` if they are there.
fn scenes() -> Vec<Arc<SimScene>> {
    let procedural = Kind::ALL.iter().flat_map(|kind| (0..3).filter_map(|n| generate(*kind, 1, n)));
    let mut scenes: Vec<_> = procedural.map(prepared).collect();
    for scene in reference::scenes(&["dev", "val"]) {
        let index = SceneIndex::new(scene.map.clone());
        scenes.push(SimScene::new(scene, index).unwrap());
    }
    scenes
}

fn simulation(scene: &Arc<SimScene>, name: &str, options: WorldOptions) -> Simulation {
    Simulation::new(scene, &Arc::new(options), None, policy(name).as_ref(), 7).unwrap()
}

#[test]
fn replay_equals_the_log() {
    for scene in scenes() {
        let mut replay = simulation(&scene, "replay", WorldOptions::default());
        for frame in 1..scene.scene().frames {
            replay.step().unwrap();
            let log = scene.log();
            let motion = replay.world().motion();
            if log.is_valid(frame) {
                assert_eq!(motion.position, log.point(frame));
                assert_eq!(motion.heading, log.heading[frame]);
                assert_eq!(motion.velocity, log.velocity[frame]);
            }
            let present: Vec<usize> = replay.world().bodies().iter().map(|body| body.track).collect();
            let tracks = scene.scene().tracks.iter().enumerate();
            let valid = tracks.filter(|(k, track)| *k != scene.scene().ego && track.is_valid(frame));
            assert_eq!(present, valid.map(|(k, _)| k).collect::<Vec<_>>());
            for body in replay.world().bodies() {
                let track = &scene.scene().tracks[body.track];
                assert_eq!(body.area.center, track.point(frame));
                assert_eq!(body.velocity, track.velocity[frame]);
            }
        }
    }
}

#[test]
fn a_controller_tracks_the_log_through_the_tyres() {
    let (mut near, mut frames, mut shortfalls) = (0, 0, Vec::new());
    for scene in scenes() {
        let mut tracking = simulation(&scene, "tracking", WorldOptions::default());
        let motions = drive(&mut tracking, Until::EndOfLog).unwrap().motions;
        let valid = (0..motions.len()).filter(|&frame| scene.log().is_valid(frame));
        let errors: Vec<f64> =
            valid.map(|frame| distance(motions[frame].position, scene.log().point(frame))).collect();
        let good = errors.iter().filter(|error| **error <= 0.5).count();
        if good < errors.len() {
            shortfalls.push(format!("{} ({} frames)", scene.scene().id, errors.len() - good));
        }
        (near, frames) = (near + good, frames + errors.len());
    }
    eprintln!("{near} of {frames} frames within 0.5 m; others in {}", shortfalls.join(", "));
    assert!(100 * near >= 95 * frames);
}

/// Every pair of boxes at every substep, without a search structure.
#[test]
fn contacts_are_those_of_a_plain_test_of_all_boxes() {
    let mut contacts = 0;
    for scene in scenes() {
        let mut driver = simulation(&scene, "constant-speed", WorldOptions::default());
        for frame in 1..scene.scene().frames {
            let start = driver.world().area();
            let before = driver.world().bodies().to_vec();
            let level = driver.world().level();
            driver.step().unwrap();
            let world = driver.world();
            let end = world.area();
            let mut expected: Vec<usize> = Vec::new();
            for to in world.bodies() {
                let from = before.iter().find(|body| body.track == to.track);
                let meets = |substep: usize| {
                    let share = substep as f64 / 5.0;
                    let other = match from {
                        Some(from) => from.area.between(&to.area, share),
                        None if substep == 5 => to.area,
                        None => return false,
                    };
                    start.between(&end, share).intersects(&other)
                };
                if (1..=5).any(meets) {
                    expected.push(to.track);
                }
            }
            let found: Vec<usize> = world.facts().contacts.iter().map(|contact| contact.track).collect();
            let has_levels = scene.index().has_levels(3.0);
            let ground =
                |track: usize| world.bodies().iter().find(|body| body.track == track).unwrap().ground;
            expected.retain(|&track| {
                found.contains(&track) || !has_levels || (ground(track) - level).abs() < 2.0
            });
            let mut sorted = found.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, expected, "{} frame {frame}", scene.scene().id);
            contacts += found.len();
        }
    }
    assert!(contacts > 10, "{contacts}");
}

#[test]
fn bodies_out_of_reach_do_not_change_the_path() {
    for scene in scenes().into_iter().step_by(3) {
        for name in ["idm", "constant"] {
            let whole = WorldOptions { whole_physics: true, ..WorldOptions::default() };
            let (mut near, mut all) =
                (simulation(&scene, name, WorldOptions::default()), simulation(&scene, name, whole));
            for _ in 1..scene.scene().frames {
                near.step().unwrap();
                all.step().unwrap();
                let (a, b) = (near.world().motion(), all.world().motion());
                assert!(distance(a.position, b.position) <= 1e-9, "{}", scene.scene().id);
                assert!(
                    (a.heading - b.heading).abs() <= 1e-9,
                    "{} {name} {:e} {:?}",
                    scene.scene().id,
                    a.heading - b.heading,
                    near.world().facts().contacts.len()
                );
                let tracks = |s: &Simulation| -> Vec<usize> {
                    s.world().facts().contacts.iter().map(|contact| contact.track).collect()
                };
                assert_eq!(tracks(&near), tracks(&all));
            }
        }
    }
}

#[test]
fn saved_states_continue_with_the_same_bits() {
    for scene in scenes().into_iter().step_by(4) {
        for name in ["idm", "expert", "idm-release", "tracking"] {
            let reactive = TrafficOptions { mode: TrafficMode::Reactive, ..TrafficOptions::default() };
            let options = WorldOptions { traffic: reactive, ..WorldOptions::default() };
            let mut first = simulation(&scene, name, options);
            for _ in 0..30 {
                first.step().unwrap();
            }
            let mut copy = first.clone();
            let saved = first.world().state().clone();
            let at_30 = first.world().clone();
            for _ in 0..40 {
                first.step().unwrap();
                copy.step().unwrap();
                assert!(first.world().state() == copy.world().state());
            }
            // A world continues from a saved state, whatever it has done since.
            let mut world = first.world().clone();
            world.restore(&saved).unwrap();
            let mut fresh = at_30.clone();
            for step in 0..40 {
                let control = Control::Drive(Action { steer: 0.01, throttle: 0.1 * f64::from(step % 5) });
                world.step(control, None).unwrap();
                fresh.step(control, None).unwrap();
                assert!(world.state() == fresh.state());
            }
        }
    }
}

#[test]
fn a_car_under_a_bridge_does_not_meet_the_cars_on_it() {
    let mut above = car("above", [40.0, -40.0], std::f64::consts::FRAC_PI_2, 10.0);
    above.position.iter_mut().for_each(|p| p[2] = 6.75);
    let tracks = vec![car("ego", [0.0, 0.0], 0.0, 10.0), above];
    let scene = prepared(scene(road_under_a_bridge(), tracks));
    let contacts = |flat: bool, name: &str| {
        let mut replay = simulation(&scene, name, WorldOptions { flat, ..WorldOptions::default() });
        drive(&mut replay, Until::EndOfLog).unwrap().contacts.len()
    };
    for name in ["replay", "tracking"] {
        assert_eq!((contacts(false, name), contacts(true, name)), (0, 1), "{name}");
    }
}

#[test]
fn traffic_is_not_pushed_and_the_ego_is() {
    // The ego drives at 15 m/s into a standing car.
    let tracks = vec![car("ego", [0.0, 0.0], 0.0, 15.0), car("wall", [30.0, 0.0], 0.0, 0.0)];
    let scene = prepared(scene(road(), tracks));
    let mut world = World::new(scene.clone(), Arc::default(), None, 0).unwrap();
    let mut first = None;
    for step in 1..60 {
        world.step(Control::Drive(Action { steer: 0.0, throttle: 0.1 }), None).unwrap();
        assert_eq!(world.bodies()[0].area.center, [30.0, 0.0]);
        first = first.or((!world.facts().contacts.is_empty()).then_some(step));
        assert!(world.motion().position[0] < 25.6, "the ego is in the wall at step {step}");
    }
    // 25.5 m of free road at 15 m/s.
    assert_eq!(first, Some(17));
    assert!(world.motion().speed() < 0.5);
}

#[test]
fn reactive_traffic_keeps_its_distance() {
    // A car behind replays 12 m/s; the ego stands.
    let tracks = vec![
        car("ego", [60.0, 0.0], 0.0, 0.0),
        car("adversary", [0.0, 50.0], 0.0, 1.0),
        car("behind", [0.0, 0.0], 0.0, 12.0),
    ];
    let scene = prepared(scene(road(), tracks));
    let contacts = |mode: TrafficMode| {
        let options = WorldOptions {
            traffic: TrafficOptions { mode, ..TrafficOptions::default() },
            ..WorldOptions::default()
        };
        drive(&mut simulation(&scene, "constant", options), Until::EndOfLog).unwrap().contacts
    };
    assert_eq!(contacts(TrafficMode::Reactive).len(), 0);
    let [hit] = &contacts(TrafficMode::Replay)[..] else { panic!("one contact") };
    let class = classify(hit, &sage_sim::vehicle::Vehicle::default(), scene.index());
    assert_eq!(class, FaultClass::StoppedEgo);
}

#[test]
fn a_plan_replaces_the_log_and_may_run_late() {
    let tracks = vec![car("ego", [0.0, 0.0], 0.0, 5.0), car("adversary", [20.0, 4.0], 0.0, 5.0)];
    let scene = prepared(scene(road(), tracks));
    let plan = Arc::new(Plan { track: 1, motion: car("adversary", [20.0, 8.0], 0.0, 7.0) });
    for (late, row) in [(false, 5), (true, 4)] {
        let traffic = TrafficOptions { late_plan: late, ..TrafficOptions::default() };
        let options = Arc::new(WorldOptions { traffic, ..WorldOptions::default() });
        let mut world = World::new(scene.clone(), options, Some(plan.clone()), 0).unwrap();
        for _ in 0..5 {
            world.step(Control::Drive(Action::default()), None).unwrap();
        }
        assert_eq!(world.bodies()[0].area.center, plan.motion.point(row));
    }
}

#[test]
fn a_policy_can_drive_the_adversary() {
    let tracks = vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("adversary", [-20.0, 0.0], 0.0, 14.0)];
    let scene = prepared(scene(road(), tracks));
    let ego = policy("replay");
    let build = |name: &str| {
        Simulation::new(&scene, &Arc::default(), None, ego.as_ref(), 0)
            .unwrap()
            .with_adversary(policy(name).as_ref(), 0)
            .unwrap()
    };
    // Its log runs into the ego from behind; the Intelligent Driver Model does not.
    let contacts = |name: &str| drive(&mut build(name), Until::EndOfLog).unwrap().contacts.len();
    assert_eq!((contacts("replay"), contacts("idm")), (1, 0));
    let mut saved = build("idm");
    saved.step().unwrap();
    let mut copy = saved.clone();
    for _ in 0..20 {
        saved.step().unwrap();
        copy.step().unwrap();
    }
    assert!(saved.world().state() == copy.world().state());
}

#[test]
fn bad_input_gets_clear_errors() {
    let ego = || car("ego", [0.0, 0.0], 0.0, 10.0);
    let inside = prepared(scene(road(), vec![ego(), car("inside", [1.0, 0.5], 0.0, 10.0)]));
    let fail = |scene: &Arc<SimScene>, plan| {
        World::new(scene.clone(), Arc::default(), plan, 0).err().unwrap().to_string()
    };
    let said = fail(&inside, None);
    assert!(said.contains("starts 1.5 m inside track `inside`") && said.contains("skip_close"), "{said}");

    let mut late = ego();
    late.valid[0] = false;
    let index = SceneIndex::new(Arc::new(road()));
    let unseen = scene(road(), vec![late, car("other", [50.0, 0.0], 0.0, 0.0)]);
    let said = SimScene::new(Arc::new(unseen), index).err().unwrap().to_string();
    assert!(said.contains("the ego `ego` is not valid at frame 0"), "{said}");

    let free = prepared(scene(road(), vec![ego(), car("other", [50.0, 9.0], 0.0, 0.0)]));
    let mut short = car("other", [50.0, 9.0], 0.0, 0.0);
    short.valid.pop();
    let plan = |motion| Some(Arc::new(Plan { track: 1, motion }));
    assert!(fail(&free, plan(short)).contains("plan: 90 points, expected 91"));
    let mut broken = car("other", [50.0, 9.0], 0.0, 0.0);
    broken.position[4][1] = f64::NAN;
    let said = fail(&free, plan(broken));
    assert!(said.contains("plan of track `other`: point 4 is [50.0, NaN]"), "{said}");

    let mut world = World::new(free, Arc::default(), None, 0).unwrap();
    let nan = Control::Drive(Action { steer: f64::NAN, throttle: 0.0 });
    let said = world.step(nan, None).err().unwrap().to_string();
    assert!(said.contains("hand-made") && said.contains("the action is [NaN, 0]"), "{said}");
    let pose = Control::Pose { pose: Pose::new(f64::INFINITY, 0.0, 0.0), velocity: None };
    assert!(
        world
            .step(pose, None)
            .err()
            .unwrap()
            .to_string()
            .contains("the pose is [inf, 0, 0], its velocity [0, 0]; expected finite numbers")
    );
}

#[test]
fn a_map_without_lanes_is_driven_and_leaves_the_lane_question_open() {
    // A car drifts into the ego's side.
    let mut drifting = car("drifting", [-2.0, 6.0], 0.0, 10.0);
    for (frame, p) in drifting.position.iter_mut().enumerate() {
        p[1] = 6.0 - 0.05 * frame as f64;
    }
    let scene =
        prepared(scene(sage_core::scene::Map::default(), vec![car("ego", [0.0, 0.0], 0.0, 10.0), drifting]));
    for name in ["replay", "idm", "idm-release", "expert", "expert-release", "tracking", "constant-speed"] {
        let drive = drive(&mut simulation(&scene, name, WorldOptions::default()), Until::EndOfLog).unwrap();
        assert!(drive.progress > 10.0, "{name}");
        if name == "replay" {
            let class = classify(&drive.contacts[0], &sage_sim::vehicle::Vehicle::default(), scene.index());
            assert_eq!((class, class.is_at_fault()), (FaultClass::LateralUnknown, None));
        }
    }
}

#[test]
fn boxes_keep_their_sizes_of_now() {
    let mut other = car("adversary", [50.0, 9.0], 0.0, 0.0);
    other.size.iter_mut().enumerate().for_each(|(frame, size)| size[0] = 4.0 + 0.01 * frame as f64);
    let scene = prepared(scene(road(), vec![car("ego", [0.0, 0.0], 0.0, 10.0), other]));
    let mut world = World::new(scene, Arc::default(), None, 0).unwrap();
    let length = |area: &OrientedBox| 2.0 * area.half_length;
    for _ in 0..3 {
        world.step(Control::Drive(Action::default()), None).unwrap();
        assert!((length(&world.bodies()[0].area) - 4.1).abs() < 1e-12);
    }
}

/// The boxes of every road user against the car's path, substep by substep, in a drive through the tyres.
#[test]
fn contacts_of_a_drive_are_those_of_a_plain_test() {
    let mut contacts = 0;
    for scene in scenes() {
        let mut driver = simulation(&scene, "constant", WorldOptions::default());
        for frame in 1..scene.scene().frames {
            let (start, size) = (*driver.world().motion(), driver.world().size());
            let before = driver.world().bodies().to_vec();
            driver.step().unwrap();
            let world = driver.world();
            // Once something is touched, the path depends on the response.
            let mut expected: Vec<usize> = Vec::new();
            let (car, mut motion) = (*world.car(), start);
            let wheels = Wheels::set(&car, Action::default(), start.speed());
            let mut tyres = Tyres::default();
            for substep in 1..=5 {
                motion = motion.coasted(0.02);
                let own = OrientedBox::new(motion.position, motion.heading, size[0], size[1]);
                for to in world.bodies() {
                    let from = before.iter().find(|body| body.track == to.track);
                    let other = match from {
                        Some(from) => from.area.between(&to.area, f64::from(substep) / 5.0),
                        None if substep == 5 => to.area,
                        None => continue,
                    };
                    if own.intersects(&other) {
                        expected.push(to.track);
                    }
                }
                if !expected.is_empty() {
                    break;
                }
                tyres.apply(&car, &wheels, &mut motion);
            }
            if scene.index().has_levels(3.0) {
                break;
            }
            let found: Vec<usize> = world.facts().contacts.iter().map(|contact| contact.track).collect();
            assert!(expected.iter().all(|track| found.contains(track)), "{} frame {frame}", scene.scene().id);
            assert_eq!(expected.is_empty(), found.is_empty(), "{} frame {frame}", scene.scene().id);
            if !found.is_empty() {
                contacts += 1;
                break;
            }
        }
    }
    assert!(contacts > 4, "{contacts}");
}

#[test]
fn a_car_that_is_squeezed_is_not_thrown_out() {
    for (offset, speed) in [(0.4, 8.0), (0.0, 5.0), (0.2, 30.0)] {
        let tracks = vec![
            car("ego", [0.0, 0.0], 0.0, 0.0),
            car("ahead", [6.0, 0.0], 0.0, 0.0),
            car("behind", [-20.0, offset], 0.0, speed),
        ];
        let scene = prepared(scene(road(), tracks));
        let mut world = World::new(scene, Arc::default(), None, 0).unwrap();
        for _ in 1..91 {
            world.step(Control::Drive(Action { steer: 0.0, throttle: -1.0 }), None).unwrap();
            assert!(
                world.motion().speed() < speed + 1.0,
                "{} m/s by a car of {speed}",
                world.motion().speed()
            );
        }
    }
}

#[test]
fn a_failed_step_changes_nothing_and_states_stay_with_their_scene() {
    let tracks = || vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("other", [50.0, 0.0], 0.0, 5.0)];
    let one = prepared(scene(road(), tracks()));
    let mut world = World::new(one, Arc::default(), None, 0).unwrap();
    let before = world.state().clone();
    world.step(Control::Drive(Action { steer: f64::NAN, throttle: 0.0 }), None).unwrap_err();
    assert!(world.state() == &before);
    let mut other = scene(road(), tracks());
    other.id = "another".to_owned();
    let other = World::new(prepared(other), Arc::default(), None, 0).unwrap();
    let said = world.restore(other.state()).unwrap_err().to_string();
    assert!(said.contains("the saved state belongs to another scene"), "{said}");
}

#[test]
fn reactive_vehicles_do_not_return_and_planned_ones_are_never_left_out() {
    // It is faster than its log and reaches the end of its route early.
    let tracks = vec![
        car("ego", [60.0, 8.0], 0.0, 0.0),
        car("adversary", [500.0, 50.0], 0.0, 0.0),
        car("behind", [0.0, 0.0], 0.0, 6.0),
    ];
    let prepared_scene = prepared(scene(road(), tracks));
    let traffic = TrafficOptions { mode: TrafficMode::Reactive, ..TrafficOptions::default() };
    let options = WorldOptions { traffic, ..WorldOptions::default() };
    let mut drive = simulation(&prepared_scene, "constant", options);
    let (mut last, mut is_gone) = (0.0, false);
    for _ in 1..91 {
        drive.step().unwrap();
        let behind = drive.world().bodies().iter().find(|body| body.track == 2);
        assert!(behind.is_none_or(|body| !is_gone && body.area.center[0] >= last));
        is_gone |= behind.is_none();
        last = behind.map_or(last, |body| body.area.center[0]);
    }
    assert!(is_gone);
    // A parked adversary with a plan moves, although parked cars are left out.
    let plan = Arc::new(Plan { track: 1, motion: car("adversary", [500.0, 50.0], 0.0, 7.0) });
    let traffic = TrafficOptions { parked: false, ..TrafficOptions::default() };
    let options = Arc::new(WorldOptions { traffic, ..WorldOptions::default() });
    let world = World::new(prepared_scene, options, Some(plan), 0).unwrap();
    assert!(world.bodies().iter().any(|body| body.track == 1));
}

#[test]
fn a_plan_on_a_slope_under_a_bridge_is_met() {
    // The road climbs 8 % and passes under a bridge, so levels count.
    let mut map = road_under_a_bridge();
    for point in &mut map.points[..81] {
        point[2] = 0.08 * (point[0] + 100.0);
    }
    map.points[81..].iter_mut().for_each(|point| point[2] += 0.08 * 140.0);
    let height = |x: f64| 0.08 * (x + 100.0) + 0.75;
    let climbing = |id: &str, x: f64, speed: f64| {
        let mut car = car(id, [x, 0.0], 0.0, speed);
        car.position.iter_mut().for_each(|p| p[2] = height(p[0]));
        car
    };
    let recorded = scene(map, vec![climbing("ego", 0.0, 12.0), climbing("adversary", 20.0, 12.0)]);
    // It drives on to 70 m and blocks the lane there.
    let points = (1..=80).map(|step| [(32.0 + 1.2 * f64::from(step)).min(70.0), 0.0]).collect();
    let plan = Plan::of_adversary(&recorded, &Trajectory::new("block", points).unwrap()).unwrap();
    let prepared_scene = prepared(recorded);
    assert!(prepared_scene.index().has_levels(3.0));
    let (ego, plan) = (policy("constant-speed"), Some(Arc::new(plan)));
    let mut simulation = Simulation::new(&prepared_scene, &Arc::default(), plan, ego.as_ref(), 0).unwrap();
    assert_eq!(drive(&mut simulation, Until::EndOfLog).unwrap().contacts.len(), 1);
}
