//! Properties of the objectives on seeded scenes: agreement with a plain implementation, and invariance
//! under motion.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod scenes;

use std::sync::Arc;

use sage_core::{
    geometry::{OrientedBox, distance},
    motion::{NOW, Trajectory},
    objective::{Context, ContextOptions, Convention, Encounter, Scorer, Scores, Violations},
    scene::{MapKind, Scene, SceneIndex},
};
use scenes::{candidate, moved, moved_trajectory, scene};

fn score(scene: &Scene, trajectory: &Trajectory, convention: Convention) -> Scores {
    let index = SceneIndex::new(scene.map.clone());
    let options = ContextOptions { convention, ..ContextOptions::default() };
    let ctx = Context::new(&Arc::new(scene.clone()), &index, &options).unwrap();
    Scorer::new(&ctx).scores(&ctx.candidate(trajectory.clone()))
}

/// The paper's formulas written step by step, without shared quantities or an index.
struct Plain {
    contact: usize,
    reward: f64,
    p_kin: f64,
    p_beh: f64,
    edge: usize,
    agent: usize,
}

fn plain(scene: &Scene, trajectory: &Trajectory) -> Plain {
    let (ego, adversary) = (&scene.tracks[0], &scene.tracks[1]);
    let t_max = 80;
    let p = |t: usize| if t == 0 { adversary.point(NOW) } else { trajectory.points()[t - 1] };
    let speed = |t: usize| (p(t)[0] - p(t - 1)[0]).hypot(p(t)[1] - p(t - 1)[1]) / 0.1;
    let moving: Vec<usize> = (1..=t_max).filter(|&t| speed(t) >= 0.5).collect();
    let heading = |t: usize| {
        let source = moving.iter().rev().find(|&&m| m <= t).or(moving.first());
        source.map_or(adversary.heading[NOW], |&m| (p(m)[1] - p(m - 1)[1]).atan2(p(m)[0] - p(m - 1)[0]))
    };
    let turn = |t: usize| {
        let d = heading(t) - heading(t - 1);
        d.sin().atan2(d.cos())
    };
    let sp = |x: f64| if x > 30.0 { x } else { x.exp().ln_1p() };
    let (mut p_kin, mut spin, mut total) = (0.0, 0.0, 0.0);
    for t in 1..=t_max {
        let (w, a) = if t == 1 { (0.0, 0.0) } else { (turn(t) / 0.1, (speed(t) - speed(t - 1)) / 0.1) };
        p_kin += 5.0 * (sp(a.abs() - 7.0) + sp((speed(t) * w).abs() - 6.0) + sp(w.abs() - 0.8));
        spin += w.abs() / (speed(t) + 0.01);
        total += w * 0.1;
    }
    let size = adversary.size[NOW];
    let of = |t: usize| OrientedBox::new(p(t), heading(t), size[0], size[1]);
    let ego_size = ego.size[NOW];
    let ego_box =
        |t: usize| OrientedBox::new(ego.point(NOW + t), ego.heading[NOW + t], ego_size[0], ego_size[1]);
    let contact = (1..=t_max).find(|&t| of(t).intersects(&ego_box(t))).unwrap_or(0);
    let least = (1..=t_max).map(|t| of(t).center_distance(&ego_box(t))).fold(f64::INFINITY, f64::min);
    let reward = if contact > 0 { 10.0 * (1.0 - contact as f64 / 80.0) } else { (-0.2 * least).exp() };
    let touches_edge = |t: usize| {
        scene.map.polylines(|kind| *kind == MapKind::EdgeBoundary).any(|(_, points)| {
            points.windows(2).any(|s| of(t).intersects_segment([s[0][0], s[0][1]], [s[1][0], s[1][1]]))
        })
    };
    let touches_agent = |t: usize| {
        scene.tracks[2..].iter().any(|o| o.valid[NOW + t] && o.oriented_box(NOW + t).intersects(&of(t)))
    };
    Plain {
        contact,
        reward,
        p_kin: p_kin / 80.0,
        p_beh: 5.0 * sp(total.abs() - std::f64::consts::PI) + 3.0 / 80.0 * spin,
        edge: (1..=t_max).find(|&t| touches_edge(t)).unwrap_or(0),
        agent: (1..=t_max).find(|&t| touches_agent(t)).unwrap_or(0),
    }
}

fn close(found: f64, expected: f64, tolerance: f64, what: &str) {
    let scale = expected.abs().max(1.0);
    assert!((found - expected).abs() <= tolerance * scale, "{what}: {found} instead of {expected}");
}

#[test]
fn the_fast_implementation_equals_the_plain_one() {
    let (mut hits, mut edges, mut agents) = (0, 0, 0);
    for seed in 0..300 {
        let scene = Arc::new(scene(seed));
        let index = SceneIndex::new(scene.map.clone());
        let ctx = Context::new(&scene, &index, &ContextOptions::default()).unwrap();
        for k in 0..8 {
            let trajectory = candidate(&scene, k);
            let expected = plain(&scene, &trajectory);
            let found = ctx.candidate(trajectory);
            let scores = Scorer::new(&ctx).scores(&found);
            let violations = Violations::of(&found, &ctx);
            let what = format!("scene {seed}, candidate {k}");
            assert_eq!(scores.collision_step.unwrap_or(0), expected.contact, "{what}");
            assert_eq!(violations.boundary.map_or(0, |c| c.step), expected.edge, "{what}");
            assert_eq!(violations.agent.map_or(0, |c| c.step), expected.agent, "{what}");
            close(scores.adversarial_reward, expected.reward, 1e-12, &what);
            close(scores.kinematic_penalty, expected.p_kin, 1e-9, &what);
            close(scores.behavior_penalty, expected.p_beh, 1e-9, &what);
            hits += usize::from(expected.contact > 0);
            edges += usize::from(expected.edge > 0);
            agents += usize::from(expected.agent > 0);
        }
    }
    // The cases must contain all three kinds of contact, and cases without each.
    for n in [hits, edges, agents] {
        assert!((240..2160).contains(&n), "{hits} hits, {edges} edges, {agents} agents of 2400");
    }
}

/// Whether some result could change if a box were slightly larger or smaller.
fn is_near_tie(scene: &Scene, trajectory: &Trajectory, convention: Convention) -> bool {
    let resized = |by: f64| {
        let mut scene = scene.clone();
        for track in &mut scene.tracks {
            track.size.iter_mut().for_each(|s| *s = [s[0] + by, s[1] + by, s[2]]);
        }
        let s = score(&scene, trajectory, convention);
        (s.collision_step, s.violations.iter().map(|r| (r.step, r.rule.clone())).collect::<Vec<_>>())
    };
    resized(1e-6) != resized(-1e-6)
}

/// Whether a speed is so near the standing limit that rounding after a move of the scene can cross it.
fn stands_on_the_limit(scene: &Scene, trajectory: &Trajectory) -> bool {
    let mut before = scene.tracks[1].point(NOW);
    trajectory.points().iter().any(|p| {
        let v = (p[0] - before[0]).hypot(p[1] - before[1]) / 0.1;
        before = *p;
        (v - 0.5).abs() < 1e-7
    })
}

#[test]
fn paper_does_not_change_when_the_scene_is_moved_and_turned() {
    let mut compared = 0;
    for seed in 0..150 {
        let here = scene(seed);
        let (angle, by) = (0.1 + seed as f64, [3000.0 - 40.0 * seed as f64, 70.0 * seed as f64]);
        let there = moved(&here, angle, by);
        for k in 0..4 {
            let trajectory = candidate(&here, k);
            if is_near_tie(&here, &trajectory, Convention::Paper) || stands_on_the_limit(&here, &trajectory) {
                continue;
            }
            compared += 1;
            let (a, b) = (
                score(&here, &trajectory, Convention::Paper),
                score(&there, &moved_trajectory(&trajectory, angle, by), Convention::Paper),
            );
            let what = format!("scene {seed}, candidate {k}");
            assert_eq!(a.collision_step, b.collision_step, "{what}");
            assert_eq!((a.feasible, a.violations.len()), (b.feasible, b.violations.len()), "{what}");
            close(b.adversarial_reward, a.adversarial_reward, 1e-6, &what);
            close(b.kinematic_penalty, a.kinematic_penalty, 1e-6, &what);
            close(b.behavior_penalty, a.behavior_penalty, 1e-6, &what);
            close(b.distances.wd_yaw_rate.unwrap(), a.distances.wd_yaw_rate.unwrap(), 1e-6, &what);
            // With coinciding centres no side is hit first.
            let apart = |step: usize| {
                distance(trajectory.points()[step - 1], here.tracks[0].point(NOW + step)) > 0.01
            };
            if a.collision_step.is_some_and(apart) {
                assert_eq!(a.criticality.side_hit, b.criticality.side_hit, "{what}");
            }
        }
    }
    assert!(compared > 550, "only {compared} of 600 compared");
}

#[test]
fn release_does_not_change_when_the_scene_is_moved() {
    for seed in 0..150 {
        let here = scene(seed);
        // A move by powers of two preserves every difference of coordinates to the last bits.
        let by = [4096.0, -2048.0];
        let there = moved(&here, 0.0, by);
        for k in 0..4 {
            let trajectory = candidate(&here, k);
            // The heading of a standing point comes from rounding: 0 here, arbitrary there.
            let stands =
                trajectory.points().windows(2).any(|p| (p[1][0] - p[0][0]).hypot(p[1][1] - p[0][1]) < 1e-4);
            if stands || is_near_tie(&here, &trajectory, Convention::Release) {
                continue;
            }
            let (a, b) = (
                score(&here, &trajectory, Convention::Release),
                score(&there, &moved_trajectory(&trajectory, 0.0, by), Convention::Release),
            );
            let what = format!("scene {seed}, candidate {k}");
            assert_eq!((a.collision_step, a.feasible), (b.collision_step, b.feasible), "{what}");
            close(b.adversarial_reward, a.adversarial_reward, 1e-6, &what);
            close(b.kinematic_penalty, a.kinematic_penalty, 1e-6, &what);
            close(b.behavior_penalty, a.behavior_penalty, 1e-6, &what);
        }
    }
}

#[test]
fn an_encounter_is_the_same_from_both_sides() {
    for seed in 0..100 {
        let scene = Arc::new(scene(seed));
        let index = SceneIndex::new(scene.map.clone());
        let ctx = Context::new(&scene, &index, &ContextOptions::default()).unwrap();
        for k in 0..4 {
            let c = ctx.candidate(candidate(&scene, k));
            let ego: Vec<OrientedBox> = (1..=80).map(|t| *ctx.ego().box_at(t).unwrap()).collect();
            assert_eq!(Encounter::follow(&ego, c.boxes().iter().map(Some)), Encounter::of(&c, ctx.ego()));
        }
    }
}

#[test]
fn the_drivable_rule_finds_every_road_edge_and_agent_that_the_papers_finds() {
    let mut stricter = 0;
    for seed in 0..200 {
        let scene = scene(seed);
        for k in 0..4 {
            let s = score(&scene, &candidate(&scene, k), Convention::Paper);
            for violation in &s.violations {
                let found = s.violations_drivable.iter().find(|r| r.rule == violation.rule);
                // The first step may leave what the box already touches at *now*.
                let earlier = found.is_some_and(|r| r.step <= violation.step);
                assert!(
                    earlier || violation.step == 1,
                    "scene {seed}, candidate {k}: {violation:?} {found:?}"
                );
            }
            stricter += usize::from(s.feasible && !s.feasible_drivable);
        }
    }
    assert!(stricter > 0, "no case distinguishes the rules");
}

#[test]
fn the_distances_of_the_log_from_itself_are_zero() {
    for seed in 0..20 {
        let scene = scene(seed);
        let log =
            Trajectory::new("log", (NOW + 1..=NOW + 80).map(|f| scene.tracks[1].point(f)).collect()).unwrap();
        for convention in [Convention::Paper, Convention::Release] {
            let d = score(&scene, &log, convention).distances;
            assert_eq!((d.wd_speed, d.wd_acceleration, d.wd_yaw_rate), (Some(0.0), Some(0.0), Some(0.0)));
        }
    }
}
