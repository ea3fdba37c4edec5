//! Circumstances of failures: where the adversary comes from, red lights, solid lines and the right of way.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::{
    f64::consts::{FRAC_PI_2, PI},
    sync::Arc,
};

use hand_made::{FRAMES, car, scene};
use sage_core::{
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions},
    scene::{LightState, Map, MapFeature, MapKind, SceneIndex, Track, TrafficLight},
};
use sage_sim::{
    fault::FaultClass,
    search::{
        Circumstances, Met,
        circumstances::{Origin, Party},
    },
};

fn feature(map: &mut Map, id: &str, kind: MapKind, [from, to]: [[f64; 2]; 2]) {
    let start = map.points.len();
    let at = |share: f64| [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1]), 0.0];
    map.points.extend((0..=40).map(|k| at(f64::from(k) / 40.0)));
    map.features.push(MapFeature {
        id: id.to_owned(),
        kind,
        points: start..map.points.len(),
        lane: Some(Box::default()),
    });
}

/// Lanes along x in both directions with a solid line between them, and one that crosses them at x = 60.
fn junction() -> Map {
    let mut map = Map::default();
    let lane = MapKind::LaneSurfaceStreet;
    feature(&mut map, "east", lane.clone(), [[-100.0, 0.0], [200.0, 0.0]]);
    feature(&mut map, "west", lane.clone(), [[200.0, 3.5], [-100.0, 3.5]]);
    feature(&mut map, "north", lane, [[60.0, -100.0], [60.0, 100.0]]);
    let line = MapKind::Line("ROAD_LINE_SOLID_DOUBLE_YELLOW".to_owned());
    feature(&mut map, "line", line, [[-100.0, 1.75], [50.0, 1.75]]);
    map
}

/// Circumstances of the contact at the last step before the cars part: the ego drives east at 10 m/s and is at x = 60 at
/// step 50.
fn of(adversary: Track, step: i64, red: Option<&str>) -> Circumstances {
    let ego = car("ego", [0.0, 0.0], 0.0, 10.0);
    let plan = (NOW + 1..FRAMES).map(|frame| adversary.point(frame)).collect();
    let mut scene = scene(junction(), vec![ego, adversary]);
    if let Some(lane) = red {
        let stop_point = Some(if lane == "east" { [50.0, 0.0, 0.0] } else { [60.0, -10.0, 0.0] });
        let states = vec![LightState::Stop; FRAMES];
        scene.lights = vec![TrafficLight { lane: lane.to_owned(), stop_point, states }];
    }
    let index = SceneIndex::new(scene.map.clone());
    let ctx = Context::new(&Arc::new(scene), &index, &ContextOptions::default()).unwrap();
    let plan = ctx.candidate(Trajectory::new("plan", plan).unwrap());
    assert_eq!(plan.points().len(), HORIZON);
    let met = Met {
        step,
        track: "adversary".to_owned(),
        is_adversary: true,
        overlap: 1.0,
        impact_speed: 5.0,
        class: FaultClass::ActiveFront,
    };
    Circumstances::of(&ctx, &plan, &met).unwrap()
}

#[test]
fn a_car_from_a_side_road_has_the_right_of_way_if_the_ego_runs_over_red() {
    // At the crossing at step 50.
    let side = || car("other", [60.0, -36.0], FRAC_PI_2, 6.0);
    let found = of(side(), 50, None);
    assert_eq!(found.adversary_from, Origin::SideRoad);
    assert_eq!((found.adversary_over_red, found.ego_over_red), (None, None));
    assert_eq!(found.right_of_way, None, "a crossing without lights");
    assert_eq!(found.crosses_solid_line, Some(false), "the line ends before the crossing");
    let found = of(side(), 50, Some("east"));
    assert_eq!((found.adversary_over_red, found.ego_over_red), (None, Some(true)));
    assert_eq!(found.right_of_way, Some(Party::Adversary));
    let found = of(side(), 50, Some("north"));
    assert_eq!((found.adversary_over_red, found.ego_over_red), (Some(true), None));
    assert_eq!(found.right_of_way, Some(Party::Ego));
    assert_eq!(found.violation(), "runs over red");
}

#[test]
fn an_oncoming_car_on_the_side_of_the_ego_has_crossed_the_line() {
    // West at 5 m/s, in its lane up to step 30, then over the line.
    let mut other = car("other", [70.0, 3.5], PI, 5.0);
    for frame in NOW + 31..FRAMES {
        other.position[frame][1] = (3.5 - 0.2 * (frame - NOW - 30) as f64).max(0.0);
    }
    let found = of(other, 46, None);
    assert_eq!(found.adversary_from, Origin::OppositeDirection);
    assert_eq!(found.crosses_solid_line, Some(true));
    assert_eq!(found.right_of_way, Some(Party::Ego));
    assert_eq!(found.violation(), "crosses a solid line");
}

#[test]
fn the_car_ahead_has_the_right_of_way() {
    let found = of(car("other", [50.0, 0.0], 0.0, 2.0), 46, None);
    assert_eq!((found.adversary_from, found.right_of_way), (Origin::SameDirection, Some(Party::Adversary)));
    assert_eq!(found.violation(), "neither");
}

#[test]
fn a_car_from_beside_the_road_gives_way() {
    // It comes from a yard at x = 30, where no lane leads.
    let found = of(car("other", [30.0, -16.0], FRAC_PI_2, 8.0), 20, None);
    assert_eq!((found.adversary_from, found.right_of_way), (Origin::OffLanes, Some(Party::Ego)));
}
