//! The policy `r157` on the road: cut-ins, standing cars, leaders that brake.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod driving;
mod hand_made;
mod reference;

use std::sync::Arc;

use driving::policy;
use hand_made::{car, prepared, scene};
use insta::assert_snapshot;
use sage_core::scene::{Lane, Map, MapFeature, MapKind, Track};
use sage_sim::{
    SimScene,
    episode::{End, Episode},
    policy::{EgoPolicy, policies},
};
use serde_json::json;

/// Two lanes along x, 3.5 m apart.
fn two_lanes() -> Map {
    let mut map = Map::default();
    for (id, y) in [("own", 0.0), ("left", 3.5)] {
        let start = map.points.len();
        map.points.extend((0..=120).map(|k| [-100.0 + 5.0 * f64::from(k), y, 0.0]));
        let points = start..map.points.len();
        let lane = Some(Box::new(Lane { speed_limit: Some(60.0 / 3.6), ..Lane::default() }));
        map.features.push(MapFeature { id: id.to_owned(), kind: MapKind::LaneSurfaceStreet, points, lane });
    }
    map
}

/// A car in the left lane that changes into the right one from a frame on, at a speed sideways.
fn cutting_in(ahead: f64, speed: f64, from: usize, sideways: f64) -> Track {
    let mut track = car("cut-in", [ahead, 3.5], 0.0, speed);
    for frame in from..track.position.len() {
        let time = 0.1 * (frame - from) as f64;
        track.position[frame][1] = (3.5 - sideways * time).max(0.0);
        track.velocity[frame][1] = if track.position[frame][1] > 0.0 { -sideways } else { 0.0 };
    }
    track
}

fn drive(tracks: Vec<Track>, driver: &dyn EgoPolicy) -> Episode {
    let scene: Arc<SimScene> = prepared(scene(two_lanes(), tracks));
    Episode::run(&scene, None, driver, 0).unwrap()
}

fn speed_at(episode: &Episode, step: usize) -> f64 {
    episode.drive.motions[step].speed()
}

#[test]
fn a_cut_in_is_answered_with_more_than_car_following() {
    // 60 km/h behind 40 km/h. The gap when the other starts is 18 m less what both drive in two seconds.
    let [own, other] = [60.0 / 3.6, 40.0 / 3.6];
    let gap = 18.0;
    let ahead = 4.5 + gap + 2.0 * (own - other);
    let tracks = || vec![car("ego", [0.0, 0.0], 0.0, own), cutting_in(ahead, other, 20, 1.0)];
    let r157 = drive(tracks(), policy("r157").as_ref());
    assert_eq!((r157.end, r157.contacts.len()), (End::Horizon, 0));
    let blind = drive(tracks(), policy("constant-speed").as_ref());
    assert_eq!(blind.end, End::Contact);
    // Nothing happens within the wandering zone, perception and delay: 2 s + 0.375 s + 0.72 s + 0.75 s.
    let before = speed_at(&r157, 30);
    assert!((before - own).abs() < 1.5, "{before}");
    let slowest = (30..90).map(|step| speed_at(&r157, step)).fold(f64::INFINITY, f64::min);
    assert!(slowest < other + 0.5, "{slowest}");
}

#[test]
fn one_that_stays_in_its_lane_is_passed() {
    let [own, other] = [60.0 / 3.6, 40.0 / 3.6];
    let tracks = vec![car("ego", [0.0, 0.0], 0.0, own), car("beside", [25.0, 3.5], 0.0, other)];
    let passing = drive(tracks, policy("r157").as_ref());
    assert_eq!(passing.end, End::Horizon);
    let slowest = (5..90).map(|step| speed_at(&passing, step)).fold(f64::INFINITY, f64::min);
    assert!(slowest > own - 1.0, "{slowest}");
}

#[test]
fn it_stops_behind_a_standing_car_and_one_that_brakes_hard() {
    let standing = vec![car("ego", [0.0, 0.0], 0.0, 12.0), car("standing", [60.0, 0.0], 0.0, 0.0)];
    let stopped = drive(standing, policy("r157").as_ref());
    assert_eq!((stopped.end, stopped.contacts.len()), (End::Horizon, 0));
    assert!(speed_at(&stopped, 85) < 0.5, "{}", speed_at(&stopped, 85));

    // 2 s behind a leader that brakes with 7.6 m/s² from frame 20 on.
    let speed = 60.0 / 3.6;
    let mut leader = car("leader", [4.5 + 2.0 * speed, 0.0], 0.0, speed);
    let (mut x, mut v) = (leader.position[20][0], speed);
    for frame in 21..leader.position.len() {
        let next = f64::max(v - 0.76, 0.0);
        x += 0.05 * (v + next);
        v = next;
        leader.position[frame][0] = x;
        leader.velocity[frame][0] = v;
    }
    let braking = drive(vec![car("ego", [0.0, 0.0], 0.0, speed), leader], policy("r157").as_ref());
    assert_eq!((braking.end, braking.contacts.len()), (End::Horizon, 0));
}

#[test]
fn its_options_are_checked() {
    let build = |options| policies().unwrap().build("r157", &options);
    assert!(build(json!({"reading": "overlap", "aeb": true})).is_ok());
    let error = |options| build(options).err().unwrap();
    assert_snapshot!(error(json!({"reading": "late"})), @"options of policy `r157`: unknown variant `late`, expected one of `distance`, `time`, `overlap`");
    assert_snapshot!(error(json!({"following": {"lane_changes": {}}})), @"options of policy `r157`: `following.lane_changes` must be null: this driver never changes lanes");
    assert_snapshot!(error(json!({"following": {"limits": [1, 2], "lane_changes": null}})), @"options of policy `r157`: `following`: `limits` is [1, 2]; expected a number below 0 and one above");
}
