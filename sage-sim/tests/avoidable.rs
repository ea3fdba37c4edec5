//! Evasive manoeuvres: worked scenes with known answers, and witnesses that other code finds free of contacts.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;
mod reference;

use std::sync::Arc;

use hand_made::{car, road, scene};
use insta::assert_snapshot;
use sage_core::{
    geometry::{OrientedBox, distance},
    motion::{HORIZON, NOW, Trajectory},
    objective::{
        Context, ContextOptions, EgoPaths, Encounter, FurtherMeasures, ObjectiveSpec, Situation,
        feasibilities, rewards,
    },
    scene::{Map, MapFeature, MapKind, Scene, SceneIndex, Track},
};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    avoidable::{Avoidable, Avoidance, AvoidanceOptions, LatestStart},
    episode::Episode,
    policy::policies,
    traffic::Plan,
};

/// A street along x between two edges.
fn street(half: f64) -> Map {
    let mut map = road();
    for (id, y) in [("left", half), ("right", -half)] {
        let start = map.points.len();
        map.points.extend((0..=80).map(|k| [-100.0 + 5.0 * f64::from(k), y, 0.0]));
        let points = start..map.points.len();
        map.features.push(MapFeature { id: id.to_owned(), kind: MapKind::EdgeBoundary, points, lane: None });
    }
    map
}

fn context(scene: Scene) -> Context {
    let index = SceneIndex::new(scene.map.clone());
    Context::new(&Arc::new(scene), &index, &ContextOptions::default()).unwrap()
}

/// The adversary's recorded future as its plan.
fn recorded(ctx: &Context) -> Trajectory {
    let track = ctx.adversary();
    Trajectory::new("recorded", (NOW + 1..=NOW + HORIZON).map(|f| track.point(f)).collect()).unwrap()
}

fn found(ctx: &Context, options: AvoidanceOptions) -> Avoidable {
    Avoidance::new(ctx, options).unwrap().of(&ctx.candidate(recorded(ctx)))
}

fn in_street(half: f64, tracks: Vec<Track>) -> Avoidable {
    found(&context(scene(street(half), tracks)), AvoidanceOptions::default())
}

/// Whether a time is as long as a closed form, or up to two frames longer: the contact is rounded up to a frame and the
/// start down.
fn is_within_frames(found: Option<f64>, exact: f64) -> bool {
    found.is_some_and(|found| (exact - 1e-9..=exact + 0.2 + 1e-9).contains(&found))
}

#[test]
fn before_a_wall_of_cars_braking_starts_a_sixteenth_of_the_speed_before() {
    // At 8 m/s², v²/16 metres and v/16 seconds at the speed of approach.
    for speed in [8.0, 12.0, 16.0, 20.0] {
        let mut tracks = vec![car("ego", [0.0, 0.0], 0.0, speed)];
        let ahead = speed * 4.0;
        tracks.extend([0.0, 2.1, -2.1, 4.2, -4.2].map(|y| car(&format!("wall {y}"), [ahead, y], 0.0, 0.0)));
        let out = in_street(5.2, tracks);
        assert_eq!((out.avoidable, out.hit_from_behind, out.recovers), (Some(true), Some(false), Some(true)));
        assert!(is_within_frames(out.latest_brake, speed / 16.0), "{speed}: {:?}", out.latest_brake);
        assert_eq!((out.latest_start, out.latest_steer), (out.latest_brake, None), "{speed}");
        // From *now* on there is v² / (2 · 2 m/s²) or less to stop in: three seconds at full speed.
        let [free, needs] = [3.0 * speed - 4.5, speed * speed / 4.0];
        let mildest = if needs < free { 2.0 } else { 4.0 };
        assert_eq!(out.mildest_deceleration, Some(mildest), "{speed}");
    }
}

#[test]
fn a_slower_car_in_a_lane_of_walls_needs_the_closing_speed() {
    // 60 and 40 km/h.
    let [own, other] = [60.0 / 3.6, 40.0 / 3.6];
    let tracks = vec![car("ego", [0.0, 0.0], 0.0, own), car("slow", [30.0, 0.0], 0.0, other)];
    let out = in_street(1.4, tracks);
    assert!(is_within_frames(out.latest_brake, (own - other) / 16.0), "{:?}", out.latest_brake);
}

#[test]
fn a_sidestep_beats_braking_at_speed() {
    // A standing car overlaps the ego's way by 1 m: braking takes v / 16. A point takes √(1/3) = 0.58 s to 1 m aside at
    // 6 m/s²; the front of a slow car swings aside earlier, the corners of a fast one need a little more.
    for (speed, is_faster) in [(6.0, false), (16.0, true)] {
        let tracks = vec![car("ego", [0.0, 0.0], 0.0, speed), car("parked", [speed * 4.0, 1.0], 0.0, 0.0)];
        let out = in_street(8.0, tracks);
        let [brake, steer] = [out.latest_brake, out.latest_steer].map(Option::unwrap);
        assert!(is_within_frames(Some(brake), speed / 16.0), "{brake}");
        assert!((0.3..=0.9).contains(&steer), "{speed}: {steer}");
        assert_eq!(steer < brake - 0.1, is_faster, "{speed}: {steer} and {brake}");
        assert!(out.latest_start.unwrap() <= brake.min(steer));
    }
}

#[test]
fn nothing_helps_against_a_car_that_comes_on_in_a_street_of_one_lane() {
    let towards = |from: f64| {
        let pi = std::f64::consts::PI;
        let tracks = vec![car("ego", [0.0, 0.0], 0.0, 8.0), car("oncoming", [from, 0.0], pi, 8.0)];
        in_street(1.6, tracks)
    };
    let out = towards(80.0);
    assert_eq!((out.avoidable, out.avoidable_unhit, out.witness), (Some(false), Some(false), None));
    // One that arrives after the end is only put off.
    let late = towards(128.0);
    assert_eq!((late.avoidable, late.recovers), (Some(true), Some(false)), "{late:?}");
    // One that stops in time: brake before its place.
    let mut stopping = car("oncoming", [60.0, 0.0], std::f64::consts::PI, 8.0);
    for frame in 15..stopping.position.len() {
        stopping.position[frame][0] = 60.0 - 12.0;
    }
    let out = in_street(1.6, vec![car("ego", [0.0, 0.0], 0.0, 8.0), stopping]);
    assert!(is_within_frames(out.latest_start, 0.5), "{:?}", out.latest_start);
}

#[test]
fn a_follower_that_does_not_react_is_told_apart() {
    // 16 m behind at the same speed: it runs into the ego that brakes before the wall.
    let followed = |from: f64| {
        let tracks = vec![
            car("ego", [0.0, 0.0], 0.0, 12.0),
            car("wall", [60.0, 0.0], 0.0, 0.0),
            car("follower", [from, 0.0], 0.0, 12.0),
        ];
        in_street(1.4, tracks)
    };
    let out = followed(-16.0);
    assert_eq!((out.avoidable, out.avoidable_unhit), (Some(true), Some(false)));
    assert_eq!(out.hit_from_behind, Some(true));
    assert!(is_within_frames(out.latest_brake, 0.75), "{:?}", out.latest_brake);
    // The ego stops within 9 m. A UN R157 driver behind it needs 9 m to react and 13 m to stop: 13 m between the bumpers
    // suffice.
    let r157 = |gap: f64| followed(-4.5 - gap).hit_by_reactive_follower;
    assert_eq!((r157(12.5), r157(13.5)), (Some(true), Some(false)));
    assert_eq!(followed(-60.0).hit_by_reactive_follower, None);
}

#[test]
fn what_has_no_answer_says_why() {
    let reason = |out: Avoidable| {
        assert_eq!((out.avoidable, out.latest_start, out.witness), (None, None, None));
        out.avoidable_reason.unwrap()
    };
    let ego = || car("ego", [0.0, 0.0], 0.0, 8.0);
    let far = in_street(5.0, vec![ego(), car("far", [200.0, 0.0], 0.0, 0.0)]);
    assert_eq!(reason(far), "no contact");
    let inside = in_street(5.0, vec![ego(), car("inside", [9.0, 0.5], 0.0, 0.0)]);
    assert_eq!(reason(inside), "the ego touches `inside` now");
    let open = scene(road(), vec![ego(), car("wall", [40.0, 0.0], 0.0, 0.0)]);
    assert_eq!(reason(found(&context(open), AvoidanceOptions::default())), "the map has no road edges");
    let ctx = context(scene(street(5.0), vec![ego(), car("wall", [40.0, 0.0], 0.0, 0.0)]));
    let refused = |options| Avoidance::new(&ctx, options).err().unwrap().to_string();
    assert_snapshot!(refused(AvoidanceOptions { brake: 0.0, ..AvoidanceOptions::default() }), @"options of search `avoidable`: `brake` is 0; expected a number above 0, up to 100");
    assert_snapshot!(refused(AvoidanceOptions { refinement: 9, ..AvoidanceOptions::default() }), @"options of search `avoidable`: `refinement` is 9; expected 0 to 4");
}

#[test]
fn weaker_drivers_must_react_earlier() {
    let ctx = || {
        let wall = [0.0, 2.1, -2.1, 4.2, -4.2].map(|y| car(&format!("wall {y}"), [64.0, y], 0.0, 0.0));
        let tracks = std::iter::once(car("ego", [0.0, 0.0], 0.0, 12.0)).chain(wall);
        context(scene(street(5.2), tracks.collect()))
    };
    let time = |options| found(&ctx(), options).latest_start.unwrap();
    let plain = time(AvoidanceOptions::default());
    // A ramp of 12.65 m/s³ to 7.593 m/s², as in UN R157: G_req / Δv of the closed form.
    let r157 = time(AvoidanceOptions { brake: 7.593, jerk: Some(12.65), ..AvoidanceOptions::default() });
    let needed = (0.6 * 12.0 - 0.45558 + (12.0f64 - 2.27788).powi(2) / 15.18588) / 12.0;
    assert!(is_within_frames(Some(r157), needed), "{r157} for {needed}");
    let late = time(AvoidanceOptions { dead_time: 0.7, ..AvoidanceOptions::default() });
    assert!((late - plain - 0.7).abs() < 1e-9, "{late} and {plain}");
    assert!(time(AvoidanceOptions::comfortable()) > r157);
}

#[test]
fn the_latest_start_is_a_reward() {
    let ctx = |wall: f64| {
        let tracks = vec![car("ego", [0.0, 0.0], 0.0, 12.0), car("wall", [wall, 0.0], 0.0, 0.0)];
        context(scene(street(1.4), tracks))
    };
    let registry = rewards().unwrap().with::<LatestStart>().unwrap();
    let score = |ctx: &Context, target: f64| {
        let reward = registry.build("latest-start", &serde_json::json!({"target": target})).unwrap();
        let candidate = ctx.candidate(recorded(ctx));
        let value = reward.score(&Situation::new(&candidate, ctx.ego(), ctx)).unwrap();
        assert!(reward.slow_range().is_some_and(|[low, high]| (low..=high).contains(&value)));
        value
    };
    let near = ctx(64.0);
    let time = found(&near, AvoidanceOptions::default()).latest_start.unwrap();
    assert_eq!(score(&near, time), 0.0);
    assert!((score(&near, 1.5) + (1.5 - time)).abs() < 1e-9 && score(&near, 8.0) == -3.0);
    assert_eq!(score(&ctx(200.0), 1.5), -3.0);
    assert_snapshot!(registry.build("latest-start", &serde_json::json!({"target": 9})).err().unwrap(), @"options of reward `latest-start`: `target` is 9; expected 0 to 8 seconds");
    // It is slow, so tables have it only on demand.
    let rules = feasibilities().unwrap();
    let spec: ObjectiveSpec =
        serde_json::from_value(serde_json::json!({"terms": [{"name": "latest-start", "weight": 1}]}))
            .unwrap();
    let shown =
        |spec| FurtherMeasures::of(&registry, &rules, spec).unwrap().rewards().any(|n| n == "latest-start");
    assert!(!shown(None) && shown(Some(&spec)));
}

/// Straight plans of the adversary to where the ego is at some steps.
fn plans(ctx: &Context) -> Vec<Trajectory> {
    let from = ctx.adversary().point(NOW);
    let plan = |step: usize| {
        let to = ctx.ego().positions()[step - 1];
        let at = |k: usize| {
            let share = k as f64 / step as f64;
            [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])]
        };
        Trajectory::new("straight", (1..=HORIZON).map(at).collect()).unwrap()
    };
    [15, 30, 50].map(plan).into()
}

#[test]
fn witnesses_touch_nothing_when_other_code_replays_them() {
    let procedural = Kind::ALL.iter().flat_map(|kind| (0..4).filter_map(|n| generate(*kind, 3, n)));
    let procedural: Vec<Arc<Scene>> = procedural.map(Arc::new).collect();
    let (mut witnesses, mut attacks) = (0, 0);
    for scene in procedural.into_iter().chain(reference::scenes(&["val"])) {
        if !scene.adversary().is_ok_and(|adversary| adversary.is_valid(NOW)) {
            continue;
        }
        let index = SceneIndex::new(scene.map.clone());
        let Ok(ctx) = Context::new(&scene, &index, &ContextOptions::default()) else { continue };
        let searches =
            [0, 1, 2].map(|refinement| AvoidanceOptions { refinement, ..AvoidanceOptions::default() });
        let searches = searches.map(|options| Avoidance::new(&ctx, options).unwrap());
        for plan in plans(&ctx) {
            let candidate = ctx.candidate(plan);
            let [coarse, out] = [0, 1].map(|k| searches[k].of(&candidate));
            // A finer search loses no evasive manoeuvre, and finds none that starts earlier.
            let latest = |out: &Avoidable| out.latest_start.unwrap_or(f64::INFINITY);
            assert!(latest(&out) <= latest(&coarse), "{}", scene.id);
            // The finest of these is slow.
            if attacks % 8 == 0 {
                assert!(latest(&searches[2].of(&candidate)) <= latest(&out), "{}", scene.id);
            }
            attacks += usize::from(out.avoidable.is_some());
            let Some(witness) = out.witness else { continue };
            witnesses += 1;
            assert_eq!(witness.len(), HORIZON);
            let is_hit = out.hit_from_behind == Some(true);
            replay(&ctx, &candidate, &witness, is_hit);
            simulate(&ctx, &index, candidate.trajectory(), &witness, is_hit);
        }
    }
    println!("{witnesses} evasive manoeuvres from {attacks} attacks");
    assert!(witnesses > 20, "{witnesses}");
}

/// Drives the witness in the simulation, against the plan.
fn simulate(ctx: &Context, index: &Arc<SceneIndex>, plan: &Trajectory, witness: &[[f64; 3]], is_hit: bool) {
    let scene = ctx.scene();
    let ego = scene.ego();
    if !(0..=NOW).all(|frame| ego.is_valid(frame)) || scene.frames != NOW + HORIZON + 1 {
        return;
    }
    let pose = |frame: usize| [ego.point(frame)[0], ego.point(frame)[1], ego.heading[frame]];
    let drive: Vec<[f64; 3]> = (0..=NOW).map(pose).chain(witness.iter().copied()).collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("drive.json");
    std::fs::write(&file, serde_json::to_string(&drive).unwrap()).unwrap();
    let driver = policies().unwrap().build("path", &serde_json::json!({"file": file})).unwrap();
    let simulated = SimScene::new(scene.clone(), index.clone()).unwrap();
    let plan = Plan::of_adversary(scene, plan).unwrap();
    let episode = Episode::run(&simulated, Some(Arc::new(plan)), driver.as_ref(), 0).unwrap();
    let adversary = scene.adversary_index().unwrap();
    for contact in episode.contacts.iter().filter(|contact| contact.contact.step > NOW) {
        let other = contact.contact.other.track;
        assert!(other != adversary && is_hit, "{}: `{}`", scene.id, scene.tracks[other].id);
    }
}

fn replay(ctx: &Context, candidate: &sage_core::objective::Candidate, witness: &[[f64; 3]], is_hit: bool) {
    let scene = ctx.scene();
    let positions: Vec<[f64; 2]> = witness.iter().map(|[x, y, _]| [*x, *y]).collect();
    let headings = witness.iter().map(|row| row[2]).collect();
    let ego = EgoPaths::one("witness", positions.clone(), Some(headings)).unwrap();
    let replayed = ctx.with_ego(&ego).unwrap();
    assert_eq!(Encounter::of(candidate, replayed.ego()).contact, None, "{}", scene.id);
    let boxes: Vec<OrientedBox> = replayed.ego().boxes().iter().map(|area| area.unwrap()).collect();
    for other in ctx.others() {
        let touches = |k: &usize| other.at(*k).is_some_and(|area| area.intersects(&boxes[k - 1]));
        if let Some(step) = (1..=HORIZON).find(touches) {
            let track = &scene.tracks[other.track];
            let gap = (track.position[NOW + step][2] - scene.ego().position[NOW][2]).abs();
            assert!(is_hit || gap > 3.0, "{}: `{}` at step {step}", scene.id, track.id);
        }
    }
    // No step is longer than the car can drive, and none jumps.
    let mut before = scene.ego().point(NOW);
    for position in positions {
        assert!(distance(before, position) < 6.0, "{}", scene.id);
        before = position;
    }
}
