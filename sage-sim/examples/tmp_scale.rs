use std::{sync::Arc, time::Instant};
use sage_core::scene::SceneIndex;
use sage_sim::{SimScene, environment::*};
fn main() {
    let options = Arc::new(EnvironmentOptions::training());
    let mut scenes = vec![];
    for f in sage_data::folder::scene_files(std::path::Path::new("/work/base/data/womd_cat500/val")).unwrap().iter().take(20) {
        let scene = Arc::new(sage_data::Recording::read(f).unwrap().scene);
        let index = SceneIndex::new(scene.map.clone());
        let s = SimScene::new(scene, index).unwrap(); s.lines(options.world.lines); scenes.push(s);
    }
    let go = |threads: usize, n: usize, per: usize| {
        let start = Instant::now();
        std::thread::scope(|sc| for t in 0..threads { let (scenes, options) = (scenes.clone(), options.clone()); sc.spawn(move || {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            pool.install(|| {
            let mut b = Batch::new(scenes, options, AutoReset::SameStep, n, t as u64).unwrap();
            let mut out = BatchOutput::default();
            let a = vec![[0.02f32, 0.2]; n];
            for _ in 0..per { b.step(&a, &mut out).unwrap(); } });
        }); });
        start.elapsed().as_secs_f64() / (threads * n * per) as f64 * 1e6
    };
    for _ in 0..3 { println!("separate: 1 thread {:.2} us, 2 threads {:.2} us", go(1, 64, 200), go(2, 64, 200)); }
    for threads in [1, 2, 1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut b = Batch::new(scenes.clone(), options.clone(), AutoReset::SameStep, 64, 0).unwrap();
        let mut out = BatchOutput::default();
        let a = vec![[0.02f32, 0.2]; 64];
        let start = Instant::now();
        for _ in 0..200 { pool.install(|| b.step(&a, &mut out)).unwrap(); }
        let outer = start.elapsed().as_secs_f64() / (64. * 200.) * 1e6;
        let start = Instant::now();
        pool.install(|| for _ in 0..200 { b.step(&a, &mut out).unwrap(); });
        println!("pool {threads}: {outer:.2} us; inside {:.2}", start.elapsed().as_secs_f64() / (64. * 200.) * 1e6);
    }
}
