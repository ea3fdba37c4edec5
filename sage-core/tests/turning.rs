//! How tightly and how fast a plan turns, against curves whose radius is known.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::f64::consts::PI;

use approx::assert_relative_eq;
use hand_made::{candidate, car, context, road, score};
use sage_core::{
    objective::{
        Candidate, Context, ContextOptions, Convention, against_lanes, feasibilities,
        turning::{LATERAL, TURN, fast_turn, tight_turn},
    },
    scene::{MapKind, Scene, SceneIndex},
    seed::Rng,
};
use serde_json::json;

/// The scene of an adversary of some length that moves as given *now*; a map without edges.
fn scene(start: [f64; 2], velocity: [f64; 2], length: f64) -> Scene {
    let mut adversary = car("a", start, velocity);
    adversary.size.iter_mut().for_each(|size| size[0] = length);
    let mut scene = road(adversary, vec![]);
    scene.map = Default::default();
    scene
}

/// A circle of a radius to the left, from the origin along +x, at a speed, up to an angle.
fn circle(radius: f64, speed: f64, most: f64) -> impl Fn(f64) -> [f64; 2] {
    move |t| {
        let angle = (speed * t / radius).min(most);
        [radius * angle.sin(), 20.0 + radius * (1.0 - angle.cos())]
    }
}

fn plan(scene: &Scene, at: impl Fn(f64) -> [f64; 2]) -> Candidate {
    candidate(&context(scene), at)
}

#[test]
fn a_circle_turns_by_the_inverse_of_its_radius() {
    for (radius, speed) in
        [(2.0, 3.0), (3.0, 2.0), (3.5, 4.0), (4.2, 4.0), (5.0, 4.0), (8.0, 5.0), (20.0, 6.0)]
    {
        let scene = scene([0.0, 20.0], [speed, 0.0], 4.5);
        let plan = plan(&scene, circle(radius, speed, 1e9));
        let found = tight_turn(&plan, 1e-3).unwrap();
        // The window holds whole chords of at least 0.5 m.
        assert_relative_eq!(found.value, 1.0 / radius, max_relative = 0.35);
        assert!(found.value <= 1.0 / radius + 1e-9);
        assert_eq!(tight_turn(&plan, TURN).is_some(), radius < 4.0, "{radius}: {found:?}");
        let lateral = fast_turn(&plan, 1e-3).unwrap();
        // Half a second of a tight circle is a chord that is shorter than its arc.
        if speed * 0.5 / radius < 0.3 {
            assert_relative_eq!(lateral.value, speed * speed / radius, max_relative = 0.02);
        }
    }
}

#[test]
fn what_turns_as_a_whole_does_not_depend_on_place_direction_or_speed() {
    let mut rng = Rng::new(0, "turning", "laws");
    for _ in 0..200 {
        let radius = rng.uniform(2.0, 30.0);
        let speed = rng.uniform(1.0, 8.0);
        let whole = circle(radius, speed, 2.0);
        let angle = rng.uniform(-PI, PI);
        let (sin, cos) = angle.sin_cos();
        let offset = [rng.uniform(-1e3, 1e3), rng.uniform(-1e3, 1e3)];
        let turned = |[x, y]: [f64; 2]| [offset[0] + cos * x - sin * y, offset[1] + sin * x + cos * y];
        let a = plan(&scene(whole(0.0), [speed, 0.0], 4.5), &whole);
        let b = plan(&scene(turned(whole(0.0)), [speed * cos, speed * sin], 4.5), |t| turned(whole(t)));
        let mirrored = plan(&scene([0.0, -20.0], [speed, 0.0], 4.5), |t| {
            let [x, y] = whole(t);
            [x, -y]
        });
        let value = |plan: &Candidate| tight_turn(plan, 1e-3).unwrap().value;
        assert_relative_eq!(value(&a), value(&b), max_relative = 1e-6);
        assert_relative_eq!(value(&a), value(&mirrored), max_relative = 1e-9);
    }
}

#[test]
fn longer_vehicles_turn_less_tightly() {
    for (length, least) in [(4.0, 4.0), (6.0, 4.0), (9.0, 6.0), (12.0, 8.0), (18.0, 12.0)] {
        let is_tight = |radius: f64| {
            let scene = scene([0.0, 20.0], [3.0, 0.0], length);
            tight_turn(&plan(&scene, circle(radius, 3.0, 1e9)), TURN).is_some()
        };
        assert!(!is_tight(least + 0.1), "{length}");
        assert!(is_tight(0.6 * least), "{length}");
    }
}

#[test]
fn noise_of_a_standing_or_creeping_car_is_no_turn() {
    let mut rng = Rng::new(3, "turning", "noise");
    for _ in 0..50 {
        let noise: Vec<[f64; 2]> =
            (0..=80).map(|_| [rng.uniform(-0.08, 0.08), rng.uniform(-0.08, 0.08)]).collect();
        let at = |t: f64| noise[(10.0 * t).round() as usize];
        let stands = plan(&scene([0.0, 0.0], [0.0, 0.0], 4.5), at);
        assert_eq!(tight_turn(&stands, TURN), None);
        assert_eq!(fast_turn(&stands, LATERAL), None);
    }
}

#[test]
fn the_heading_now_counts() {
    // Straight on at 45° off the heading: no curve after the first step, however far or near.
    for far in [0.45, 1.0, 30.0] {
        let scene = scene([0.0, 0.0], [1.0, 0.0], 4.5);
        let off = plan(&scene, |t| [far * t / 8.0 * 0.5_f64.sqrt(), far * t / 8.0 * 0.5_f64.sqrt()]);
        let found = tight_turn(&off, TURN).unwrap();
        assert_relative_eq!(found.value, 0.125 * PI, max_relative = 1e-9);
    }
}

#[test]
fn driving_backwards_is_a_turn_only_where_it_bends() {
    let backwards = scene([0.0, 0.0], [-2.0, 0.0], 4.5);
    let mut reversing = backwards.clone();
    reversing.tracks[1].heading.iter_mut().for_each(|heading| *heading = 0.0);
    let straight = |t: f64| [-2.0 * t, 0.0];
    assert_eq!(tight_turn(&plan(&reversing, straight), TURN), None);
    // It goes on forwards after a stop.
    let forwards = |t: f64| [if t < 2.0 { -2.0 * t } else { -4.0 + 2.0 * (t - 2.0) }, 0.0];
    assert_eq!(tight_turn(&plan(&reversing, forwards), TURN), None);
    // A car that drives forwards cannot do the same.
    assert!(
        tight_turn(&plan(&backwards, |t| [-2.0 * t.min(2.0) + 2.0 * (t - 2.0).max(0.0), 0.0]), TURN)
            .is_some()
    );
    let bent = circle(2.0, 2.0, 1e9);
    let bend = |t: f64| {
        let [x, y] = bent(t);
        [-x, y - 20.0]
    };
    assert!(tight_turn(&plan(&reversing, bend), TURN).is_some());
}

#[test]
fn the_rule_drivable_names_what_it_finds_and_its_limits_are_options() {
    let tight = scene([0.0, 20.0], [3.0, 0.0], 4.5);
    let fast = scene([0.0, 20.0], [20.0, 0.0], 4.5);
    let ctx = [&tight, &fast].map(context);
    let plans = [candidate(&ctx[0], circle(3.0, 3.0, 1e9)), candidate(&ctx[1], circle(50.0, 20.0, 1e9))];
    let rules = |options: serde_json::Value, k: usize| -> Vec<(String, usize)> {
        let rule = feasibilities().unwrap().build("drivable", &options).unwrap();
        let found = rule.violations(&plans[k], &ctx[k]);
        assert_eq!(rule.is_feasible(&plans[k], &ctx[k]), found.is_empty());
        found.iter().map(|violation| (violation.rule.to_string(), violation.step)).collect()
    };
    let found = rules(json!({}), 0);
    assert_eq!(found[0].0, "turning_circle");
    // After 2 m of 3 m/s at the latest.
    assert!((3..=8).contains(&found[0].1), "{found:?}");
    assert_eq!(rules(json!({}), 1)[0].0, "lateral_acceleration");
    assert_eq!(rules(json!({"turn": null}), 0), []);
    assert_eq!(rules(json!({"turn": 0.4}), 0), []);
    assert_eq!(rules(json!({"lateral": null}), 1), []);
    for wrong in [json!({"turn": 0.0}), json!({"lateral": -1.0})] {
        let error = feasibilities().unwrap().build("drivable", &wrong).err().unwrap().to_string();
        assert!(error.contains("above 0"), "{error}");
    }
    // The paper's rule and the published code know no such limit.
    let paper = feasibilities().unwrap().build_default("paper").unwrap();
    assert_eq!(paper.violations(&plans[0], &ctx[0]), []);
    let options = ContextOptions { convention: Convention::Release, ..ContextOptions::default() };
    let release = Context::new(ctx[0].scene(), &SceneIndex::new(tight.map.clone()), &options).unwrap();
    assert_eq!(tight_turn(&candidate(&release, circle(3.0, 3.0, 1e9)), TURN), None);
}

/// A road with a lane along y = 0, and an adversary that meets the ego there, which drives at 10 m/s.
fn with_lane(adversary: [f64; 2], velocity: [f64; 2]) -> Scene {
    let scene = road(car("a", adversary, velocity), vec![]);
    let kind = MapKind::LaneSurfaceStreet;
    hand_made::with_feature(&scene, "east", kind, &[[-300.0, 0.0], [300.0, 0.0]])
}

fn doubts(scene: &Scene, at: impl Fn(f64) -> [f64; 2]) -> Vec<String> {
    let scores = score(scene, at);
    assert!(scores.believable.is_some(), "it meets the ego");
    scores.unbelievable.iter().map(|reason| reason.reason.to_string()).collect()
}

#[test]
fn a_person_does_not_believe_tight_turns_and_long_ways_across() {
    // Across the lane at a right angle, from outside of it, slowly: it meets the ego at 40 m after 4 s.
    for (speed, is_long) in [(1.0, true), (2.0, false)] {
        let scene = with_lane([40.0, -4.0 * speed], [0.0, speed]);
        let found = doubts(&scene, |t| [40.0, -4.0 * speed + speed * t]);
        // Only the time up to the contact counts.
        let ctx = context(&scene);
        let plan = candidate(&ctx, |t| [40.0, -4.0 * speed + speed * t]);
        let contact = score(&scene, |t| [40.0, -4.0 * speed + speed * t]).collision_step.unwrap();
        let across = against_lanes::across_lanes(&plan, &ctx, 1..=contact);
        assert_relative_eq!(across, 0.1 * contact as f64, max_relative = 1e-9);
        assert_eq!(found.contains(&"across_lanes".to_owned()), across > 2.55, "{is_long}: {across}");
    }
    // A U-turn of a radius of 5 m into the ego's lane.
    let scene = with_lane([60.0, 5.0], [4.0, 0.0]);
    let u_turn = |t: f64| {
        let angle = (0.8 * t).min(PI);
        let along = (t - PI / 0.8).max(0.0) * 4.0;
        [60.0 + 5.0 * angle.sin() - along, -5.0 + 5.0 * angle.cos() + 5.0]
    };
    let plan = candidate(&context(&scene), u_turn);
    let step = against_lanes::u_turn(&plan, &context(&scene), plan.steps()).unwrap();
    assert!((28..=32).contains(&step), "135 degrees at 0.8 rad/s: {step}");
    // A lane that leads round offers it.
    let kind = MapKind::LaneSurfaceStreet;
    let round: Vec<[f64; 2]> = (0..=20).map(|k| u_turn(0.2 * f64::from(k))).collect();
    let offered = hand_made::with_feature(&scene, "round", kind, &round);
    assert_eq!(against_lanes::u_turn(&plan, &context(&offered), plan.steps()), None);
}

#[test]
fn a_turn_from_the_lane_that_leads_there_crosses_none_of_its_direction() {
    let lane = |scene: Scene, id: &str, points: &[[f64; 2]]| {
        hand_made::with_feature(&scene, id, MapKind::LaneSurfaceStreet, points)
    };
    // Lanes to the east along y = 0 and, left of it, y = 4; oncoming along y = 8.
    let street = |start: [f64; 2]| {
        let scene = lane(with_lane(start, [6.0, 0.0]), "left", &[[-300.0, 4.0], [300.0, 4.0]]);
        lane(scene, "west", &[[300.0, 8.0], [-300.0, 8.0]])
    };
    let turn = |y: f64, side: f64| {
        move |t: f64| {
            let angle = (6.0 * t / 10.0).min(PI / 2.0);
            let after = 6.0 * (t - PI / 2.0 * 10.0 / 6.0).max(0.0);
            [60.0 + 10.0 * angle.sin(), y + side * (10.0 * (1.0 - angle.cos()) + after)]
        }
    };
    let found = |scene: &Scene, at: &dyn Fn(f64) -> [f64; 2]| {
        let ctx = context(scene);
        against_lanes::turn_from_wrong_lane(&candidate(&ctx, at), &ctx)
    };
    // 4 m to the side after a turn by acos(0.6) = 0.927 rad: 1.55 s.
    assert_eq!(found(&street([60.0, 0.0]), &turn(0.0, 1.0)), Some(16));
    assert_eq!(found(&street([60.0, 4.0]), &turn(4.0, 1.0)), None);
    assert_eq!(found(&street([60.0, 0.0]), &turn(0.0, -1.0)), None);
    // From the left lane to the right it crosses the other one.
    assert_eq!(found(&street([60.0, 4.0]), &turn(4.0, -1.0)), Some(16));
    // A lane that leads from the right lane to the left offers it.
    let way: Vec<[f64; 2]> = (0..=40).map(|k| turn(0.0, 1.0)(0.1 * f64::from(k))).collect();
    assert_eq!(found(&lane(street([60.0, 0.0]), "both", &way), &turn(0.0, 1.0)), None);
    // A change of lane, and of two lanes, crosses none by more than 30°.
    for to in [4.0, 8.0] {
        let change = |t: f64| [60.0 + 6.0 * t, to / (1.0 + (-1.2 * (t - 4.0)).exp())];
        assert_eq!(found(&street([60.0, 0.0]), &change), None);
    }
    // It counts after the contact too, which the ego makes from behind after 5.3 s.
    let scene = street([25.0, 0.0]);
    let turns_later = |t: f64| {
        let turned = turn(0.0, 1.0)((t - 5.5).max(0.0));
        [25.0 + 6.0 * t.min(5.5) + turned[0] - 60.0, turned[1]]
    };
    let reasons = doubts(&scene, turns_later);
    assert!(reasons.contains(&"wrong_lane".to_owned()), "{reasons:?}");
    assert!(!doubts(&scene, |t| [25.0 + 6.0 * t, 0.0]).contains(&"wrong_lane".to_owned()));
}

#[test]
fn the_definition_before_does_not_know_turns() {
    // It stands 3 m ahead of where it turns tightly into the ego's lane.
    let scene = with_lane([40.0, 4.0], [3.0, 0.0]);
    let tight = |t: f64| {
        let angle = (t * 1.5).min(PI / 2.0);
        let after = 3.0 * (t - PI / 3.0).max(0.0);
        [40.0 + 2.0 * angle.sin(), 4.0 - 2.0 * (1.0 - angle.cos()) - after.min(2.0)]
    };
    let scores = score(&scene, tight);
    assert_eq!(
        (scores.believable, scores.believable_1),
        (Some(false), Some(true)),
        "{:?}",
        scores.unbelievable
    );
    assert_eq!(scores.unbelievable[0].reason, "turning_circle");
    assert!(
        scores.unbelievable[0].words().starts_with("turns within "),
        "{}",
        scores.unbelievable[0].words()
    );
}
