use std::{sync::Arc, time::Instant};
use sage_core::{scene::SceneIndex, seed::Rng};
use sage_sim::{SimScene, environment::*, observation::LENGTH, vehicle::Action};
fn main() {
    let which = std::env::args().nth(1).unwrap();
    let see = std::env::args().nth(2).unwrap() == "obs";
    let mut options = EnvironmentOptions::preset(if which == "all" { "training" } else { &which }).unwrap();
    if which == "all" { let mut w = (*options.world).clone(); w.traffic.parked = true; options.world = Arc::new(w); }
    if std::env::args().nth(3).is_some() { let mut w = (*options.world).clone(); w.whole_physics = true; options.world = Arc::new(w); }
    let options = Arc::new(options);
    let mut scenes = vec![];
    for k in (0..=480).step_by(20) {
        for d in ["pretrain", "dev", "val"] {
            let f = format!("/work/base/data/womd_cat500/{d}/{k}.pkl");
            if std::path::Path::new(&f).is_file() {
                let scene = Arc::new(sage_data::Recording::read(std::path::Path::new(&f)).unwrap().scene);
                let index = SceneIndex::new(scene.map.clone());
                scenes.push(SimScene::new(scene, index).unwrap());
            }
        }
    }
    let mut out = [0.0; LENGTH];
    let mut sum = 0.0;
    for s in &scenes { let _ = Environment::reset(s.clone(), options.clone(), None, 0).unwrap(); s.lines(options.world.lines); }
    let (mut steps, mut resets) = (0, 0);
    let mut reset_time = 0.0;
    let start = Instant::now();
    for round in 0..6u64 {
        for s in &scenes {
            let t = Instant::now();
            let mut env = Environment::reset(s.clone(), options.clone(), None, round).unwrap();
            if see { env.observe(&mut out); }
            reset_time += t.elapsed().as_secs_f64(); resets += 1;
            let mut rng = Rng::new(round, "a", "b");
            while !env.is_over() {
                let a = Action { steer: rng.uniform(-0.1, 0.1), throttle: rng.uniform(-0.3, 0.6) };
                let o = env.step(a).unwrap();
                if see { env.observe(&mut out); sum += f64::from(out[5]); }
                sum += o.reward; steps += 1;
            }
        }
    }
    let t = start.elapsed().as_secs_f64();
    println!("{which} obs {see}: {} scenes {steps} steps {:.0}/s, {:.1} us; reset {:.3} ms ({sum:.1})", scenes.len(), steps as f64 / t, t / steps as f64 * 1e6, reset_time / resets as f64 * 1e3);
}
