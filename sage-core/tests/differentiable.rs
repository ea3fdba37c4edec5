//! Smooth surrogates of rewards: published values, gradients against differences, and order.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;
mod scenes;

use std::sync::Arc;

use approx::assert_relative_eq;
use hand_made::{car, road};
use sage_core::{
    motion::{DT, Pose},
    objective::{
        Clearance, Context, ContextOptions, DifferentiableReward, EgoPaths, Encounter, PoseGradient,
        SmoothAdversarial, SmoothObjective, SmoothRealism,
    },
    scene::{Scene, SceneIndex},
    seed::Rng,
    statistics::rank_correlation,
};

fn context(scene: Scene, ego: Option<EgoPaths>) -> Context {
    let index = SceneIndex::new(scene.map.clone());
    Context::new(&Arc::new(scene), &index, &ContextOptions { ego, ..ContextOptions::default() }).unwrap()
}

fn poses(at: impl Fn(f64) -> [f64; 2], heading: f64) -> Vec<Pose> {
    (0..80).map(|k| Pose { position: at(f64::from(k)), heading }).collect()
}

fn value_of(reward: &dyn DifferentiableReward, poses: &[Pose], ctx: &Context) -> f64 {
    reward.value(poses, ctx, &mut PoseGradient::zeros(poses.len()))
}

#[test]
fn the_adversarial_stand_in_has_its_published_values() {
    // The ego drives at 5 m/s from x = 10 m, the adversary at 10 m/s beside it.
    let mut scene = road(car("adversary", [0.0, 1.0], [10.0, 0.0]), vec![]);
    scene.tracks[0].size.fill([4.5, 1.9, 1.5]);
    scene.tracks[1].size.fill([4.8, 2.0, 1.5]);
    let path = (0..80).map(|k| [10.0 + 0.5 * f64::from(k), 0.0]).collect();
    let ctx = context(scene, Some(EgoPaths::one("ego", path, Some(vec![0.0; 80])).unwrap()));
    for (aside, expected) in [
        (1.0, [8.606551, 8.702193, 8.702193]),
        (4.0, [0.425632, 3.142791, 3.034149]),
        (30.0, [0.002361, 0.002361, -1.400139]),
    ] {
        let poses = poses(|k| [k, aside], 0.0);
        let options = [[0.1, 0.0], [0.5, 0.0], [0.5, 0.05]];
        for ([softness, pull], expected) in options.into_iter().zip(expected) {
            let found = value_of(&SmoothAdversarial { softness, pull }, &poses, &ctx);
            assert_relative_eq!(found, expected, epsilon = 2e-6);
        }
    }
}

#[test]
fn the_realism_stand_in_has_its_published_values() {
    let ctx = context(road(car("adversary", [0.0, 1.0], [10.0, 0.0]), vec![]), None);
    let straight = value_of(&SmoothRealism, &poses(|k| [k, 0.0], 0.0), &ctx);
    assert_relative_eq!(straight, 2.086031, epsilon = 1e-6);
    let swaying = poses(|k| [6.0 * (0.075 * k).sin(), 0.8 * k], 0.0);
    assert_relative_eq!(value_of(&SmoothRealism, &swaying, &ctx), 2.752676, epsilon = 1e-6);
}

#[test]
fn clearance_counts_what_is_missing() {
    // Edges at y = ±8 m; discs of 1.1 m and 0.3 m of space.
    let ctx = context(road(car("adversary", [50.0, 0.0], [0.0, 0.0]), vec![]), None);
    let at = |y: f64| value_of(&Clearance::default(), &poses(|_| [50.0, y], 0.0), &ctx);
    assert_eq!(at(0.0), 0.0);
    assert_eq!(at(6.5), 0.0);
    assert_relative_eq!(at(7.0), 80.0 * 0.4, epsilon = 1e-9);
    let parked = car("parked", [56.0, 0.0], [0.0, 0.0]);
    let ctx = context(road(car("adversary", [50.0, 0.0], [0.0, 0.0]), vec![parked]), None);
    // Outermost discs at 1.52 m of 50 m and −1.32 m of 56 m: 3.16 m apart, 2.5 m asked for.
    let at = |x: f64| value_of(&Clearance::default(), &poses(|_| [x, 0.0], 0.0), &ctx);
    assert_eq!(at(50.0), 0.0);
    assert_relative_eq!(at(51.0), 80.0 * (2.5 - 2.16), epsilon = 1e-9);
}

/// A seeded trajectory that turns and changes speed, near the scene's own.
fn seeded(scene: &Scene, rng: &mut Rng) -> Vec<Pose> {
    let start = scene.tracks[1].position[10];
    let mut pose = Pose { position: [start[0], start[1]], heading: scene.tracks[1].heading[10] };
    let (mut speed, mut yaw_rate) = (rng.uniform(0.5, 12.0), rng.uniform(-0.4, 0.4));
    (0..80)
        .map(|_| {
            speed = (speed + DT * rng.uniform(-6.0, 6.0)).max(0.1);
            yaw_rate += DT * rng.uniform(-1.0, 1.0);
            pose.heading += DT * yaw_rate;
            pose.position[0] += DT * speed * pose.heading.cos();
            pose.position[1] += DT * speed * pose.heading.sin();
            pose
        })
        .collect()
}

#[test]
fn gradients_are_those_of_differences() {
    let terms: [&dyn DifferentiableReward; 3] =
        [&SmoothAdversarial::default(), &SmoothRealism, &Clearance { space: 0.8 }];
    let (mut checked, mut kinks) = (0, 0);
    for seed in 0..12 {
        let scene = scenes::scene(seed);
        let mut rng = Rng::new(seed, "differentiable", "poses");
        let mut poses = seeded(&scene, &mut rng);
        // Half of them meet the ego.
        if seed % 2 == 0 {
            let ego = &scene.tracks[0];
            for (k, pose) in poses.iter_mut().enumerate().skip(30) {
                let share = ((k - 30) as f64 / 25.0).min(1.0);
                let target = ego.position[(11 + k).min(90)];
                (0..2).for_each(|i| pose.position[i] += share * (target[i] - pose.position[i]));
            }
        }
        let ctx = context(scene, None);
        for term in terms {
            let mut gradient = PoseGradient::zeros(80);
            term.value(&poses, &ctx, &mut gradient);
            for _ in 0..40 {
                let (k, axis) = (rng.below(80), rng.below(3));
                let found = if axis == 2 { gradient.heading[k] } else { gradient.position[k][axis] };
                let moved = |by: f64| {
                    let mut poses = poses.clone();
                    if axis == 2 {
                        poses[k].heading += by
                    } else {
                        poses[k].position[axis] += by
                    }
                    value_of(term, &poses, &ctx)
                };
                let slope = |h: f64| (moved(h) - moved(-h)) / (2.0 * h);
                let [coarse, fine] = [slope(1e-5), slope(5e-6)];
                let scale = 1.0 + fine.abs();
                // Where an axis or a disc changes, one-sided slopes differ.
                if (coarse - fine).abs() > 1e-5 * scale {
                    kinks += 1;
                    continue;
                }
                assert!(
                    (found - fine).abs() < 2e-5 * scale,
                    "{} {seed} {k} {axis}: {found} {fine}",
                    term.name()
                );
                checked += 1;
            }
        }
    }
    assert!(checked > 1300 && kinks < 40, "{checked} checked, {kinks} at kinks");
}

#[test]
fn the_stand_in_orders_trajectories_as_the_reward_does() {
    let (mut agreeing, mut compared, mut correlations) = (0, 0, Vec::new());
    for seed in 0..30 {
        let scene = scenes::scene(100 + seed);
        let mut rng = Rng::new(seed, "differentiable", "order");
        let ego = scene.tracks[0].clone();
        let ctx = context(scene.clone(), None);
        let (mut exact, mut smooth) = (Vec::new(), Vec::new());
        for n in 0..28 {
            let mut poses = seeded(&scene, &mut rng);
            if n % 2 == 0 {
                // Towards the ego, and away from it again.
                let (meets, share) = (rng.below(60) + 15, rng.unit());
                for (k, pose) in poses.iter_mut().enumerate() {
                    let near = share * (1.0 - (k as f64 - meets as f64).abs() / 15.0).max(0.0);
                    let target = ego.position[11 + k];
                    (0..2).for_each(|i| pose.position[i] += near * (target[i] - pose.position[i]));
                }
            }
            let points = poses.iter().map(|pose| pose.position).collect();
            let candidate = ctx.candidate(sage_core::motion::Trajectory::new("order", points).unwrap());
            exact.push(Encounter::of(&candidate, ctx.ego()).reward(ctx.convention()));
            let own: Vec<Pose> = candidate
                .boxes()
                .iter()
                .map(|area| Pose { position: area.center, heading: area.axis[1].atan2(area.axis[0]) })
                .collect();
            smooth.push(value_of(&SmoothAdversarial { softness: 0.1, pull: 0.0 }, &own, &ctx));
        }
        correlations.push(rank_correlation(&exact, &smooth));
        for a in 0..28 {
            for b in 0..a {
                if (exact[a] - exact[b]).abs() > 0.2 {
                    compared += 1;
                    agreeing += usize::from((exact[a] > exact[b]) == (smooth[a] > smooth[b]));
                }
            }
        }
    }
    let mean = correlations.iter().sum::<f64>() / correlations.len() as f64;
    let share = f64::from(agreeing as u32) / f64::from(compared as u32);
    assert!(mean > 0.97 && share > 0.985 && compared > 500, "{mean} {share} {compared}");
}

#[test]
fn a_term_that_is_not_finite_is_named() {
    struct Broken;
    impl DifferentiableReward for Broken {
        fn name(&self) -> &str {
            "broken"
        }

        fn value(&self, _: &[Pose], _: &Context, gradient: &mut PoseGradient) -> f64 {
            gradient.heading[3] = f64::NAN;
            1.0
        }
    }
    let ctx = context(road(car("adversary", [0.0, 1.0], [10.0, 0.0]), vec![]), None);
    let mut objective = SmoothObjective::new(vec![(1.0, Box::new(SmoothRealism)), (0.0, Box::new(Broken))]);
    let mut gradient = PoseGradient::default();
    assert!(objective.value(&poses(|k| [k, 0.0], 0.0), &ctx, &mut gradient).is_ok());
    let mut objective = SmoothObjective::new(vec![(0.1, Box::new(Broken))]);
    assert_eq!(objective.value(&poses(|k| [k, 0.0], 0.0), &ctx, &mut gradient), Err("broken".to_owned()));
}
