//! Pedestrians and cyclists as adversaries: known verdicts, rebuilt from UN R157's scenario of a crossing pedestrian.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::sync::Arc;

use hand_made::{FRAMES, car, prepared, road, scene};
use sage_core::{
    generator::Proposal,
    motion::{DT, HORIZON, Trajectory},
    objective::{Feasibility, PersonFeasibility},
    scene::{Map, MapFeature, MapKind, Track, TrackKind},
};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    policy::policies,
    reference::Reference,
    search::{Evaluated, PlanDrives, Requirement, SearchOptions},
};

/// The walker of the regulation's scenario, m/s: 5 km/h.
const WALK: f64 = 5.0 / 3.6;
/// Seconds after *now* at which the ego's front would meet the walker.
const MEETS: f64 = 5.0;
/// Where the walker stands, metres from the ego's way.
const ASIDE: f64 = 6.0;

/// The road with edges 5 m to both sides.
fn road_with_edges() -> Map {
    let mut map = road();
    for y in [-5.0, 5.0] {
        let start = map.points.len();
        map.points.extend((0..=80).map(|k| [-100.0 + 5.0 * f64::from(k), y, 0.0]));
        let points = start..map.points.len();
        map.features.push(MapFeature {
            id: format!("edge {y}"),
            kind: MapKind::from_name("ROAD_EDGE_BOUNDARY"),
            points,
            lane: None,
        });
    }
    map
}

fn standing(id: &str, kind: TrackKind, [x, y]: [f64; 2], heading: f64, size: [f64; 3]) -> Track {
    Track {
        id: id.to_owned(),
        kind,
        position: vec![[x, y, 0.5 * size[2]]; FRAMES],
        heading: vec![heading; FRAMES],
        velocity: vec![[0.0; 2]; FRAMES],
        size: vec![size; FRAMES],
        valid: vec![true; FRAMES],
    }
}

/// Where the walker crosses the way of an ego that starts at frame 0 in the origin.
fn crossing_at(speed: f64) -> f64 {
    speed * (1.0 + MEETS) + 2.25 + 0.3
}

/// An ego at a speed (km/h), a walker who stands to its right, and others.
fn crossing(kmh: f64, others: Vec<Track>) -> Arc<SimScene> {
    let speed = kmh / 3.6;
    let walker = standing(
        "walker",
        TrackKind::Pedestrian,
        [crossing_at(speed), -ASIDE],
        std::f64::consts::FRAC_PI_2,
        [0.6, 0.6, 1.75],
    );
    let ego = car("ego", [0.0, 0.0], 0.0, speed);
    prepared(scene(road_with_edges(), [ego, walker].into_iter().chain(others).collect()))
}

/// A straight walk that is in the middle of the ego's way some seconds after its front would be there, at a speed that is taken up by
/// an acceleration.
fn walk_after(after: f64, kmh: f64, walk: f64, acceleration: f64) -> Proposal {
    let x = crossing_at(kmh / 3.6);
    let starting = walk / acceleration;
    let starts = MEETS + after - ASIDE / walk - 0.5 * starting;
    let at = |step: usize| {
        let t = (step as f64 * DT - starts).max(0.0);
        let way = if t < starting { 0.5 * acceleration * t * t } else { walk * (t - 0.5 * starting) };
        [x, -ASIDE + way]
    };
    Proposal::of(Trajectory::new("walk", (1..=HORIZON).map(at).collect()).unwrap())
}

/// The walk that meets the middle of the ego's front, started as people do.
fn walk(kmh: f64) -> Proposal {
    walk_after(0.0, kmh, WALK, 1.4)
}

/// What a driver makes of a plan.
fn evaluated(scene: &Arc<SimScene>, driver: &str, plan: &Proposal, require: &str) -> Option<Evaluated> {
    let policy = policies().unwrap().build(driver, &serde_json::json!({})).unwrap();
    let references = ["expert"].map(|name| Reference {
        name: name.to_owned(),
        policy: policies().unwrap().build_default(name).unwrap(),
    });
    let test = AttackTest::new(&*policy, scene, 0).unwrap().with_references(&references);
    let ctx = test.context().unwrap();
    let options = SearchOptions { require: require.parse().unwrap(), ..SearchOptions::default() };
    let mut drives = PlanDrives::new(&test, &ctx, &PersonFeasibility, &options).unwrap();
    drives.evaluate(0, plan).unwrap()
}

#[test]
fn a_pedestrian_who_crosses_as_in_r157_is_avoidable_and_leaves_the_time() {
    for kmh in [10.0, 20.0, 30.0, 40.0, 50.0, 60.0] {
        let require = "attack,believable,strict,at-fault,avoidable,preventable,human-time,human-time-r157";
        let found = evaluated(&crossing(kmh, vec![]), "constant-speed", &walk(kmh), require).unwrap();
        assert!(found.clauses.meet(require.parse().unwrap()), "{kmh} km/h: {:?}", found.clauses);
        let met = found.person.unwrap();
        assert!(
            met.contact.offset.abs() < 0.1,
            "{kmh} km/h: the middle of the front, {}",
            met.contact.offset
        );
        assert!((met.contact.ego_speed - kmh / 3.6).abs() < 0.1 && !met.contact.from_left);
        let walking = ASIDE / WALK + (0.5 * WALK - 0.5) / 1.4;
        assert!((met.contact.walking - walking).abs() < 0.2, "{} and {walking}", met.contact.walking);
        assert!(met.seen >= MEETS - 0.2, "nothing hides the walker: {}", met.seen);
        assert!(met.contact.turned < 1e-6 && met.contact.askew < 1e-6);
    }
}

#[test]
fn a_pedestrian_in_sight_for_half_a_second_is_in_nobodys_power() {
    let (kmh, speed) = (60.0, 60.0 / 3.6);
    // The walker would be 0.6 m to the right of the ego's middle. Half a second before, it is at -1.3 m and the ego's centre
    // 8.3 + 2.55 m before it, so the line between them passes the front corner of the van, at (x - 0.5, -1.2).
    let x = crossing_at(speed);
    let hides = standing("van", TrackKind::Vehicle, [x - 3.0, -2.6], 0.0, [5.0, 2.8, 2.0]);
    let scene = crossing(kmh, vec![hides]);
    let plan = walk_after(0.6 / WALK, kmh, WALK, 1.4);
    let require = "attack,avoidable,human-time";
    let found = evaluated(&scene, "constant-speed", &plan, require).unwrap();
    let met = found.person.unwrap();
    assert!((0.3..=0.8).contains(&met.seen), "{}", met.seen);
    assert_eq!(found.clauses.believable, Some(false), "it was not in sight for a second");
    // Knowing the plan, braking avoids it; within the time in sight it does not. Full braking for 0.5 s saves 0.5 · 8 · 0.5² = 1 m of
    // the 8.3 m, so the front is at the walker 0.1 s later, and the walker needs (0.6 + 1 + 0.3) / 1.39 = 1.4 s to leave the car's way.
    assert_eq!(found.clauses.avoidable, Some(true));
    assert!(found.human_time.unwrap() < 0.0, "{:?}", found.human_time);
    assert_eq!(found.clauses.human_time, Some(false));
}

#[test]
fn who_runs_into_the_side_of_a_car_or_into_one_that_stands_is_not_believed() {
    let kmh = 30.0;
    // Later the front has passed, and the walker meets the side.
    let late = walk_after(0.95, kmh, WALK, 1.4);
    let scene = crossing(kmh, vec![]);
    let into_the_side = evaluated(&scene, "constant-speed", &late, "attack,believable").unwrap();
    assert_eq!((into_the_side.contact.is_some(), into_the_side.clauses.believable), (true, Some(false)));
    // Nearly along the way of the ego, towards it.
    let x = crossing_at(kmh / 3.6) + 5.0;
    let mut oncoming = sage_core::scene::Scene::clone(crossing(kmh, vec![]).scene());
    oncoming.tracks[1].position.iter_mut().for_each(|p| [p[0], p[1]] = [x, -2.0]);
    let way = |t: f64| 0.5 * t * t.min(WALK) + (t - WALK).max(0.0) * 0.5 * WALK;
    let at = |step: usize| [x - 0.95 * way(step as f64 * DT), -2.0 + 0.3 * way(step as f64 * DT)];
    let plan = Proposal::of(Trajectory::new("along", (1..=HORIZON).map(at).collect()).unwrap());
    let along = evaluated(&prepared(oncoming), "constant-speed", &plan, "attack,believable").unwrap();
    assert_eq!((along.contact.is_some(), along.clauses.believable), (true, Some(false)));
}

#[test]
fn a_plan_keeps_to_human_limits_and_walks_through_nobody() {
    let scene = crossing(30.0, vec![]);
    let test_policy = policies().unwrap().build_default("constant-speed").unwrap();
    let test = AttackTest::new(&*test_policy, &scene, 0).unwrap();
    let ctx = test.context().unwrap();
    let rules = |plan: &Proposal, ctx: &_| -> Vec<String> {
        let violations = PersonFeasibility
            .violations(&sage_core::objective::Context::candidate(ctx, plan.trajectory.clone()), ctx);
        violations.into_iter().map(|violation| violation.rule.into_owned()).collect()
    };
    assert!(rules(&walk(30.0), &ctx).is_empty());
    assert_eq!(rules(&walk_after(0.0, 30.0, WALK, 6.0), &ctx), ["hard_start"]);
    assert_eq!(rules(&walk_after(0.0, 30.0, 3.0, 1.4), &ctx), ["too_fast"]);
    // A cyclist is in the way at all times.
    let x = crossing_at(30.0 / 3.6);
    let other = standing("cyclist", TrackKind::Cyclist, [x, -4.0], 0.0, [1.8, 0.6, 1.8]);
    let crowded = crossing(30.0, vec![other]);
    let test = AttackTest::new(&*test_policy, &crowded, 0).unwrap();
    assert!(rules(&walk(30.0), &test.context().unwrap()).contains(&"agent".to_owned()));
}

#[test]
fn people_have_a_requirement_of_their_own() {
    let people = Requirement::of_people();
    assert_eq!(people.to_string(), "attack,believable,at-fault,preventable,human-time");
    let read: Requirement = "attack,strict,human-time-r157".parse().unwrap();
    assert_eq!(read.to_string(), "attack,strict,human-time-r157");
}

#[test]
fn drivers_brake_for_people_who_are_about_to_cross_if_they_are_told_to() {
    let kmh = 40.0;
    let contact = |driver: &str, options: serde_json::Value| {
        let scene = crossing(kmh, vec![]);
        let policy = policies().unwrap().build(driver, &options).unwrap();
        let test = AttackTest::new(&*policy, &scene, 0).unwrap();
        let outcome = test.attack(&walk(kmh).trajectory, true).unwrap();
        outcome.episode.contacts.first().map(|contact| contact.impact_speed)
    };
    for driver in ["idm", "r157"] {
        let as_it_stands = contact(driver, serde_json::json!({})).unwrap();
        let told = contact(driver, serde_json::json!({"people": true}));
        assert!(told.is_none_or(|speed| speed < as_it_stands - 1.0), "{driver}: {told:?}, {as_it_stands}");
    }
}
