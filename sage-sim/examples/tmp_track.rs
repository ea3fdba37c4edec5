use std::sync::Arc;
use sage_core::scene::SceneIndex;
use sage_sim::{SimScene, drive::*, policy::policies, world::WorldOptions};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let mut files: Vec<_> = args[1..].iter().flat_map(|d| std::fs::read_dir(d).unwrap().map(|e| e.unwrap().path())).filter(|p| p.extension().is_some_and(|e| e == "pkl") && !p.file_name().unwrap().to_str().unwrap().starts_with("dataset")).collect();
    files.sort();
    let policy = policies().unwrap().build_default("tracking").unwrap();
    let (mut ok, mut all) = (0, 0);
    let mut rows = vec![];
    for f in &files {
        let scene = Arc::new(sage_data::Recording::read(f).unwrap().scene);
        let index = SceneIndex::new(scene.map.clone());
        let sim = SimScene::new(scene.clone(), index.clone()).unwrap();
        let mut s = Simulation::new(&sim, &Arc::new(WorldOptions::default()), None, policy.as_ref(), 0).unwrap();
        let d = drive(&mut s, Until::EndOfLog).unwrap();
        let (mut k, mut n, mut worst) = (0, 0, 0.0f64);
        for (m, frame) in d.motions.iter().zip(0..) { if scene.ego().is_valid(frame) { let e = sage_core::geometry::distance(m.position, scene.ego().point(frame)); n += 1; k += usize::from(e <= 0.5); worst = worst.max(e); } }
        ok += k; all += n;
        if k < n { rows.push((n - k, worst, f.file_stem().unwrap().to_str().unwrap().to_owned(), sim.route().length())); }
    }
    rows.sort_by(|a, b| b.0.cmp(&a.0));
    println!("{ok} of {all} = {:.4}; {} scenes with shortfalls: {:?}", ok as f64 / all as f64, rows.len(), &rows[..rows.len().min(25)]);
}
