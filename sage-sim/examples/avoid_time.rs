use sage_core::{motion::*, objective::*, scene::SceneIndex};
use sage_sim::avoidable::*;
use std::{sync::Arc, time::Instant};
fn main() {
    let dir = std::env::args().nth(1).unwrap();
    let mut times = vec![];
    let mut preps = vec![];
    for f in std::fs::read_dir(dir).unwrap() {
        let p = f.unwrap().path();
        if p.extension().is_none_or(|e| e != "pkl") || p.to_string_lossy().contains("dataset") {
            continue;
        }
        let Ok(r) = sage_data::Recording::read(&p) else { continue };
        let scene = Arc::new(r.scene);
        if !scene.adversary().is_ok_and(|a| a.is_valid(NOW)) {
            continue;
        }
        let index = SceneIndex::new(scene.map.clone());
        index.build_all();
        let Ok(ctx) = Context::new(&scene, &index, &ContextOptions::default()) else { continue };
        let from = ctx.adversary().point(NOW);
        for step in [15usize, 30, 50] {
            let to = ctx.ego().positions()[step - 1];
            let at = |k: usize| {
                let s = k as f64 / step as f64;
                [from[0] + s * (to[0] - from[0]), from[1] + s * (to[1] - from[1])]
            };
            let c = ctx.candidate(Trajectory::new("s", (1..=HORIZON).map(at).collect()).unwrap());
            let t = Instant::now();
            let a = Avoidance::new(&ctx, AvoidanceOptions::default()).unwrap();
            let prep = t.elapsed().as_secs_f64() * 1e3;
            let out = a.of(&c);
            if out.avoidable.is_some() {
                preps.push(prep);
                times.push((
                    t.elapsed().as_secs_f64() * 1e3,
                    scene.id.clone(),
                    out.time_to_react,
                    out.time_to_brake,
                    out.time_to_steer,
                ));
            }
        }
    }
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    preps.sort_by(f64::total_cmp);
    println!(
        "{} median {:.2} p90 {:.2} max {:.2}; prep median {:.3}",
        times.len(),
        times[times.len() / 2].0,
        times[times.len() * 9 / 10].0,
        times[times.len() - 1].0,
        preps[preps.len() / 2]
    );
    for t in times.iter().rev().take(4) {
        println!("{t:?}");
    }
}
