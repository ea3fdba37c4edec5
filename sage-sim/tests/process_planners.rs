//! Planners that are programs: what they are told, what they may answer, and what happens when they misbehave.

#![cfg(unix)]
#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.
#![allow(clippy::print_stderr)] // Tests that are left out say so.

mod hand_made;
mod reference;

use std::{path::Path, process::Command, sync::Arc, time::Instant};

use approx::assert_relative_eq;
use hand_made::{car, prepared, road, scene};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    Error, SimScene,
    drive::{Drive, Simulation, drive},
    episode::Episode,
    policy::{EgoPolicy, policies},
};
use serde_json::{Value, json};

/// The scene of all tests: a road with a car far ahead.
fn road_ahead() -> Arc<SimScene> {
    prepared(scene(road(), vec![car("ego", [0.0, 0.0], 0.0, 8.0), car("other", [70.0, 0.0], 0.0, 8.0)]))
}

fn planner(command: &[&str], timeouts: [f64; 3]) -> Box<dyn EgoPolicy> {
    policies().unwrap().build("process", &json!({"command": command, "timeouts": timeouts})).unwrap()
}

fn driven(scene: &Arc<SimScene>, policy: &dyn EgoPolicy) -> Result<Drive, Error> {
    drive(&mut Simulation::new(scene, &Arc::default(), None, policy, 0)?)
}

/// A Python file of `tests/planners` as a command; `None`, said aloud, without Python.
fn python(file: &str) -> Option<[String; 2]> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/planners").join(file);
    let is_there = Command::new("python3").arg("--version").output().is_ok_and(|out| out.status.success());
    if !is_there {
        eprintln!("left out: planners need python3");
    }
    is_there.then(|| ["python3".to_owned(), path.display().to_string()])
}

const LATE: [f64; 3] = [20.0, 20.0, 10.0];

/// Ways to misbehave, with the times to answer where they are what is tested.
const WAYS: [(&str, [f64; 3]); 36] = [
    ("exits at its start", LATE),
    ("is silent at its start", [0.1, 20.0, 10.0]),
    ("speaks another version", LATE),
    ("leaves the version out", LATE),
    ("asks for observation by a word", LATE),
    ("exits at reset", LATE),
    ("is silent at reset", [20.0, 0.1, 10.0]),
    ("is not ready", LATE),
    ("exits at step 7", LATE),
    ("is killed", LATE),
    ("is silent", [20.0, 20.0, 0.1]),
    ("ignores SIGTERM", [20.0, 20.0, 0.1]),
    ("closes its output", LATE),
    ("writes too much to its log", LATE),
    ("sends half a line", [20.0, 20.0, 0.1]),
    ("sends a line of a gigabyte", LATE),
    ("sends deep JSON", LATE),
    ("sends NaN", LATE),
    ("sends infinity", LATE),
    ("sends bytes", LATE),
    ("sends an empty line", LATE),
    ("sends two lines", LATE),
    ("sends a list", LATE),
    ("leaves throttle out", LATE),
    ("sends a word", LATE),
    ("sends null", LATE),
    ("sends two kinds", LATE),
    ("sends no kind", LATE),
    ("sends an empty plan", LATE),
    ("sends a plan that is a number", LATE),
    ("sends rows of five", LATE),
    ("sends rows of words", LATE),
    ("sends a plan in the world's frame", LATE),
    ("keeps a plan for no step", LATE),
    ("writes too much to its log at its start", LATE),
    ("answers an earlier step", LATE),
];

#[test]
fn misbehaving_planners_fail_their_drive_with_a_clear_message() {
    let Some([program, file]) = python("misbehaving.py") else { return };
    let scene = road_ahead();
    let more = [("keeps a control", LATE), ("says what is wrong", LATE)];
    let messages = WAYS.iter().chain(&more).map(|(way, timeouts)| {
        let policy = planner(&[&program, &file, way], *timeouts);
        let start = Instant::now();
        let error = driven(&scene, &*policy).err().unwrap_or_else(|| panic!("{way}: it drives"));
        assert!(matches!(error, Error::Planner { .. }), "{way}: {error}");
        assert!(start.elapsed().as_secs_f64() < 20.0, "{way}");
        // The next drive gets a new program, which misbehaves again: nothing of the first is left in the pipe.
        let again =
            driven(&scene, &*policy).err().unwrap_or_else(|| panic!("{way}: it drives the second time"));
        assert_eq!(again.to_string(), error.to_string(), "{way}");
        format!("{way}\n    {}\n", error.to_string().replace(&file, "misbehaving.py"))
    });
    insta::assert_snapshot!(messages.collect::<String>());
}

/// The planner that offers ways of following, with one of them.
fn by(argument: &str, follow: Option<&str>, timeouts: [f64; 3]) -> Option<Box<dyn EgoPolicy>> {
    let command = [&python("ways.py")?[..], &[argument.to_owned()]].concat();
    let options = json!({"command": command, "timeouts": timeouts, "follow": follow});
    Some(policies().unwrap().build("process", &options).unwrap())
}

#[test]
fn a_plan_is_followed_in_each_way_that_the_planner_offers() {
    let scene = road_ahead();
    let Some(tracked) = by("", None, LATE) else { return };
    let names: Vec<String> = tracked.other_ways().unwrap().into_iter().map(|way| way.name).collect();
    assert_eq!(names, ["exact"]);
    let other = tracked.other_ways().unwrap().remove(0).policy;
    let exact = driven(&scene, &*other).unwrap();
    assert_eq!(exact.motions, driven(&scene, &*by("", Some("exact"), LATE).unwrap()).unwrap().motions);
    for (k, motion) in exact.motions.iter().enumerate() {
        assert_relative_eq!(motion.position[0], 0.8 * k as f64, epsilon = 1e-6);
    }
    assert!(exact.distances_to_plan(90).iter().all(|distance| *distance < 1e-6));
    // A tracker leads a car to a plan beside it, and is beside it meanwhile.
    let beside = driven(&scene, &*by("beside", None, LATE).unwrap()).unwrap();
    assert_eq!(beside.distances_to_plan(90).len(), 90);
    assert!(beside.distances_to_plan(90).iter().any(|distance| *distance > 0.05));
    let error = |argument, follow| {
        driven(&scene, &*by(argument, Some(follow), LATE).unwrap()).unwrap_err().to_string()
    };
    let said = error("jumps", "exact");
    assert!(said.contains("beyond the car: speed along the way there 50.00 m/s"), "{said}");
    let said = error("", "mpc");
    assert!(said.ends_with("does not offer to follow by `mpc`; it offers tracked, exact"), "{said}");
}

#[test]
fn a_contact_ends_the_drive_of_a_car_that_follows_exactly_like_any_other() {
    let standing = || car("other", [30.0, 0.0], 0.0, 0.0);
    let scene = prepared(scene(road(), vec![car("ego", [0.0, 0.0], 0.0, 8.0), standing()]));
    let Some(exact) = by("", Some("exact"), LATE) else { return };
    let episode = Episode::run(&scene, None, &*exact, 0).unwrap();
    assert!(!episode.is_posed && episode.contacts.len() == 1);
    assert_eq!(episode.contacts[0].class.is_at_fault(), Some(true));
}

#[test]
fn a_planner_that_waits_has_more_time_than_one_that_computes() {
    let scene = road_ahead();
    let limits = [20.0, 20.0, 0.2];
    let Some(sleeps) = by("sleeps", None, limits) else { return };
    let mut simulation = Simulation::new(&scene, &Arc::default(), None, &*sleeps, 0).unwrap();
    for _ in 0..6 {
        simulation.step().unwrap();
    }
    if cfg!(target_os = "linux") {
        let computes = by("computes", None, limits).unwrap();
        let error = driven(&scene, &*computes).unwrap_err();
        assert!(error.to_string().contains("no answer within 0.2 s of computing, or 2 s in all"), "{error}");
        // An attacked drive begins once more, in another program.
        let twice = Episode::run(&scene, None, &*computes, 0).unwrap_err();
        assert!(twice.to_string().contains("the drive was begun twice"), "{twice}");
    }
}

#[test]
fn a_planner_is_told_lanes_with_their_widths_neighbours_and_bounds() {
    let data = generate(Kind::FourWay, 1, 0).unwrap();
    let map = data.map.clone();
    let scene = SimScene::new(data.into(), sage_core::scene::SceneIndex::new(map)).unwrap();
    let told = |argument: &str| -> Option<Value> {
        let folder = tempfile::tempdir().unwrap();
        let policy = by(argument, None, LATE)?;
        policy.write_logs_to(folder.path());
        driven(&scene, &*policy).unwrap();
        let log = std::fs::read_to_string(folder.path().join("planner-1.log")).unwrap();
        Some(serde_json::from_str(log.lines().find(|line| line.starts_with('{')).unwrap()).unwrap())
    };
    let Some(reset) = told("") else { return };
    let lanes: Vec<&Value> =
        reset["map"].as_array().unwrap().iter().filter(|feature| feature.get("exits").is_some()).collect();
    let has_id = |id: &Value| lanes.iter().any(|lane| lane["id"] == *id);
    let on_route = reset["route_lanes"].as_array().unwrap();
    assert!(!on_route.is_empty() && on_route.iter().all(has_id));
    for lane in &lanes {
        let points = lane["points"].as_array().unwrap().len();
        assert_eq!(lane["width"].as_array().unwrap().len(), points);
        for side in ["left", "right"] {
            let neighbors = lane["neighbors"][side].as_array().unwrap();
            assert_eq!(neighbors.len(), lane[side].as_array().unwrap().len());
            for stretch in neighbors.iter().chain(lane["boundaries"][side].as_array().unwrap()) {
                assert!(
                    stretch["from"].as_u64() <= stretch["to"].as_u64()
                        && (stretch["to"].as_u64().unwrap() as usize) < points
                );
            }
        }
    }
    let length = scene.guide().length();
    assert!((10.0..=length).contains(&reset["goal"].as_f64().unwrap()));
    assert_eq!(told("no goal").unwrap().get("goal"), None);
}

#[test]
fn one_answer_too_many_fails_the_drive_whenever_it_comes() {
    let Some([program, file]) = python("misbehaving.py") else { return };
    let scene = road_ahead();
    for step in [0, 1, 5, 40, 78] {
        let policy = planner(&[&program, &file, &format!("answers once too often at step {step}")], LATE);
        let error = driven(&scene, &*policy).expect_err("it drives");
        assert!(matches!(error, Error::Planner { .. }), "{error}");
    }
}

#[test]
fn what_a_planner_prints_before_it_says_hello_goes_to_its_log() {
    let Some([program, file]) = python("misbehaving.py") else { return };
    let scene = road_ahead();
    let folder = tempfile::tempdir().unwrap();
    let policy = planner(&[&program, &file, "prints a banner"], LATE);
    policy.write_logs_to(folder.path());
    let (printed, plain) =
        (driven(&scene, &*policy).unwrap(), driven(&scene, &*planner(&[&program, &file], LATE)));
    assert_eq!(printed.motions, plain.unwrap().motions);
    let log = std::fs::read_to_string(folder.path().join("planner-1.log")).unwrap();
    assert_eq!(log, "Welcome to my planner 1.0\n[1, 2]\nsage: a drive in scene hand-made\n");
}

#[test]
fn a_command_that_cannot_be_started_is_named() {
    let scene = road_ahead();
    let message = |command: &[&str]| driven(&scene, &*planner(command, LATE)).err().unwrap().to_string();
    insta::assert_snapshot!(message(&["./no-such-planner", "x"]), @"scene `hand-made`: the planner `./no-such-planner x` does not start: No such file or directory (os error 2); there is no program `./no-such-planner`, and no shell reads the command: cmd:sh -c '…' asks one");
    insta::assert_snapshot!(message(&["/"]), @"scene `hand-made`: the planner `/` does not start: Permission denied (os error 13)");
    let build = |options: Value| policies().unwrap().build("process", &options).err().unwrap().to_string();
    insta::assert_snapshot!(build(json!({})), @"options of policy `process`: `command` is empty; write cmd:COMMAND, such as 'cmd:python3 my_planner.py'");
    insta::assert_snapshot!(build(json!({"command": ["x"], "timeouts": [1, 0, 1]})), @"options of policy `process`: `timeouts` has 0; expected seconds above 0 and up to 86400");
    insta::assert_snapshot!(build(json!({"command": ["x"], "radius": -1})), @"options of policy `process`: `radius` is -1; expected metres from 0 to 10000");
}

#[test]
fn no_process_of_a_planner_is_left() {
    let Some([program, file]) = python("misbehaving.py") else { return };
    let folder = tempfile::tempdir().unwrap();
    let note = folder.path().join("pid");
    let policy = planner(&[&program, &file, "leaves a child with the pipe", note.to_str().unwrap()], LATE);
    let start = Instant::now();
    let error = driven(&road_ahead(), &*policy).err().unwrap().to_string();
    assert!(error.contains("it ended (exit status 0)"), "{error}");
    assert!(start.elapsed().as_secs_f64() < 10.0, "it waits for the child");
    let child: i32 = std::fs::read_to_string(&note).unwrap().parse().unwrap();
    // A killed child may stay as a zombie until its new parent asks for it.
    let state = || std::fs::read_to_string(format!("/proc/{child}/stat")).unwrap_or_default();
    let is_gone = || !Path::new("/proc/self").exists() || state().is_empty() || state().contains(") Z ");
    let end = Instant::now();
    while !is_gone() && end.elapsed().as_secs_f64() < 5.0 {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert!(is_gone(), "process {child} is left: {}", state());
}

#[test]
fn a_constant_control_is_that_of_the_policy_constant() {
    let Some([program, file]) = python("misbehaving.py") else { return };
    let scene = road_ahead();
    let policy = planner(&[&program, &file], LATE);
    let constant = policies().unwrap().build("constant", &json!({"steer": 0.0, "throttle": 0.1})).unwrap();
    let expected = driven(&scene, &*constant).unwrap();
    // Several drives of one program.
    for _ in 0..3 {
        assert_eq!(driven(&scene, &*policy).unwrap(), expected);
    }
}

#[test]
fn the_state_of_a_program_is_not_copied() {
    let Some([program, file]) = python("misbehaving.py") else { return };
    let policy = planner(&[&program, &file], LATE);
    let simulation = Simulation::new(&road_ahead(), &Arc::default(), None, &*policy, 0).unwrap();
    let error = simulation.try_clone().err().unwrap().to_string().replace(&file, "misbehaving.py");
    insta::assert_snapshot!(error, @"the drive cannot be saved: the planner `python3 misbehaving.py` is a program, whose state cannot be copied");
}

/// A planner in `sh`, which answers every step with the same line.
fn answering(line: &str) -> Box<dyn EgoPolicy> {
    let script = format!(
        r#"while read -r message; do case "$message" in *'"step"'*) echo '{line}';; *'"reset"'*) echo '{{"ready": true}}';; *) echo '{{"hello": 1}}';; esac; done"#
    );
    planner(&["sh", "-c", &script], LATE)
}

#[test]
fn plans_are_followed_by_the_tracker() {
    let scene = road_ahead();
    // Straight on at 8 m/s, as it starts: it stays at that speed, less what the tyres lose.
    let rows: Vec<[f64; 2]> = (1..=40).map(|k| [0.8 * f64::from(k), 0.0]).collect();
    let drive = driven(&scene, &*answering(&json!({"plan": rows}).to_string())).unwrap();
    let last = drive.motions.last().unwrap();
    assert_relative_eq!(last.speed(), 8.0, epsilon = 0.1);
    assert_relative_eq!(last.position[0], 72.0, epsilon = 1.0);
    assert_relative_eq!(last.position[1], 0.0, epsilon = 1e-6);
    // The same with headings and speeds, asked for every tenth step.
    let rows: Vec<[f64; 4]> = (1..=40).map(|k| [0.8 * f64::from(k), 0.0, 0.0, 8.0]).collect();
    let kept = driven(&scene, &*answering(&json!({"plan": rows, "again": 10}).to_string())).unwrap();
    assert_relative_eq!(kept.motions.last().unwrap().position[0], last.position[0], epsilon = 1.0);
    // A place to stand still at: it stops.
    let stop = driven(&scene, &*answering(r#"{"plan": [[0, 0, 0, 0]]}"#)).unwrap();
    assert!(stop.motions.last().unwrap().speed() < 0.1, "{:?}", stop.motions.last());
    // To the left: a circle of 40 m radius, planned once, is followed within a metre.
    let circle = |k: i32| {
        let angle = 0.8 * f64::from(k) / 40.0;
        [40.0 * angle.sin(), 40.0 * (1.0 - angle.cos()), angle]
    };
    let rows: Vec<[f64; 3]> = (1..=100).map(circle).collect();
    let left = driven(&scene, &*answering(&json!({"plan": rows, "again": 100}).to_string())).unwrap();
    for motion in &left.motions {
        let radius = motion.position[0].hypot(motion.position[1] - 40.0);
        assert!((radius - 40.0).abs() < 1.0, "{motion:?}");
    }
    assert!(left.motions.last().unwrap().heading > 1.2, "{:?}", left.motions.last());
}

#[test]
fn accelerations_and_angles_are_controls_too() {
    let scene = road_ahead();
    let drive = driven(&scene, &*answering(r#"{"acceleration": 0.5, "steering_angle": 0.0}"#)).unwrap();
    assert_relative_eq!(drive.motions[50].speed(), 8.0 + 0.5 * 5.0, epsilon = 0.05);
    let car = sage_sim::vehicle::Vehicle::default();
    let angle = 0.1 * car.max_steering;
    let own = driven(&scene, &*answering(&format!(r#"{{"acceleration": 0, "steering_angle": {angle}}}"#)));
    let constant = policies().unwrap().build("constant", &json!({"steer": 0.1, "throttle": 0.0})).unwrap();
    assert_eq!(own.unwrap(), driven(&scene, &*constant).unwrap());
}

/// Procedural scenes, and those of `val` where they are.
fn many_scenes() -> Vec<Arc<SimScene>> {
    let procedural = Kind::ALL.iter().filter_map(|kind| generate(*kind, 2, 0)).map(prepared);
    procedural
        .chain(reference::scenes(&["val"]).into_iter().map(|scene| prepared((*scene).clone())))
        .collect()
}

#[test]
fn a_planner_in_python_drives_like_the_same_policy_here() {
    let Some([program, _]) = python("misbehaving.py") else { return };
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/planners/idm.py");
    let options = json!({"command": [program, file], "timeouts": LATE, "agents": 1000});
    let planner = policies().unwrap().build("process", &options).unwrap();
    let options = json!({"lane_changes": null, "curves": null, "speed_limits": false});
    let own = policies().unwrap().build("idm", &options).unwrap();
    for scene in many_scenes() {
        let name = &scene.scene().id;
        let [theirs, ours] = [&planner, &own].map(|policy| Episode::run(&scene, None, &**policy, 0).unwrap());
        assert_eq!(
            (theirs.end, theirs.steps(), theirs.arrived),
            (ours.end, ours.steps(), ours.arrived),
            "{name}"
        );
        let hits = |episode: &Episode| -> Vec<_> {
            episode.contacts.iter().map(|c| (c.contact.step, c.contact.other.track, c.class)).collect()
        };
        assert_eq!(hits(&theirs), hits(&ours), "{name}");
        // How cars are pushed apart depends on the last bit.
        let free = ours.contacts.first().map_or(usize::MAX, |contact| contact.contact.step);
        for (a, b) in theirs.drive.motions.iter().zip(&ours.drive.motions).take(free) {
            assert_relative_eq!(a.position[0], b.position[0], epsilon = 1e-6);
            assert_relative_eq!(a.position[1], b.position[1], epsilon = 1e-6);
        }
    }
}
