//! When a plan begins to be seen.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::sync::Arc;

use sage_core::{
    geometry::norm,
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions},
    scene::SceneIndex,
};
use sage_data::procedural::{Kind, generate};
use sage_sim::search::onset::onset;

#[test]
fn a_plan_is_seen_where_it_departs_from_both_predictions() {
    let mut measured = 0;
    for (seed, kind) in
        (0..8).zip([Kind::Straight, Kind::Curve, Kind::Merge, Kind::FourWay].into_iter().cycle())
    {
        let Some(scene) = generate(kind, seed, 0) else { continue };
        let scene = Arc::new(scene);
        let ctx =
            Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default()).unwrap();
        let track = scene.adversary().unwrap();
        let ([x, y], [vx, vy]) = (track.point(NOW), track.velocity[NOW]);
        let speed = norm([vx, vy]);
        if speed < 5.0 {
            continue;
        }
        measured += 1;
        let plan = |at: &dyn Fn(f64) -> f64| {
            let point = |step: usize| {
                let along = at(0.1 * step as f64);
                [x + along * vx / speed, y + along * vy / speed]
            };
            ctx.candidate(Trajectory::new("plan", (1..=HORIZON).map(point).collect()).unwrap())
        };
        assert_eq!(onset(&plan(&|t| speed * t), &ctx, HORIZON), 0.0, "it never departs");
        // Braking by 4 m/s² departs by 2 t², more than 1.63 t^1.75 from 0.44 s on: if a lane bends, not later than that.
        let brakes = plan(&|t| speed * t - 2.0 * t * t);
        let seen = onset(&brakes, &ctx, HORIZON);
        assert!(seen > 0.0 && seen < 0.75, "{kind:?} {seed}: {seen}");
        // Only what happens before the contact counts.
        assert_eq!(onset(&brakes, &ctx, 2), 0.0);
        // Milder braking is what others do too, at first.
        let mild = onset(&plan(&|t| speed * t - 0.5 * t * t), &ctx, 20);
        assert_eq!(mild, 0.0);
    }
    assert!(measured > 2, "{measured} scenes");
}
