//! Scenes written as OpenSCENARIO with an OpenDRIVE map: they say what the scene says, and follow the rules of
//! the standards.
//!
//! Real scenes need `SAGE_DATA`. ASAM's own checkers need `SAGE_ASAM_PYTHON`: a Python with the packages that
//! `standards/check.py` names.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod real;
mod standards;

use std::{
    collections::BTreeSet,
    io::Write,
    path::{Path, PathBuf},
    process::Command,
    sync::Arc,
};

use sage_core::{
    geometry::wrap_angle,
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions},
    scene::{Scene, SceneIndex},
};
use sage_data::{
    Recording, folder,
    openscenario::{EgoMode, Export, License, Options, Provenance, Standard, origin_of},
    procedural::{Kind, attacks, generate},
};
use standards::{
    map::{Network, gap},
    play::{Actor, play},
    rules, scenes,
    xml::Element,
};

fn procedural() -> Vec<Scene> {
    Kind::ALL.into_iter().map(|kind| generate(kind, 11, 3).unwrap()).collect()
}

fn examples() -> Vec<Scene> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
    let files = folder::scene_files(&folder).unwrap();
    files.iter().map(|file| Recording::read(file).unwrap().scene).collect()
}

/// The scenes that are always there.
fn built_in() -> Vec<Scene> {
    [examples(), procedural(), scenes::odd()].concat()
}

/// The scenes of `val`.
fn val() -> Vec<Scene> {
    let Some(data) = real::data() else { return Vec::new() };
    let files = folder::scene_files(&data.join("val")).unwrap();
    files.iter().map(|file| Recording::read(file).unwrap().scene).collect()
}

fn options(standard: Standard, ego: EgoMode) -> Options {
    Options { standard, ego, license: None }
}

fn every_option() -> impl Iterator<Item = Options> {
    Standard::ALL.into_iter().flat_map(|standard| EgoMode::ALL.map(|ego| options(standard, ego)))
}

fn parsed(text: &str) -> Element {
    Element::parse(text).unwrap_or_else(|problem| panic!("{problem}"))
}

/// The map of a scene and the scenario in the default version.
fn written(scene: &Scene) -> (Export, Element, Network) {
    let export = Export::new(scene, Options::default());
    let root = parsed(&export.network().xml);
    let network = Network::of(&root);
    (export, root, network)
}

/// Pairs of a track with its index and its road user in the file, which keeps the order of the scene.
fn cast<'s>(scene: &'s Scene, actors: &'s [Actor]) -> Vec<(usize, &'s Actor)> {
    let present: Vec<usize> =
        (0..scene.tracks.len()).filter(|k| scene.tracks[*k].valid.contains(&true)).collect();
    assert_eq!(present.len(), actors.len(), "{}", scene.id);
    present.into_iter().zip(actors).collect()
}

/// How far a played scenario is from its scene: the worst distances of centres (m), of headings (rad) and of
/// lower sides (m), and the frames at which a road user is wrongly there or not there.
fn deviations(scene: &Scene, actors: &[Actor], skip_ego: bool) -> ([f64; 3], Vec<String>) {
    let origin = origin_of(scene);
    let (mut worst, mut wrong) = ([0.0f64; 3], Vec::new());
    for (index, actor) in cast(scene, actors) {
        let track = &scene.tracks[index];
        if actor.states.len() != scene.frames {
            wrong.push(format!("{} frames", actor.states.len()));
        }
        if skip_ego && index == scene.ego {
            continue;
        }
        let stands = is_still(track);
        for (frame, state) in actor.states.iter().enumerate() {
            if state.is_some() != is_there(track, frame) {
                wrong.push(format!("{} at frame {frame}: {state:?}", actor.name));
            }
            let (Some([x, y, z, heading]), true) = (state, track.is_valid(frame)) else { continue };
            let [true_x, true_y, center] = track.position[frame];
            let off = gap([x + origin[0], y + origin[1]], [true_x, true_y]);
            let turn = wrap_angle(heading - track.heading[frame]).abs();
            let rise = (z + origin[2] - (center - 0.5 * track.size[frame][2])).abs();
            // The height of who stands varies with the sensor, and is that of the first frame.
            worst =
                [worst[0].max(off), worst[1].max(turn), if stands { worst[2] } else { worst[2].max(rise) }];
            assert!(!stands || rise <= 0.1, "{}: {rise}", actor.name);
        }
    }
    (worst, wrong)
}

/// Whether a track never leaves its first place and heading.
fn is_still(track: &sage_core::scene::Track) -> bool {
    let mut poses =
        (0..track.valid.len()).filter(|f| track.is_valid(*f)).map(|f| (track.point(f), track.heading[f]));
    let first = poses.next();
    poses.all(|pose| Some(pose) == first)
}

/// Whether a track is valid at a frame or within a gap of at most ten frames.
fn is_there(track: &sage_core::scene::Track, frame: usize) -> bool {
    let before = (0..=frame).rev().find(|f| track.is_valid(*f));
    let after = (frame..track.valid.len()).find(|f| track.is_valid(*f));
    matches!((before, after), (Some(a), Some(b)) if b - a <= 11)
}

#[test]
fn a_played_scenario_is_the_scene_at_every_frame() {
    let (mut worst, mut frames) = ([0.0f64; 3], 0);
    for scene in built_in().iter().chain(&val()) {
        for options in every_option() {
            let controlled = options.ego == EgoMode::Controller;
            let export = Export::new(scene, options.clone());
            let actors = play(&parsed(&export.scenario(scene, &Provenance::default())));
            let (found, wrong) = deviations(scene, &actors, controlled);
            assert!(wrong.is_empty(), "{} {options:?}: {wrong:?}", scene.id);
            assert!(found.iter().all(|x| *x <= 1e-6), "{} {options:?}: {found:?}", scene.id);
            worst = [0, 1, 2].map(|k| worst[k].max(found[k]));
            frames += scene.tracks.iter().map(|track| track.count_valid(0..scene.frames)).sum::<usize>();
        }
    }
    println!("{frames} frames of road users, worst deviations {worst:?} (m, rad, m)");
}

#[test]
fn a_wrong_position_heading_or_time_is_a_deviation() {
    let scene = &procedural()[3];
    let export = Export::new(scene, Options::default());
    let text = export.scenario(scene, &Provenance::default());
    let sound = |text: &str| {
        let (found, wrong) = deviations(scene, &play(&parsed(text)), false);
        wrong.is_empty() && found.iter().all(|x| *x <= 1e-6)
    };
    assert!(sound(&text));
    let vertex = text.match_indices("<Vertex time=\"3.7\">").nth(4).unwrap().0;
    for (name, change) in [("x", 2e-6), ("y", -2e-6), ("z", 2e-6), ("h", 2e-6)] {
        let from = vertex + text[vertex..].find(&format!(" {name}=\"")).unwrap() + 4;
        let to = from + text[from..].find('"').unwrap();
        let value: f64 = text[from..to].parse().unwrap();
        let changed = format!("{}{:.6}{}", &text[..from], value + change, &text[to..]);
        assert!(!sound(&changed), "{name}");
    }
    // Another frame of the end, and of somebody's appearance.
    assert!(!sound(&text.replace("value=\"8.999999\"", "value=\"8.899999\"")));
    let late = scenes::odd().into_iter().find(|scene| scene.id == "comings and goings").unwrap();
    let text = Export::new(&late, Options::default()).scenario(&late, &Provenance::default());
    for (from, to) in
        [("value=\"6.099999\"", "value=\"6.199999\""), ("value=\"2.949999\"", "value=\"2.849999\"")]
    {
        assert!(text.contains(from), "{from}");
        let actors = play(&parsed(&text.replace(from, to)));
        assert!(!deviations(&late, &actors, false).1.is_empty(), "{from}");
    }
}

#[test]
fn scenarios_follow_the_rules_of_their_version() {
    for scene in built_in().iter().chain(&val()) {
        let (export, _, network) = written(scene);
        for options in every_option() {
            let standard = options.standard;
            let scenario = Export::new(scene, options).scenario(scene, &Provenance::default());
            let wrong =
                rules::scenario(&parsed(&scenario), standard, &export.network().file_name(), &network);
            assert!(wrong.is_empty(), "{} {standard}: {wrong:?}", scene.id);
        }
    }
}

#[test]
fn injected_faults_break_the_rules() {
    let scene = generate(Kind::FourWay, 11, 3).unwrap();
    let (export, _, network) = written(&scene);
    let file = export.network().file_name();
    let scenario = export.scenario(&scene, &Provenance::default());
    let is_sound = |text: &str| rules::scenario(&parsed(text), Standard::V1_2, &file, &network).is_empty();
    assert!(is_sound(&scenario));
    let second = scenario.match_indices("<ScenarioObject name=\"").nth(3).unwrap().0;
    let name = scenario[second..].split('"').nth(1).unwrap();
    for (from, to) in [
        ("entityRef=\"Ego\"", "entityRef=\"Egon\""),
        (file.as_str(), "other.xodr"),
        ("priority=\"override\"", "priority=\"overwrite\""),
        ("greaterOrEqual", "greaterThan"),
        ("<TrafficSignalStateAction name=\"1\"", "<TrafficSignalStateAction name=\"999\""),
        ("<ScenarioObject name=\"Adversary\"", &format!("<ScenarioObject name=\"{name}\"")),
        ("revMinor=\"2\"", "revMinor=\"1\""),
        ("\n<CatalogLocations/>", ""),
    ] {
        let changed = match from {
            "\n<CatalogLocations/>" => {
                scenario.replace(from, "").replace("</Entities>", "</Entities>\n<CatalogLocations/>")
            }
            _ => scenario.replacen(from, to, 1),
        };
        assert!(changed != scenario && !is_sound(&changed), "{from}");
    }
    let map = &export.network().xml;
    let is_sound = |text: &str| {
        let root = parsed(text);
        rules::map(&root, &Network::of(&root)).is_empty()
    };
    assert!(is_sound(map));
    let road = map.find("<paramPoly3").unwrap();
    let changed = |from: usize, name: &str, change: f64| {
        let key = format!(" {name}=\"");
        let from = from + map[from..].find(&key).unwrap() + key.len();
        let to = from + map[from..].find('"').unwrap();
        let value: f64 = map[from..to].parse().unwrap();
        format!("{}{:.9}{}", &map[..from], value + change, &map[to..])
    };
    let geometry = map[..road].rfind("<geometry").unwrap();
    for (name, change) in [("x", 0.02), ("hdg", 0.01), ("length", 0.002), ("s", 0.001)] {
        assert!(!is_sound(&changed(geometry, name, change)), "{name}");
    }
    for name in ["bU", "cV", "dV"] {
        assert!(!is_sound(&changed(road, name, 0.02)), "{name}");
    }
    let joined = map.find("contactPoint=\"start\"").unwrap();
    let offset = joined + map[joined..].find("<laneOffset").unwrap();
    let width = joined + map[joined..].find("<width").unwrap();
    assert!(!is_sound(&changed(offset, "a", 0.02)) && !is_sound(&changed(width, "a", 0.02)));
    assert!(!is_sound(&changed(joined, "elementId", 0.0).replacen("predecessor", "successor", 1)));
    let connection = map.find("<connection").unwrap();
    let end = connection + map[connection..].find("</connection>").unwrap() + "</connection>".len();
    assert!(!is_sound(&format!("{}{}", &map[..connection], &map[end..])));
    assert!(!is_sound(&map.replacen("<laneLink from=\"-1\"", "<laneLink from=\"1\"", 1)));
}

/// First frame of the future at which two boxes overlap.
fn first_contact(ego: &Actor, adversary: &Actor) -> Option<usize> {
    (NOW + 1..ego.states.len()).find(|frame| {
        match (ego.oriented_box(*frame), adversary.oriented_box(*frame)) {
            (Some(a), Some(b)) => a.intersects(&b),
            _ => false,
        }
    })
}

/// The scene with its adversary on a trajectory, and the frame of its contact by the boxes that are scored.
fn attacked(scene: &Scene, trajectory: &Trajectory) -> (Scene, Option<usize>) {
    let shared = Arc::new(scene.clone());
    let ctx = Context::new(&shared, &SceneIndex::new(scene.map.clone()), &ContextOptions::default()).unwrap();
    let candidate = ctx.candidate(trajectory.clone());
    let step = (0..HORIZON).find(|&step| {
        ctx.ego().boxes()[step].as_ref().is_some_and(|ego| ego.intersects(&candidate.boxes()[step]))
    });
    let mut attacked = scene.clone();
    let adversary = scene.adversary.unwrap();
    attacked.tracks[adversary] = scene.tracks[adversary].following(trajectory);
    (attacked, step.map(|step| NOW + 1 + step))
}

#[test]
fn an_attack_meets_the_ego_in_the_file_at_the_frame_of_the_scene() {
    let mut contacts = 0;
    for scene in procedural().iter().chain(&val()).filter(|scene| scene.adversary.is_some()) {
        let mut trajectories: Vec<Trajectory> =
            attacks(scene).into_iter().map(|(_, attack)| attack).collect();
        // Straight to where the ego is at a frame, wherever the road is.
        let from = scene.adversary().unwrap().point(NOW);
        for frame in [20, 45, 90] {
            let to = scene.ego().point(frame.min(scene.frames - 1));
            let along = |t: usize| (t as f64 / (frame - NOW) as f64).min(1.0);
            let point = |t: usize| [0, 1].map(|k| from[k] + along(t) * (to[k] - from[k]));
            trajectories.push(Trajectory::new("to the ego", (1..=HORIZON).map(point).collect()).unwrap());
        }
        let export = Export::new(scene, Options::default());
        for trajectory in &trajectories {
            let (variant, expected) = attacked(scene, trajectory);
            let actors = play(&parsed(&export.scenario(&variant, &Provenance::default())));
            let [ego, adversary] =
                ["Ego", "Adversary"].map(|name| actors.iter().find(|a| a.name == name).unwrap());
            assert_eq!(ego.source, scene.ego().id);
            assert_eq!(first_contact(ego, adversary), expected, "{}", scene.id);
            contacts += usize::from(expected.is_some());
        }
    }
    println!("{contacts} contacts");
    assert!(contacts >= 20, "{contacts}");
}

#[test]
fn variants_of_a_scene_share_its_map_and_every_file_has_the_same_bytes_again() {
    for scene in built_in() {
        let provenance = Provenance::default().with("source", "a.pkl").with("seed", "7");
        let files = |scene: &Scene| {
            let export = Export::new(scene, Options::default());
            (export.network().clone(), export.scenario(scene, &provenance))
        };
        let (network, scenario) = files(&scene);
        assert_eq!(files(&scene.clone()), (network.clone(), scenario), "{}", scene.id);
        let mut variant = scene.clone();
        variant.id = "variant".to_owned();
        if let Some(adversary) = variant.adversary {
            variant.tracks[adversary].position.iter_mut().for_each(|place| place[0] += 1.0);
        }
        assert_eq!(files(&variant).0, network, "{}", scene.id);
    }
    // What changes the map changes its name: the origin, the lights and the lanes.
    let scene = generate(Kind::FourWay, 11, 3).unwrap();
    let name = |scene: &Scene| Export::new(scene, Options::default()).network().name.clone();
    let mut others = vec![name(&scene)];
    let mut moved = scene.clone();
    moved.tracks[moved.ego].position.iter_mut().for_each(|place| place[1] += 5.0);
    others.push(name(&moved));
    let mut dark = scene.clone();
    dark.lights.clear();
    others.push(name(&dark));
    let mut wider = scene.clone();
    let map = Arc::make_mut(&mut wider.map);
    map.features.iter_mut().filter_map(|f| f.lane.as_mut()).for_each(|lane| lane.width = vec![[2.5, 2.5]]);
    others.push(name(&wider));
    assert_eq!(others.iter().collect::<BTreeSet<_>>().len(), 4, "{others:?}");
}

#[test]
fn the_ego_and_the_adversary_have_their_names_and_provenance_is_in_the_file() {
    let scene = generate(Kind::Merge, 11, 3).unwrap();
    let license = License::of_dataset("waymo");
    for standard in Standard::ALL {
        let options = Options { standard, ego: EgoMode::Replay, license: license.clone() };
        let provenance = Provenance::default().with("method", "sage").with("origin", "not this");
        let export = Export::new(&scene, options);
        let root = parsed(&export.scenario(&scene, &provenance));
        let ego =
            root.child("Entities").unwrap().all("ScenarioObject").find(|o| o.at("name") == "Ego").unwrap();
        let mut holders = vec![ego.children[0].child("Properties").unwrap()];
        let header = root.child("FileHeader").unwrap();
        holders.extend(header.child("Properties"));
        let origin = export.network().origin;
        let expected = format!("{} {} {}", origin[0], origin[1], origin[2]);
        for holder in holders {
            let value =
                |name: &str| holder.all("Property").find(|p| p.at("name") == name).unwrap().at("value");
            assert_eq!((value("sage:method"), value("sage:origin")), ("sage", expected.as_str()));
            assert!(value("sage:license").contains("waymo.com/open"));
        }
        assert!(header.at("description").contains(&expected));
        let stated = header.child("License").map(|license| license.text.as_str());
        assert_eq!(stated, (standard > Standard::V1_0).then_some(license.as_ref().unwrap().notice.as_str()));
        assert!(export.network().xml.contains("waymo.com/open"));
    }
}

#[test]
fn a_controlled_ego_has_a_start_a_route_and_a_controller() {
    for scene in built_in() {
        for standard in Standard::ALL {
            let text = Export::new(&scene, options(standard, EgoMode::Controller))
                .scenario(&scene, &Provenance::default());
            let root = parsed(&text);
            let count = |tag: &str| root.walk().iter().filter(|element| element.tag == tag).count();
            let counts = ["ObjectController", "AssignRouteAction", "ActivateControllerAction"].map(count);
            assert_eq!(counts, [1; 3], "{}", scene.id);
            assert_eq!(count("Waypoint"), 2);
            let actors = play(&root);
            let ego = actors.iter().find(|actor| actor.name == "Ego").unwrap();
            let first = scene.ego().valid.iter().position(|valid| *valid).unwrap();
            let start = ego.states[first].unwrap();
            assert!(ego.states.iter().enumerate().all(|(f, state)| *state == (f >= first).then_some(start)));
        }
    }
}

#[test]
fn files_are_small() {
    let scenes = [procedural(), val()].concat();
    for scene in &scenes {
        let export = Export::new(scene, Options::default());
        let sizes = [export.scenario(scene, &Provenance::default()).len(), export.network().xml.len()];
        // A scenario of 250 road users has 2 MB; none is below 1 MB for its first vertices.
        let users = scene.tracks.len().max(125) as f64;
        assert!(sizes[0] as f64 <= 2e6 * users / 250.0 && sizes[1] < 4_000_000, "{}: {sizes:?}", scene.id);
    }
}

#[test]
fn asams_checkers_find_no_issue() {
    let Some(python) = std::env::var_os("SAGE_ASAM_PYTHON").map(PathBuf::from) else {
        // Written past the test runner, which captures the output of passing tests.
        let _ =
            writeln!(std::io::stderr(), "left out: `SAGE_ASAM_PYTHON` names no Python with ASAM's checkers");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut scenes = built_in();
    scenes.extend(val().into_iter().step_by(12));
    for (number, scene) in scenes.iter().enumerate() {
        for options in every_option() {
            let name = format!("{number}-{}-{}.xosc", options.standard, options.ego);
            let export = Export::new(scene, Options { license: Some(License::waymo()), ..options });
            std::fs::write(folder.path().join(name), export.scenario(scene, &Provenance::default())).unwrap();
            std::fs::write(folder.path().join(export.network().file_name()), &export.network().xml).unwrap();
        }
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/standards/check.py");
    let check = |arguments: &[&Path]| Command::new(&python).arg(&script).args(arguments).output().unwrap();
    let found = check(&[folder.path()]);
    let report = String::from_utf8_lossy(&found.stdout).into_owned();
    assert!(found.status.success(), "{report}{}", String::from_utf8_lossy(&found.stderr));
    println!("{report}");
    // The script sees injected faults.
    let sound = std::fs::read_to_string(folder.path().join("1-1.2-replay.xosc")).unwrap();
    let changed = folder.path().join("changed.xosc");
    std::fs::write(&changed, sound.replacen("entityRef=\"Ego\"", "entityRef=\"Egon\"", 1)).unwrap();
    assert_eq!(check(&[&changed]).status.code(), Some(1));
    std::fs::write(&changed, sound.replacen("<CatalogLocations/>", "", 1)).unwrap();
    assert_eq!(check(&[Path::new("--schema-only"), &changed]).status.code(), Some(1));
}
