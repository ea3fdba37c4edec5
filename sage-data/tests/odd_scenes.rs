//! What the reader makes of odd files: one test for each kind, whose values are those of public reports.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

#[path = "odd_scenes/mod.rs"]
mod odd;

use std::path::Path;

use odd::{OddScene, PARAMETERS};
use sage_core::{
    geometry::distance,
    motion::NOW,
    scene::{AdversaryOrigin, LightState, Scene, SceneIndex, Track},
    seed::Rng,
};
use sage_data::{ReadOptions, Recording, checks::warnings, opendrive::RoadNetwork};

fn read_as(scene: &OddScene, options: &ReadOptions) -> Result<Recording, sage_data::Error> {
    let path = format!("odd.{}", scene.ending());
    let options = ReadOptions { now: scene.now(), rate: options.rate.or(scene.rate()), ..options.clone() };
    Recording::from_bytes_as(Path::new(&path), scene.bytes(), &options)
}

fn read(scene: &OddScene) -> Scene {
    read_as(scene, &ReadOptions::default())
        .unwrap_or_else(|error| panic!("{}: {error}", scene.describe()))
        .scene
}

fn odd(parameter: &str, value: &str) -> Scene {
    read(&OddScene::plain().with(parameter, value))
}

fn track<'s>(scene: &'s Scene, id: &str) -> &'s Track {
    scene.tracks.iter().find(|track| track.id == id).unwrap_or_else(|| panic!("no `{id}`"))
}

fn kinds(scene: &Scene) -> Vec<&'static str> {
    warnings(scene).iter().map(|warning| warning.kind).collect()
}

fn adversary(scene: &Scene) -> Option<&str> {
    scene.adversary.map(|k| &*scene.tracks[k].id)
}

#[test]
fn every_combination_is_read_and_written_again() {
    for seed in 0..400 {
        let scene = OddScene::draw(&mut Rng::new(seed, "odd", "read"), 0.3);
        let recording = match read_as(&scene, &ReadOptions::default()) {
            Ok(recording) => recording,
            // Twice the frames of 10 Hz are needed at 20 Hz.
            Err(error) => {
                assert!(error.to_string().contains("frames"), "{}: {error}", scene.describe());
                continue;
            }
        };
        warnings(&recording.scene);
        let native = recording.to_native().unwrap();
        let again = Recording::from_bytes(Path::new("odd.safetensors"), native).unwrap().scene;
        assert_eq!(again.tracks, recording.scene.tracks, "{}", scene.describe());
        assert_eq!(again.map, recording.scene.map, "{}", scene.describe());
        assert_eq!(adversary(&again), adversary(&recording.scene), "{}", scene.describe());
    }
}

/// The file is what the parameters say: what each oddity does to the reader is named.
#[test]
fn each_oddity_is_named() {
    assert_eq!(kinds(&read(&OddScene::plain())), Vec::<&str>::new(), "the plain scene is not odd");
    for line in include_str!("odd_scenes/kinds.table").lines().filter(|line| !line.starts_with('#')) {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let (mut scene, mut adversary) = (OddScene::plain(), None);
        for (parameter, value) in cells[0].split_whitespace().filter_map(|part| part.split_once('=')) {
            match parameter {
                "adversary" => adversary = Some(value),
                _ => scene = scene.with(parameter, value),
            }
        }
        let scene = read(&scene).with_roles(None, adversary).unwrap();
        let found = warnings(&scene);
        let kind = cells[1].trim_start_matches('!');
        let detail = found.iter().find(|warning| warning.kind == kind).map(|warning| &warning.detail);
        assert_eq!(detail.is_some(), !cells[1].starts_with('!'), "{line}: {:?}", kinds(&scene));
        assert!(
            cells[2].split(';').all(|word| detail.is_none_or(|detail| detail.contains(word))),
            "{line}: {detail:?}"
        );
    }
}

#[test]
fn each_parameter_has_at_least_five_values() {
    let few: Vec<_> = PARAMETERS.iter().filter(|(_, values)| values.len() < 4).collect();
    assert!(few.is_empty() && PARAMETERS.len() >= 15, "{few:?}");
}

#[test]
fn lights_of_every_notation_are_the_same_lights() {
    let expected = odd("lights", "names").lights;
    assert_eq!((expected.len(), expected[0].states[50]), (1, LightState::Stop));
    for value in ["numbers", "number-list", "texts", "inside-state"] {
        let lights = odd("lights", value).lights;
        assert_eq!(lights[0].states, expected[0].states, "{value}");
        assert_eq!(lights[0].lane, expected[0].lane, "{value}");
        let [a, b] = [&lights, &expected].map(|lights| lights[0].stop_point.unwrap());
        assert!(distance([a[0], a[1]], [b[0], b[1]]) < 1e-4, "{value}: {a:?}");
    }
    for value in ["odd", "odd-length"] {
        let scene = odd("lights", value);
        assert!(scene.lights.is_empty(), "{value}");
        let strict = ReadOptions { strict: true, ..ReadOptions::default() };
        assert!(read_as(&OddScene::plain().with("lights", value), &strict).is_err());
    }
    assert_eq!(odd("lights", "none-states").lights[0].states[0], LightState::Unknown);
}

#[test]
fn a_file_without_times_is_read_at_the_rate_that_is_given() {
    let twenty = OddScene::plain().with("format", "json-20hz");
    assert_eq!(twenty.rate(), Some(20.0));
    let scene = read(&twenty.clone().with("length", "121"));
    let ego = scene.ego();
    assert_eq!(scene.frames, 61);
    assert!((distance(ego.point(20), ego.point(10)) - 10.0).abs() < 1e-6, "10 m/s");
    // Without the rate positions move half as far as the velocities say.
    let plain = Recording::from_bytes(Path::new("odd.json"), twenty.bytes()).unwrap().scene;
    let found = warnings(&plain);
    let warning = found.iter().find(|warning| warning.kind == "times-against-motion").unwrap();
    assert!(warning.detail.contains("--rate 20"), "{}", warning.detail);
    // A file with times needs none.
    let rate = ReadOptions { rate: Some(20.0), ..ReadOptions::default() };
    let error = read_as(&OddScene::plain(), &rate).unwrap_err().to_string();
    assert!(error.contains("--rate"), "{error}");
    assert!(read_as(&OddScene::plain().with("times", "none"), &rate).is_ok());
}

#[test]
fn a_clock_with_two_or_three_values_says_nothing() {
    for value in ["constant", "one-step", "two-steps"] {
        let scene = odd("times", value);
        assert_eq!(scene.frames, 91, "{value}");
        assert_eq!(scene.tracks, read(&OddScene::plain()).tracks, "{value}");
    }
}

#[test]
fn a_size_of_zero_in_json_is_no_size() {
    let json = OddScene::plain().with("format", "json");
    let scene = read(&json.clone().with("sizes", "zero"));
    assert_eq!(scene.tracks.len(), read(&json.clone().with("sizes", "absent")).tracks.len());
    assert_eq!(scene.tracks[1].size[0], read(&json.with("sizes", "absent")).tracks[1].size[0]);
}

#[test]
fn only_vehicles_are_taken_from_the_objects_of_interest() {
    for value in ["pedestrian", "cyclist", "cone"] {
        let scene = odd("named", value);
        assert_eq!(scene.adversary_origin, AdversaryOrigin::Conflict, "{value}");
        assert_eq!(adversary(&scene), adversary(&odd("named", "none")), "{value}");
    }
    assert_eq!(odd("named", "vehicle").adversary_origin, AdversaryOrigin::File);
}

#[test]
fn the_adversary_is_on_the_level_of_the_ego() {
    let plain = adversary(&odd("level", "flat")).map(str::to_owned);
    for value in ["over-6m", "under-6m", "over-4m", "over-now"] {
        let scene = odd("level", value);
        assert_eq!(adversary(&scene), plain.as_deref(), "{value}");
        assert!(!scene.is_in_contact_now(), "{value}");
        // Named by the user it is apart from the ego too.
        let named = scene.with_roles(None, Some("c")).unwrap();
        assert!(!named.is_in_contact_now(), "{value}");
    }
    let scene = odd("level", "same-speed");
    assert!(scene.tracks.iter().any(|track| track.id == "d"), "a car above is no copy of the ego");
    // On a map with one level heights may mean nothing: then it is a copy.
    let mut flat = OddScene::plain().with("level", "same-speed").with("lanes", "none").with("edges", "none");
    flat.seed = 1;
    let deck = read(&flat);
    assert_eq!(
        deck.tracks.iter().any(|track| track.id == "d"),
        SceneIndex::new(deck.map.clone()).has_levels(3.0)
    );
}

#[test]
fn edges_at_heights_that_cannot_be_true_are_left_out() {
    for value in ["at-0-under-35", "4m-above"] {
        let scene = odd("edges", value);
        assert!(!scene.map.has_edges(), "{value}");
        let names: Vec<&str> = scene.map.features.iter().map(|feature| feature.kind.name()).collect();
        assert!(names.contains(&"ROAD_EDGE_BOUNDARY"), "they stay in the map: {names:?}");
    }
    for value in ["boundary", "sidewalk", "guardrail", "median", "open"] {
        assert!(odd("edges", value).map.has_edges(), "{value}");
    }
    for value in ["slope", "over-6m", "over-4m"] {
        assert!(odd("level", value).map.has_edges(), "{value}");
    }
}

#[test]
fn a_road_user_that_stands_is_held_through_its_gaps() {
    for value in ["unseen-3s", "flickers"] {
        let scene = odd("gaps", value);
        let standing = track(&scene, "q");
        assert!(standing.valid[3..88].iter().all(|valid| *valid), "{value}");
        assert_eq!(standing.point(45), standing.point(88), "{value}");
        assert!(!scene.held.is_empty(), "{value}");
        let observed = scene.as_observed();
        assert!(!track(&observed, "q").valid.iter().all(|valid| *valid), "{value}: the file has gaps");
    }
    let moving = odd("gaps", "moving-flickers");
    assert!(moving.held.is_empty() && !track(&moving, "a").valid[13]);
    // The ego is never held: where it is must be measured.
    assert!(odd("gaps", "appears").held.is_empty());
}

#[test]
fn a_gap_before_now_is_cut_with_its_scene() {
    let scene = read(&OddScene::plain().with("gaps", "unseen-3s").with("now", "30"));
    let held: Vec<_> = scene.held.iter().map(|held| [held.frames.start, held.frames.end]).collect();
    assert_eq!(held, [[10, 40]], "frames 30 to 60 of the file");
    let observation =
        sage_core::generator::Observation::of(&scene, &SceneIndex::new(scene.map.clone())).unwrap();
    let seen = &observation.scene().tracks[scene.tracks.iter().position(|t| t.id == "q").unwrap()];
    assert_eq!((seen.is_valid(9), seen.is_valid(NOW)), (true, false), "hidden now, so not seen");
}

#[test]
fn wrong_headings_are_right_by_positions() {
    let trust = ReadOptions { trust_positions: true, ..ReadOptions::default() };
    let scene = read_as(&OddScene::plain().with("heading", "ego-now"), &trust).unwrap().scene;
    assert!(!kinds(&scene).contains(&"heading-against-motion"));
}

#[test]
fn a_standing_car_keeps_one_heading_on_demand() {
    let trust = ReadOptions { trust_positions: true, ..ReadOptions::default() };
    for value in ["spins", "flips"] {
        let scene = OddScene::plain().with("standing", value);
        let mended = read_as(&scene, &trust).unwrap().scene;
        let headings = &track(&mended, "q").heading;
        assert!(headings.iter().all(|heading| *heading == headings[0]), "{value}: {headings:?}");
        assert!(!kinds(&mended).contains(&"turns-while-standing"), "{value}");
    }
    // Most of the frames of the one that flips are right.
    let mended = read_as(&OddScene::plain().with("standing", "flips"), &trust).unwrap().scene;
    assert_eq!(track(&mended, "q").heading[0], 0.0);
}

#[test]
fn a_lane_that_is_left_out_leaves_its_link() {
    for value in ["short-0", "short-0.05", "short-0.15", "short-0.5"] {
        let scene = odd("lanes", value);
        let network = RoadNetwork::of(&scene, [0.0; 3], None);
        let links = network.xml.matches("<successor elementType=\"road\"").count();
        // The short lane of 0.5 m is a road of its own.
        assert_eq!(links, if value == "short-0.5" { 8 } else { 4 }, "{value}: {:?}", network.notes);
    }
}
