//! Laws of the world: replay is exact, saved states continue, plans and policies move the others, bad input
//! gets errors.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

mod driving;
mod hand_made;
mod reference;

use std::sync::Arc;

use driving::{policy, scenes, simulation};
use hand_made::{car, prepared, road, scene};
use insta::assert_snapshot;
use sage_core::{
    geometry::{OrientedBox, distance},
    motion::Pose,
    scene::SceneIndex,
};
use sage_sim::{
    SimScene,
    drive::{Simulation, drive},
    fault::{FaultClass, classify},
    traffic::{Plan, TrafficMode, TrafficOptions},
    vehicle::Action,
    world::{Control, World, WorldOptions},
};

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
        let motions = drive(&mut tracking).unwrap().motions;
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
fn saved_states_continue_with_the_same_bits() {
    for scene in scenes().into_iter().step_by(4) {
        for name in ["idm", "expert", "idm-release", "tracking"] {
            let reactive = TrafficOptions { mode: TrafficMode::Reactive, ..TrafficOptions::default() };
            let options = WorldOptions { traffic: reactive, ..WorldOptions::default() };
            let mut first = simulation(&scene, name, options);
            for _ in 0..30 {
                first.step().unwrap();
            }
            let mut copy = first.try_clone().unwrap();
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
        drive(&mut simulation(&scene, "constant", options)).unwrap().contacts
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
    let plan = Arc::new(Plan { track: 1, motion: car("adversary", [20.0, 8.0], 0.0, 7.0), reaction: None });
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
    let contacts = |name: &str| drive(&mut build(name)).unwrap().contacts.len();
    assert_eq!((contacts("replay"), contacts("idm")), (1, 0));
    let mut saved = build("idm");
    saved.step().unwrap();
    let mut copy = saved.try_clone().unwrap();
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
    assert_snapshot!(fail(&inside, None), @"scene `hand-made`: the ego starts 1.5 m inside track `inside` at frame 0; the option `skip_close` leaves such cars out");

    let mut late = ego();
    late.valid[0] = false;
    let index = SceneIndex::new(Arc::new(road()));
    let unseen = scene(road(), vec![late, car("other", [50.0, 0.0], 0.0, 0.0)]);
    let said = SimScene::new(Arc::new(unseen), index).err().unwrap().to_string();
    assert_snapshot!(said, @"scene `hand-made`: the ego `ego` is not valid at frame 0, where a drive starts");

    let free = prepared(scene(road(), vec![ego(), car("other", [50.0, 9.0], 0.0, 0.0)]));
    let mut short = car("other", [50.0, 9.0], 0.0, 0.0);
    short.valid.pop();
    let plan = |motion| Some(Arc::new(Plan { track: 1, motion, reaction: None }));
    assert_snapshot!(fail(&free, plan(short)), @"plan: 90 points, expected 91");
    let mut broken = car("other", [50.0, 9.0], 0.0, 0.0);
    broken.position[4][1] = f64::NAN;
    assert_snapshot!(fail(&free, plan(broken)), @"plan of track `other`: point 4 is [50.0, NaN]; expected finite coordinates within ±1e8 m");

    let mut world = World::new(free, Arc::default(), None, 0).unwrap();
    let nan = Control::Drive(Action { steer: f64::NAN, throttle: 0.0 });
    assert_snapshot!(world.step(nan, None).err().unwrap(), @"scene `hand-made`: step 1: the action is [NaN, 0]; expected finite numbers");
    let pose = Control::Pose { pose: Pose::new(f64::INFINITY, 0.0, 0.0), velocity: None };
    assert_snapshot!(world.step(pose, None).err().unwrap(), @"scene `hand-made`: step 1: the pose is [inf, 0, 0], its velocity [0, 0]; expected finite numbers");
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
        let drive = drive(&mut simulation(&scene, name, WorldOptions::default())).unwrap();
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
    assert_snapshot!(world.restore(other.state()).unwrap_err(), @"scene `hand-made`: the saved state belongs to another scene");
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
    let plan = Arc::new(Plan { track: 1, motion: car("adversary", [500.0, 50.0], 0.0, 7.0), reaction: None });
    let traffic = TrafficOptions { parked: false, ..TrafficOptions::default() };
    let options = Arc::new(WorldOptions { traffic, ..WorldOptions::default() });
    let world = World::new(prepared_scene, options, Some(plan), 0).unwrap();
    assert!(world.bodies().iter().any(|body| body.track == 1));
}
