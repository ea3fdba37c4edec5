#![allow(clippy::unwrap_used, clippy::print_stderr)]
mod hand_made;
mod reference;
use hand_made::{car, prepared, road, scene};
use sage_core::scene::*;
use sage_sim::{SimScene, drive::*, policy::policies, red_lights::*};
use serde_json::json;
use std::sync::Arc;
fn lit(speed: f64, stop: f64, red: std::ops::Range<usize>) -> Arc<SimScene> {
    let mut s = scene(road(), vec![car("ego", [0.0, 0.0], 0.0, speed)]);
    let states = (0..91).map(|f| if red.contains(&f) { LightState::Stop } else { LightState::Go }).collect();
    s.lights = vec![TrafficLight { lane: "lane".into(), stop_point: Some([stop, 0.0, 0.0]), states }];
    prepared(s)
}
#[test]
fn sweep() {
    for name in ["idm", "expert", "pdm"] {
        let p = policies().unwrap().build_default(name).unwrap();
        for v in [0.0, 0.3, 0.6, 1.0, 2.0, 3.0, 5.0, 8.0, 10.0, 13.0, 15.0, 20.0] {
            let mut line = String::new();
            let mut lasts = vec![];
            for k in 0..400 {
                let gap = 0.1 + 0.25 * k as f64;
                let s = lit(v, gap + 2.25, 0..91);
                let d =
                    drive(&mut Simulation::new(&s, &Arc::default(), None, p.as_ref(), 0).unwrap()).unwrap();
                let end = d.motions[90];
                let over = over_red(&s, &d.motions).map(|o| o.len());
                let past = end.position[0] - gap;
                lasts.push((gap, over, past, end.speed()));
            }
            // first gap at which it stops; and worst overshoot after
            let first = lasts.iter().position(|(_, o, _, _)| *o == Some(0)).unwrap_or(400);
            let bad: Vec<_> =
                lasts[first.min(399)..].iter().filter(|(_, o, _, _)| *o != Some(0)).map(|l| l.0).collect();
            let worst = lasts[first.min(399)..]
                .iter()
                .filter(|l| l.3 < 0.1)
                .map(|l| l.2)
                .fold(f64::NEG_INFINITY, f64::max);
            let mean = lasts[first.min(399)..]
                .iter()
                .filter(|l| l.3 < 0.1)
                .map(|l| l.2)
                .fold(f64::INFINITY, f64::min);
            line += &format!(
                "first {:.2} bad {bad:?} worst past {worst:.2} least {mean:.2} n standing {}",
                lasts.get(first).map_or(-1.0, |l| l.0),
                lasts.iter().filter(|l| l.3 < 0.1).count()
            );
            eprintln!("{name} v {v}: {line}");
        }
    }
}
#[test]
fn real() {
    let (mut n, mut lights, mut over, mut logged) = (0, 0, vec![], 0);
    let (mut past, mut wait) = (vec![], vec![]);
    for s in reference::scenes(&["pretrain", "dev", "val"]) {
        let index = SceneIndex::new(s.map.clone());
        let s = SimScene::new(s, index).unwrap();
        n += 1;
        let p = policies().unwrap().build_default("replay").unwrap();
        let d = drive(&mut Simulation::new(&s, &Arc::default(), None, p.as_ref(), 0).unwrap()).unwrap();
        let o = over_red(&s, &d.motions);
        if let Some(o) = o {
            lights += 1;
            if !o.is_empty() {
                over.push((s.scene().id.clone(), o));
            }
        }
        let area = sage_core::geometry::OrientedBox::new(
            d.motions[0].position,
            d.motions[0].heading,
            s.ego_size()[0],
            s.ego_size()[1],
        );
        let f = s.guide().locate(front(&area), Default::default()).along;
        for st in s.lights().stops() {
            let l = &s.scene().lights[st.light];
            if st.along <= s.route().length() + 10.0 && st.along > f {
                logged += 1;
            }
            let red0 = l.states[0].is_red();
            if red0 && st.along <= f && st.along > f - 6.0 {
                past.push(((st.along - f) * 10.0).round() / 10.0);
                eprintln!(
                    "past {} {:.1} v {:.2} progress {:.1}",
                    s.scene().id,
                    st.along - f,
                    d.motions[0].speed(),
                    d.progress
                );
            }
            if l.states[90].is_red() && d.motions[90].speed() < 0.3 {
                let area = sage_core::geometry::OrientedBox::new(
                    d.motions[90].position,
                    d.motions[90].heading,
                    s.ego_size()[0],
                    s.ego_size()[1],
                );
                let e = s.guide().locate(front(&area), Default::default()).along;
                let g = st.along - e;
                if g > -8.0 && g < 15.0 {
                    wait.push((g * 10.0).round() / 10.0);
                }
            }
        }
    }
    wait.sort_by(f64::total_cmp);
    eprintln!(
        "n {n} with lights ahead {lights} on the logged route {logged} over {} {over:?}\npast {past:?}\nwait {wait:?}",
        over.len()
    );
}
