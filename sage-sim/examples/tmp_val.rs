use std::sync::Arc;
use sage_core::scene::SceneIndex;
use sage_sim::{SimScene, drive::*, fault, policy::policies, world::WorldOptions};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let verbose = args.len() > 3;
    let mut files: Vec<_> = std::fs::read_dir(&args[1]).unwrap().map(|e| e.unwrap().path()).filter(|p| p.extension().is_some_and(|e| e == "pkl") && !p.file_name().unwrap().to_str().unwrap().starts_with("dataset")).collect();
    files.sort();
    let registry = policies().unwrap();
    for name in args[2].split(',') {
        let (n, o) = name.find('{').map_or((name, "{}"), |k| name.split_at(k));
        let policy = registry.build(n, &serde_json::from_str(o).unwrap()).unwrap();
        let (mut count, mut any, mut vehicle, mut fault_n, mut unknown, mut off, mut errors) = (0, 0, 0, 0, 0, 0, 0);
        let mut completion = vec![];
        let start = std::time::Instant::now();
        let mut steps = 0;
        for f in &files {
            let scene = Arc::new(sage_data::Recording::read(f).unwrap().scene);
            let index = SceneIndex::new(scene.map.clone());
            let sim = match SimScene::new(scene.clone(), index.clone()) { Ok(s) => s, Err(e) => { println!("{e}"); errors += 1; continue } };
            let mut s = match Simulation::new(&sim, &Arc::new(WorldOptions::default()), None, policy.as_ref(), 0) { Ok(s) => s, Err(e) => { println!("{e}"); errors += 1; continue } };
            let d = match drive(&mut s, Until::EndOfLog) { Ok(d) => d, Err(e) => { println!("{e}"); errors += 1; continue } };
            steps += d.motions.len() - 1;
            count += 1;
            let classes: Vec<_> = d.contacts.iter().map(|c| fault::classify(c, s.world().car(), &index)).collect();
            any += usize::from(!d.contacts.is_empty());
            vehicle += usize::from(d.first_vehicle().is_some());
            let at_fault = classes.iter().any(|c| c.is_at_fault() == Some(true));
            fault_n += usize::from(at_fault);
            unknown += usize::from(classes.iter().any(|c| c.is_at_fault().is_none()));
            off += usize::from(d.off_road.is_some());
            let log = sim.route().length();
            let last = (0..scene.frames).rev().find(|&k| scene.ego().valid[k]).unwrap_or(0);
            let _ = last;
            if log > 5.0 { completion.push(d.progress / log); }
            if verbose && d.off_road.is_some() { let k = d.off_road.unwrap(); let m = d.motions[k]; let c = sim.guide().locate(m.position, sage_sim::route::Localization::Nearest); println!("  {} off road at {k}: v {:.1} along {:.1} of {:.1} across {:.2} start v {:.1}", f.file_stem().unwrap().to_str().unwrap(), m.speed(), c.along, sim.route().length(), c.across, d.motions[0].speed()); }
            if verbose && !d.contacts.is_empty() {
                for (c, k) in d.contacts.iter().zip(&classes) {
                    println!("  {} step {} v {:.1} with {} ({:?}) v {:.1} {k:?}", f.file_stem().unwrap().to_str().unwrap(), c.step, c.car.speed(), scene.tracks[c.other.track].id, c.other.kind, c.other.speed());
                }
            }
        }
        completion.sort_by(f64::total_cmp);
        println!("{name:<20} n {count} errors {errors} contact {any} vehicle {vehicle} at fault {fault_n} unknown {unknown} off-road {off} completion median {:.3} p25 {:.3} {:.1}s {steps}", completion[completion.len()/2], completion[completion.len()/4], start.elapsed().as_secs_f64());
    }
}
