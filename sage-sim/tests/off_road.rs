//! When a car is off the road: edges, sidewalks, what it touches at the start, maps that do not say.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

mod driving;
mod hand_made;
mod reference;

use std::sync::Arc;

use driving::simulation;
use hand_made::{FRAMES, car, prepared, road, scene};
use sage_core::scene::{Map, MapFeature, MapKind, Track};
use sage_sim::{
    drive::{OffRoad, drive},
    environment::{Environment, EnvironmentOptions},
    vehicle::Action,
    world::WorldOptions,
};

/// The road with edges: kind and points of each.
fn with_edges(edges: &[(&str, &[[f64; 2]])]) -> Map {
    let mut map = road();
    for (k, (kind, line)) in edges.iter().enumerate() {
        let start = map.points.len();
        map.points.extend(line.iter().map(|[x, y]| [*x, *y, 0.0]));
        let points = start..map.points.len();
        map.features.push(MapFeature {
            id: format!("edge {k}"),
            kind: MapKind::from_name(kind),
            points,
            lane: None,
        });
    }
    map
}

/// A recording along x at 5 m/s from x = 0, at an offset from the lane by time.
fn weaving(offset: impl Fn(f64) -> f64) -> Track {
    let mut track = car("ego", [0.0, 0.0], 0.0, 5.0);
    for frame in 0..FRAMES {
        track.position[frame][1] = offset(0.1 * frame as f64);
    }
    track
}

/// When the replayed recording is off the road.
fn off_road(map: Map, track: Track) -> OffRoad {
    let scene = prepared(scene(map, vec![track]));
    drive(&mut simulation(&scene, "replay", WorldOptions::default())).unwrap().off_road
}

const EDGE: &str = "ROAD_EDGE_BOUNDARY";
const SIDEWALK: &str = "ROAD_EDGE_SIDEWALK";
const LONG: [[f64; 2]; 2] = [[-100.0, -3.0], [300.0, -3.0]];
/// The same edge in two parts, which meet at x = 20.
const PARTS: [[[f64; 2]; 2]; 2] = [[[-100.0, -3.0], [20.0, -3.0]], [[20.0, -3.0], [300.0, -3.0]]];
const OTHER: [[f64; 2]; 2] = [[30.0, -3.4], [250.0, -3.4]];
const WALK: [[f64; 2]; 5] = [[-100.0, -3.0], [300.0, -3.0], [300.0, -13.0], [-100.0, -13.0], [-100.0, -3.0]];
const NEXT_WALK: [[f64; 2]; 5] = [[20.0, -3.0], [300.0, -3.0], [300.0, -13.0], [20.0, -13.0], [20.0, -3.0]];
const FIRST_WALK: [[f64; 2]; 5] =
    [[-100.0, -3.0], [20.0, -3.0], [20.0, -13.0], [-100.0, -13.0], [-100.0, -3.0]];

#[test]
fn what_is_touched_at_the_start_does_not_count_until_left() {
    // The car is 2 m wide and touches the edge at −3 m within 0.1 m of its side: offsets from −1.9 to −4.1 m.
    let middle = |_: f64| 0.0;
    let over = |_: f64| -2.5;
    let leaves_it = |t: f64| (-2.5 + 0.5 * t).min(0.0);
    let returns = |t: f64| if t < 5.0 { leaves_it(t) } else { -0.8 * (t - 5.0) };
    let drifts = |t: f64| -0.5 * t - 0.01;
    let on_walk = |_: f64| -8.0;
    type Offset<'a> = &'a dyn Fn(f64) -> f64;
    /// Name, features of the map, offset of the ego, and what must come of it.
    type Case<'c> = (&'c str, &'c [(&'c str, &'c [[f64; 2]])], Offset<'c>, OffRoad);
    let cases: [Case; 20] = [
        ("in the middle", &[(EDGE, &LONG)], &middle, OffRoad::Never),
        ("over it all the time", &[(EDGE, &LONG)], &over, OffRoad::Never),
        ("leaves it", &[(EDGE, &LONG)], &leaves_it, OffRoad::Never),
        ("comes back", &[(EDGE, &LONG)], &returns, OffRoad::At(74)),
        ("drifts over it", &[(EDGE, &LONG)], &drifts, OffRoad::At(38)),
        ("over an edge in two parts", &[(EDGE, &PARTS[0]), (EDGE, &PARTS[1])], &over, OffRoad::Never),
        ("over an edge, then another", &[(EDGE, &LONG), (EDGE, &OTHER)], &over, OffRoad::At(56)),
        ("a median", &[("ROAD_EDGE_MEDIAN", &LONG)], &drifts, OffRoad::At(38)),
        ("over a median", &[("ROAD_EDGE_MEDIAN", &LONG)], &over, OffRoad::Never),
        ("an unknown edge", &[("ROAD_EDGE_UNKNOWN", &LONG)], &drifts, OffRoad::At(38)),
        ("a guard rail", &[("GUARDRAIL", &WALK)], &drifts, OffRoad::At(38)),
        ("beside a sidewalk", &[(SIDEWALK, &WALK)], &middle, OffRoad::Never),
        ("onto a sidewalk", &[(SIDEWALK, &WALK)], &drifts, OffRoad::At(38)),
        ("over its outline", &[(SIDEWALK, &WALK)], &over, OffRoad::Never),
        ("wholly on a sidewalk", &[(SIDEWALK, &WALK)], &on_walk, OffRoad::Never),
        (
            "on sidewalks in a row",
            &[(SIDEWALK, &FIRST_WALK), (SIDEWALK, &NEXT_WALK)],
            &on_walk,
            OffRoad::Never,
        ),
        ("no edge", &[], &drifts, OffRoad::NotMeasured),
        ("a line", &[("ROAD_LINE_SOLID_SINGLE_WHITE", &LONG)], &drifts, OffRoad::NotMeasured),
        ("an edge of one point", &[(EDGE, &LONG[..1])], &drifts, OffRoad::NotMeasured),
        ("far from the only edge", &[(EDGE, &[[-90.0, 60.0], [90.0, 60.0]])], &middle, OffRoad::Never),
    ];
    for (name, edges, offset, expected) in cases {
        assert_eq!(off_road(with_edges(edges), weaving(offset)), expected, "{name}");
    }
}

#[test]
fn a_jump_onto_a_sidewalk_is_off_the_road_though_no_outline_is_touched() {
    let jump = |t: f64| if t < 3.05 { 0.0 } else { -8.0 };
    assert_eq!(off_road(with_edges(&[(SIDEWALK, &WALK)]), weaving(jump)), OffRoad::At(31));
    // Who starts on one and jumps to another that does not continue it is off the road.
    let far: Vec<[f64; 2]> = WALK.iter().map(|[x, y]| [*x, y + 30.0]).collect();
    let across = |t: f64| if t < 3.05 { -8.0 } else { 22.0 };
    assert_eq!(
        off_road(with_edges(&[(SIDEWALK, &WALK), (SIDEWALK, &far)]), weaving(across)),
        OffRoad::At(31)
    );
}

#[test]
fn an_episode_that_starts_on_an_edge_goes_on() {
    let scene = prepared(scene(with_edges(&[(EDGE, &LONG)]), vec![weaving(|_| -2.5)]));
    let first = |options: EnvironmentOptions| {
        let mut environment = Environment::reset(scene.clone(), Arc::new(options), None, 0).unwrap();
        environment.step(Action { steer: 0.0, throttle: 0.0 }).unwrap()
    };
    let outcome = first(EnvironmentOptions::default());
    assert!(!outcome.out_of_road && !outcome.terminated && outcome.cost == 0.0);
    let as_in_metadrive = EnvironmentOptions { start_edge_ends: true, ..EnvironmentOptions::default() };
    assert!(first(as_in_metadrive).out_of_road);
}

#[test]
fn a_restored_world_remembers_what_it_is_leaving() {
    let scene = prepared(scene(with_edges(&[(EDGE, &LONG)]), vec![weaving(|_| -2.5)]));
    let mut simulation = simulation(&scene, "replay", WorldOptions::default());
    let state = simulation.world().state().clone();
    for _ in 0..3 {
        simulation.step().unwrap();
        assert!(simulation.world().events().on_edge && !simulation.world().events().off_road);
    }
    let mut world = simulation.world().clone();
    world.restore(&state).unwrap();
    assert_eq!(world.state(), &state);
}
