//! How well goals cover where recorded vehicles are after eight seconds.
use sage_backbones::features::Features;
use sage_core::{
    motion::NOW,
    scene::{SceneIndex, TrackKind},
};
fn main() {
    let dirs: Vec<String> = std::env::args().skip(1).collect();
    let mut rows = vec![];
    let mut time = 0.0;
    let mut calls = 0;
    for d in dirs {
        let mut files: Vec<_> = std::fs::read_dir(&d).unwrap().map(|e| e.unwrap().path()).collect();
        files.sort();
        for f in files {
            let scene = sage_data::Recording::read(&f).unwrap().scene;
            let index = SceneIndex::new(scene.map.clone());
            index.motor_lanes();
            for (k, t) in scene.tracks.iter().enumerate() {
                if t.kind != TrackKind::Vehicle || !t.is_valid(NOW) || !t.is_valid(90) {
                    continue;
                }
                let d = sage_core::geometry::distance(t.point(NOW), t.point(90));
                let interest = k == scene.ego || Some(k) == scene.adversary;
                if d < 4.0 && !interest {
                    continue;
                }
                let s = std::time::Instant::now();
                let feat = Features::of(&scene, &index, k).unwrap();
                time += s.elapsed().as_secs_f64();
                calls += 1;
                let e = feat.frame.to_local(t.point(90));
                let near = feat
                    .goals
                    .iter()
                    .enumerate()
                    .map(|(k, g)| ((g[0] as f64 - e[0]).hypot(g[1] as f64 - e[1]), k))
                    .fold((1e9, 0), |a, b| if b.0 < a.0 { b } else { a });
                let gf = feat.goal_features.row(near.1);
                rows.push((
                    near.0,
                    feat.modes(),
                    feat.speed(),
                    e,
                    interest,
                    gf[16],
                    gf[18] * 2.0,
                    gf[5] * 2.0,
                    gf[19],
                    f.display().to_string(),
                ));
            }
        }
    }
    let n = rows.len() as f64;
    for interest in [false, true] {
        let sel: Vec<_> = rows.iter().filter(|r| !interest || r.4).collect();
        let n = sel.len() as f64;
        println!(
            "n {} within2 {:.3} within4 {:.3} reachable {:.3} onroute-nochange {:.3}",
            n,
            sel.iter().filter(|r| r.0 <= 2.0).count() as f64 / n,
            sel.iter().filter(|r| r.0 <= 4.0).count() as f64 / n,
            sel.iter().filter(|r| r.5 > 0.0).count() as f64 / n,
            sel.iter().filter(|r| r.5 > 0.0 && r.8 == 0.0).count() as f64 / n
        );
    }
    let mut g: Vec<_> = rows.iter().map(|r| r.1).collect();
    g.sort();
    println!(
        "goals 5/50/95/max {} {} {} {}",
        g[(n * 0.05) as usize],
        g[(n * 0.5) as usize],
        g[(n * 0.95) as usize],
        g[g.len() - 1]
    );
    println!("featurise {:.3} ms", time / calls as f64 * 1e3);
    for r in rows.iter().filter(|r| r.0 > 4.0).take(25) {
        println!("miss {:.1} goals {} v {:.1} end {:.0} {:.0} {}", r.0, r.1, r.2, r.3[0], r.3[1], r.9);
    }
    // error stats of straight vs route distance
    for (lo, hi) in [(0.0, 1.0), (1.0, 5.0), (5.0, 10.0), (10.0, 15.0), (15.0, 40.0)] {
        let mut a: Vec<f32> =
            rows.iter().filter(|r| r.2 >= lo && r.2 < hi && r.5 > 0.0).map(|r| r.6).collect();
        a.sort_by(f32::total_cmp);
        if a.len() > 10 {
            println!(
                "v {lo}-{hi} n {} route acc 2/10/50/90/98 % {:.2} {:.2} {:.2} {:.2} {:.2}",
                a.len(),
                a[a.len() / 50],
                a[a.len() / 10],
                a[a.len() / 2],
                a[a.len() * 9 / 10],
                a[a.len() * 49 / 50]
            );
        }
        let mut y: Vec<f64> = rows.iter().filter(|r| r.2 >= lo && r.2 < hi).map(|r| r.3[1].abs()).collect();
        y.sort_by(f64::total_cmp);
        if y.len() > 10 {
            println!(
                "   |y| 90/98/max {:.1} {:.1} {:.1}",
                y[y.len() * 9 / 10],
                y[y.len() * 49 / 50],
                y[y.len() - 1]
            );
        }
    }
}
