//! Single values of the files: widths, marks, limits and signals of a road; kinds, sizes and speeds of road
//! users; states of lights.

use std::{collections::BTreeMap, sync::Arc};

use sage_core::scene::{Boundary, LightState, MapFeature, MapKind, Scene, TrafficLight};
use sage_data::openscenario::{Export, Options, Provenance};

use super::{
    map::{Network, gap},
    play::play,
    scenes::{lanes, scene, track},
    xml::Element,
};
use crate::{built_in, parsed, val, written};

/// A lane of 50 m along +x with another one behind, lines on both sides, and a light.
fn furnished() -> Scene {
    let mut map = lanes(&[
        ("a", &[[0.0, 0.0], [25.0, 0.0], [50.0, 0.0]], &[1]),
        ("b", &[[50.0, 0.0], [90.0, 0.0]], &[]),
    ]);
    for (id, kind) in [("line", "ROAD_LINE_SOLID_DOUBLE_YELLOW"), ("edge", "ROAD_EDGE_BOUNDARY")] {
        let kind = MapKind::from_name(kind);
        map.features.push(MapFeature { id: id.to_owned(), kind, points: 0..2, lane: None });
    }
    let lane = map.features[0].lane.as_mut().unwrap();
    lane.width = vec![[1.5, 2.0], [1.7, 2.2], [0.0, 40.0]];
    lane.boundaries = [
        vec![Boundary { feature: 3, own: [0, 0] }, Boundary { feature: 2, own: [0, 2] }],
        vec![Boundary { feature: 3, own: [0, 2] }],
    ];
    map.features[1].lane.as_mut().unwrap().width = vec![[2.0, 2.5]];
    let mut scene = scene("furnished", vec![], map);
    let stop = [1234.5 + 30.0, -4321.9 + 0.4, 0.0];
    let states = vec![LightState::Stop; scene.frames];
    scene.lights = vec![TrafficLight { lane: "a".to_owned(), stop_point: Some(stop), states }];
    scene
}

#[test]
fn a_road_has_the_widths_marks_limit_and_light_of_its_lane() {
    let (_, root, network) = written(&furnished());
    let road = &network.roads["1"];
    // 1.6 m to the left and 2.1 m to the right at the start; at the joint the means with the next lane.
    assert!((road.offset[0] - 1.6).abs() < 1e-9 && (road.width[0] - 3.7).abs() < 1e-9);
    let ([left, right], [x, y]) = (road.borders(true), road.line().last().copied().unwrap());
    assert!(gap(left, [x, y + 1.8]) < 1e-6 && gap(right, [x, y - 2.3]) < 1e-6, "{left:?} {right:?}");
    let element = root.all("road").next().unwrap();
    let speed = element.find(&["type", "speed"]).unwrap();
    assert_eq!((speed.at("max"), speed.at("unit")), ("40.2336", "km/h"));
    let section = element.find(&["lanes", "laneSection"]).unwrap();
    let mark = |side: &str| {
        let mark = section.find(&[side, "lane", "roadMark"]).unwrap();
        [mark.at("type").to_owned(), mark.at("color").to_owned()]
    };
    assert_eq!(mark("center"), ["solid solid", "yellow"]);
    assert_eq!(mark("right"), ["curb", "standard"]);
    let signal = element.find(&["signals", "signal"]).unwrap();
    assert!((signal.number("s") - 30.0).abs() < 1e-6 && (signal.number("t") + 2.6).abs() < 1e-6);
    assert_eq!([signal.at("id"), signal.at("type"), signal.at("dynamic")], ["1", "1000001", "yes"]);
}

/// The body of a road user in the file.
fn body<'e>(root: &'e Element, name: &str) -> &'e Element {
    let mut objects = root.child("Entities").unwrap().all("ScenarioObject");
    &objects.find(|object| object.at("name") == name).unwrap().children[0]
}

#[test]
fn road_users_have_their_kind_size_and_first_speed() {
    let mut truck = track("5", "VEHICLE", 8.0, 6.0, |_| true);
    truck.size.iter_mut().enumerate().for_each(|(f, size)| *size = [9.0 + 0.01 * f as f64, 2.5, 3.0]);
    let mut parked = track("6", "VEHICLE", 12.0, 0.0, |_| true);
    parked.heading = vec![0.5; parked.heading.len()];
    parked.position = vec![parked.position[0]; parked.position.len()];
    parked.velocity = vec![[0.05, 0.0]; parked.velocity.len()];
    let tracks = vec![
        truck,
        parked,
        track("7", "CYCLIST", 16.0, 4.0, |_| true),
        track("8", "PEDESTRIAN", 20.0, 1.0, |_| true),
        track("9", "TRAFFIC_CONE", 24.0, 0.0, |_| true),
        track("10", "TRAFFIC_BARRIER", 28.0, 0.0, |_| true),
        track("11", "VEHICLE", 32.0, 5.0, |_| true),
    ];
    let mut scene = scene("kinds", tracks, lanes(&[]));
    scene.adversary = Some(7);
    // The sizes of the ego and the adversary are those at *now*, frame 10.
    for track in [0, 7] {
        scene.tracks[track].size[10] = [4.25, 1.75, 1.25];
    }
    let root = parsed(&Export::new(&scene, Options::default()).scenario(&scene, &Provenance::default()));
    let kinds = [
        ("Ego", "Vehicle", "vehicleCategory", "car", [4.25, 1.75, 1.25]),
        ("Adversary", "Vehicle", "vehicleCategory", "car", [4.25, 1.75, 1.25]),
        ("Vehicle_5", "Vehicle", "vehicleCategory", "truck", [9.45, 2.5, 3.0]),
        ("Vehicle_6", "Vehicle", "vehicleCategory", "car", [4.5, 2.0, 1.5]),
        ("Cyclist_7", "Vehicle", "vehicleCategory", "bicycle", [4.5, 2.0, 1.5]),
        ("Pedestrian_8", "Pedestrian", "pedestrianCategory", "pedestrian", [4.5, 2.0, 1.5]),
        ("Traffic_cone_9", "MiscObject", "miscObjectCategory", "obstacle", [4.5, 2.0, 1.5]),
        ("Traffic_barrier_10", "MiscObject", "miscObjectCategory", "barrier", [4.5, 2.0, 1.5]),
    ];
    for (name, tag, category, kind, size) in kinds {
        let body = body(&root, name);
        assert_eq!((body.tag.as_str(), body.at(category)), (tag, kind), "{name}");
        let dimensions = body.find(&["BoundingBox", "Dimensions"]).unwrap();
        assert_eq!(["length", "width", "height"].map(|side| dimensions.number(side)), size, "{name}");
        assert_eq!(body.find(&["BoundingBox", "Center"]).unwrap().number("z"), 0.5 * size[2]);
    }
    let properties = body(&root, "Vehicle_5").child("Properties").unwrap();
    let range = properties.all("Property").find(|p| p.at("name") == "sage:size_range").unwrap();
    assert_eq!(range.at("value"), "9..9.9 2.5..2.5 3..3");
    let actions = root.find(&["Storyboard", "Init", "Actions"]).unwrap();
    let speed = |name: &str| {
        let private = actions.all("Private").find(|p| p.at("entityRef") == name).unwrap();
        let targets = private.walk().into_iter().filter(|e| e.tag == "AbsoluteTargetSpeed");
        targets.map(|target| target.number("value")).collect::<Vec<_>>()
    };
    assert_eq!((speed("Ego"), speed("Cyclist_7"), speed("Vehicle_6")), (vec![8.0], vec![4.0], vec![0.0]));
    // Who stands has no trajectory.
    let has_group = |name: &str| root.walk().iter().any(|e| e.get("name") == Some(&format!("of {name}")));
    assert!(has_group("Vehicle_5") && !has_group("Vehicle_6"));
}

#[test]
fn a_road_user_of_which_only_the_height_varies_has_no_trajectory() {
    let mut still = track("1", "VEHICLE", 4.0, 0.0, |_| true);
    still.heading = vec![0.5; still.heading.len()];
    still.position.iter_mut().enumerate().for_each(|(f, place)| place[2] = 10.0 + 0.09 * (f % 2) as f64);
    let mut lifted = still.clone();
    lifted.id = "2".to_owned();
    lifted.position[50][2] += 0.5;
    let scene = scene("heights", vec![still, lifted], lanes(&[]));
    let root = parsed(&Export::new(&scene, Options::default()).scenario(&scene, &Provenance::default()));
    let names: Vec<&str> =
        root.walk().into_iter().filter(|e| e.tag == "Trajectory").map(|e| e.at("name")).collect();
    assert_eq!(names, ["Ego 0", "Vehicle_2 0"]);
    assert_eq!(play(&root).len(), 3);
}

/// Lamps of each signal at each frame, from the file.
fn lamps(root: &Element, frames: usize) -> BTreeMap<String, Vec<String>> {
    let board = root.child("Storyboard").unwrap();
    let mut shown: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut set = |element: &Element, from: usize| {
        for action in element.walk().into_iter().filter(|e| e.tag == "TrafficSignalStateAction") {
            let states = shown.entry(action.at("name").to_owned()).or_insert(vec![String::new(); frames]);
            states[from..].fill(action.at("state").to_owned());
        }
    };
    set(board.child("Init").unwrap(), 0);
    let groups = board.find(&["Story", "Act"]).unwrap().all("ManeuverGroup");
    for event in groups.filter_map(|group| group.child("Maneuver")).flat_map(|maneuver| maneuver.all("Event"))
    {
        let condition = event.walk().into_iter().find(|e| e.tag == "SimulationTimeCondition").unwrap();
        set(event, (10.0 * condition.number("value")).ceil() as usize);
    }
    shown
}

#[test]
fn lights_show_their_recorded_state_at_every_frame() {
    let mut compared = 0;
    for scene in built_in().iter().chain(&val()) {
        let export = Export::new(scene, Options::default());
        let network = Network::of(&parsed(&export.network().xml));
        let shown = lamps(&parsed(&export.scenario(scene, &Provenance::default())), scene.frames);
        let lights = scene.lights.iter().zip(&export.network().signals);
        for (light, id) in lights.filter_map(|(light, id)| Some((light, (*id)?.to_string()))) {
            let (road, _) = &network.signals[&id];
            assert_eq!(network.roads[road].name, light.lane, "{}", scene.id);
            for (state, lamps) in light.states.iter().zip(&shown[&id]) {
                let expected = match state {
                    LightState::Stop | LightState::FlashingStop => "on;off;off",
                    LightState::Caution => "off;on;off",
                    LightState::Go => "off;off;on",
                    LightState::Unknown => "off;off;off",
                };
                assert_eq!(lamps, expected, "{} light {id}", scene.id);
                compared += 1;
            }
        }
        assert_eq!(shown.len(), export.network().signals.iter().flatten().count());
    }
    assert!(compared > 500);
}

#[test]
fn the_map_of_a_scene_without_lanes_says_so() {
    let mut scene = furnished();
    scene.map = Arc::default();
    let export = Export::new(&scene, Options::default());
    let notes: Vec<&str> = export.notes().collect();
    assert!(notes.iter().any(|note| note.contains("no lane")), "{notes:?}");
    assert!(notes.iter().any(|note| note.contains("light of lane `a`")), "{notes:?}");
    assert_eq!(export.network().signals, [None]);
}
