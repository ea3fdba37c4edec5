//! The policy `pdm` on the road: what it stops for, what it passes, and what it ignores.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod driving;
mod hand_made;
mod reference;

use std::sync::Arc;

use hand_made::{car, prepared, road, scene};
use insta::assert_snapshot;
use sage_core::scene::{MapFeature, MapKind, Scene, Track};
use sage_sim::{
    episode::{End, Episode},
    policy::policies,
};
use serde_json::{Value, json};

fn drive_scene(scene: Scene, options: &Value) -> Episode {
    let driver = policies().unwrap().build("pdm", options).unwrap();
    Episode::run(&prepared(scene), None, driver.as_ref(), 0).unwrap()
}

fn drive(tracks: Vec<Track>, options: &Value) -> Episode {
    drive_scene(scene(road(), tracks), options)
}

fn ego(speed: f64) -> Track {
    car("ego", [0.0, 0.0], 0.0, speed)
}

fn standing(x: f64, y: f64) -> Track {
    car("standing", [x, y], 0.0, 0.0)
}

/// Positions of the ego relative to its start, after a rotation by minus `angle`.
fn positions(episode: &Episode, angle: f64) -> Vec<[f64; 2]> {
    let (sin, cos) = angle.sin_cos();
    let turned = |[x, y]: [f64; 2]| [x * cos + y * sin, y * cos - x * sin];
    episode.drive.motions.iter().map(|motion| turned(motion.position)).collect()
}

/// The scene turned around the origin.
fn rotated(mut scene: Scene, angle: f64) -> Scene {
    let (sin, cos) = angle.sin_cos();
    let turn = |p: &mut [f64]| (p[0], p[1]) = (p[0] * cos - p[1] * sin, p[0] * sin + p[1] * cos);
    for track in &mut scene.tracks {
        track.position.iter_mut().for_each(|p| turn(p));
        track.velocity.iter_mut().for_each(|v| turn(v));
        track.heading.iter_mut().for_each(|heading| *heading += angle);
    }
    let map = Arc::make_mut(&mut scene.map);
    map.points.iter_mut().for_each(|p| turn(p));
    scene
}

#[test]
fn it_stops_behind_a_standing_car_and_follows_a_slower_one() {
    let stopped = drive(vec![ego(10.0), standing(30.0, 0.0)], &json!({}));
    assert_eq!((stopped.end, stopped.contacts.len()), (End::Horizon, 0));
    let last = stopped.drive.motions.last().unwrap();
    let gap = 30.0 - last.position[0] - 4.5;
    assert!(last.speed() < 0.3 && (0.5..4.0).contains(&gap), "{} {gap}", last.speed());

    let slower = car("slower", [30.0, 0.0], 0.0, 6.0);
    let following = drive(vec![ego(12.0), slower], &json!({}));
    assert_eq!((following.end, following.contacts.len()), (End::Horizon, 0));
    assert!((following.drive.motions.last().unwrap().speed() - 6.0).abs() < 1.0);
}

#[test]
fn a_car_that_is_half_in_the_lane_is_passed_on_the_other_side() {
    for side in [1.0, -1.0] {
        let passing = drive(vec![ego(8.0), standing(40.0, side * 1.4)], &json!({}));
        assert_eq!((passing.end, passing.contacts.len()), (End::Horizon, 0), "{side}");
        let beside = passing.drive.motions.iter().find(|motion| motion.position[0] > 40.0).unwrap();
        assert!(beside.position[1] * side < -0.6, "{side}: {:?}", beside.position);
        let last = passing.drive.motions.last().unwrap();
        assert!(last.position[0] > 60.0 && last.position[1].abs() < 1.2, "{side}: {:?}", last.position);
    }
}

#[test]
fn one_that_comes_from_behind_changes_nothing() {
    let alone = drive(vec![ego(10.0)], &json!({}));
    let follower = car("follower", [-25.0, 0.0], 0.0, 20.0);
    let hit = drive(vec![ego(10.0), follower], &json!({}));
    assert_eq!(hit.end, End::Contact);
    let until = hit.drive.motions.len() - 1;
    assert!(until > 10, "{until}");
    assert_eq!(alone.drive.motions[..until], hit.drive.motions[..until]);
}

#[test]
fn only_its_options_brake_harder_than_the_published_proposals() {
    // From 10 m/s, 3 m/s² need 16.7 m and 8 m/s² need 6.3 m.
    let hits = |options: Value| !drive(vec![ego(10.0), standing(16.0, 0.0)], &options).contacts.is_empty();
    assert!(hits(json!({})));
    assert!(hits(json!({"as_published": true})));
    assert!(!hits(json!({"brake": true})));
    assert!(!hits(json!({"any_speed": true})));
}

#[test]
fn a_curb_close_beside_the_car_does_not_stop_it() {
    // The side of the car is 0.15 m from the curb, nearer than the space that it keeps elsewhere.
    let mut map = road();
    let start = map.points.len();
    map.points.extend((0..=300).map(|k| [-20.0 + 0.5 * f64::from(k), -1.15, 0.0]));
    let points = start..map.points.len();
    map.features.push(MapFeature { id: "curb".to_owned(), kind: MapKind::EdgeBoundary, points, lane: None });
    for options in [json!({}), json!({"brake": true})] {
        let driven = drive_scene(scene(map.clone(), vec![ego(5.0)]), &options);
        let last = driven.drive.motions.last().unwrap();
        assert!(
            last.position[0] > 60.0 && driven.drive.off_road.step().is_none(),
            "{options}: {:?}",
            last.position
        );
    }
}

#[test]
fn the_direction_of_the_road_does_not_matter() {
    let tracks = || vec![ego(8.0), standing(40.0, 1.4), car("slower", [80.0, 0.2], 0.0, 3.0)];
    let straight = positions(&drive(tracks(), &json!({})), 0.0);
    for degrees in [90.0f64, 37.0] {
        let angle = degrees.to_radians();
        let episode = drive_scene(rotated(scene(road(), tracks()), angle), &json!({}));
        let turned = positions(&episode, angle);
        assert_eq!(straight.len(), turned.len());
        for (step, (a, b)) in straight.iter().zip(&turned).enumerate() {
            let away = (a[0] - b[0]).hypot(a[1] - b[1]);
            assert!(away < 1e-3, "{degrees}°, step {step}: {a:?} {b:?}");
        }
    }
}

#[test]
fn it_is_seldom_at_fault_and_never_leaves_the_road() {
    let driver = policies().unwrap().build_default("pdm").unwrap();
    let scenes = driving::scenes();
    let (mut at_fault, mut off_road) = (0, 0);
    for scene in &scenes {
        let episode = Episode::run(scene, None, driver.as_ref(), 0).unwrap();
        at_fault += usize::from(episode.first_contacts().any(|c| c.class.is_at_fault() == Some(true)));
        off_road += usize::from(episode.drive.off_road.step().is_some());
    }
    assert!(30 * at_fault <= scenes.len(), "{at_fault} of {}", scenes.len());
    assert_eq!(off_road, 0);
}

#[test]
fn its_options_are_checked() {
    let error = |options| policies().unwrap().build("pdm", &options).err().unwrap();
    assert_snapshot!(error(json!({"curves": -1})), @"options of policy `pdm`: `curves` is -1; expected m/s² above 0, or null");
    assert_snapshot!(error(json!({"brakes": true})), @"options of policy `pdm`: unknown field `brakes`, expected one of `brake`, `any_speed`, `curves`, `as_published`, `red_lights`");
}
