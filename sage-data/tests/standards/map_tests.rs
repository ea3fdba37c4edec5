//! Maps hold every lane and link of their scene, and follow the rules of road networks.

use std::collections::{BTreeMap, BTreeSet};

use sage_data::openscenario::{Export, Options};

use super::{
    map::{gap, reachable},
    rules,
};
use crate::{built_in, examples, procedural, val, written};

/// Length of a lane's polyline in the plane.
fn length(points: &[[f64; 3]]) -> f64 {
    points.windows(2).map(|pair| gap([pair[0][0], pair[0][1]], [pair[1][0], pair[1][1]])).sum()
}

#[test]
fn maps_follow_the_rules_of_road_networks() {
    for scene in built_in().iter().chain(&val()) {
        let (_, root, network) = written(scene);
        let wrong = rules::map(&root, &network);
        assert!(wrong.is_empty(), "{}: {wrong:?}", scene.id);
    }
}

#[test]
fn every_lane_is_a_road_and_every_link_is_there_or_in_the_notes() {
    for scene in built_in().iter().chain(&val()) {
        let (export, _, network) = written(scene);
        let notes: Vec<&str> = export.notes().collect();
        let roads: BTreeSet<&str> = network
            .roads
            .values()
            .filter(|road| road.junction.is_none())
            .map(|road| road.name.as_str())
            .collect();
        let clean = |id: &str| id.replace(['\u{1}', '\u{2}', '\u{ffff}'], "\u{fffd}");
        let features = &scene.map.features;
        let lanes: Vec<usize> = (0..features.len()).filter(|k| features[*k].kind.is_lane()).collect();
        for &k in &lanes {
            let length = length(scene.map.points_of(&features[k]));
            let is_road = roads.contains(clean(&features[k].id).as_str());
            let is_noted =
                notes.contains(&format!("lane `{}`: left out, shorter than 0.2 m", features[k].id).as_str());
            assert_ne!(is_road, is_noted, "{}: lane {}", scene.id, features[k].id);
            assert!(is_road || length < 0.201, "{}: lane {} of {length} m", scene.id, features[k].id);
            assert!(is_noted || length > 0.199, "{}: lane {} of {length} m", scene.id, features[k].id);
        }
        let mut expected = BTreeSet::new();
        for &a in &lanes {
            for b in &features[a].lane.as_ref().unwrap().exits {
                let Some(b) = features.get(*b).filter(|b| b.kind.is_lane()) else { continue };
                let link = format!("link from lane `{}` to lane `{}`: left out", features[a].id, b.id);
                let [from, to] = [&features[a].id, &b.id].map(|id| clean(id));
                let is_left_out = notes.iter().any(|note| note.starts_with(&link));
                if !is_left_out && roads.contains(from.as_str()) && roads.contains(to.as_str()) {
                    expected.insert((from, to));
                }
            }
        }
        let links = network.links();
        assert_eq!(links, expected, "{}", scene.id);
        // From the ego's lane the same lanes are within reach.
        let ego = scene.ego();
        let place = ego.point(ego.valid.iter().position(|valid| *valid).unwrap());
        let away = |k: &usize| {
            let points = scene.map.points_of(&features[*k]).iter();
            points.map(|p| gap([p[0], p[1]], place)).fold(f64::INFINITY, f64::min)
        };
        let nearest = lanes.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
        if let Some(&lane) = nearest {
            let from = clean(&features[lane].id);
            assert_eq!(reachable(&from, &links), reachable(&from, &expected), "{}", scene.id);
        }
    }
}

#[test]
fn links_over_gaps_are_the_only_ones_left_out_of_recorded_maps() {
    for scene in examples().iter().chain(&procedural()).chain(&val()) {
        let export = Export::new(scene, Options::default());
        for note in export.notes().filter(|note| note.starts_with("link")) {
            let gap: f64 = note
                .split(" left out, ")
                .nth(1)
                .and_then(|rest| rest.split(' ').next())
                .unwrap()
                .parse()
                .unwrap();
            assert!(gap > 0.5, "{}: {note}", scene.id);
        }
    }
}

#[test]
fn roads_run_along_the_recorded_lanes() {
    let mut worst = 0.0f64;
    for scene in examples().iter().chain(&procedural()).chain(&val()) {
        let (export, _, network) = written(scene);
        let origin = export.network().origin;
        // The lines of each lane: its road and the connecting roads that lead to it.
        let mut lines: BTreeMap<&str, Vec<[f64; 2]>> = BTreeMap::new();
        for road in network.roads.values() {
            let lane = match &road.junction {
                Some(_) => &network.roads[&road.successor.as_ref().unwrap().id],
                None => road,
            };
            lines.entry(&lane.name).or_default().extend(road.line());
        }
        for feature in scene.map.features.iter().filter(|feature| feature.kind.is_lane()) {
            let Some(line) = lines.get(feature.id.as_str()) else { continue };
            // Every fifth point: the search is slow and the points are close.
            for point in scene.map.points_of(feature).iter().step_by(5) {
                let place = [point[0] - origin[0], point[1] - origin[1]];
                let off = line.iter().map(|on| gap(*on, place)).fold(f64::INFINITY, f64::min);
                worst = worst.max(off);
                assert!(off < 0.1, "{}: lane {} is {off} m off at {place:?}", scene.id, feature.id);
            }
        }
    }
    println!("worst distance of a recorded point from its road {worst} m");
}
