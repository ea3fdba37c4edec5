//! Episodes: when they end, what they say of a contact, and when an attack counts.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod driving;
mod hand_made;
mod reference;

use std::sync::Arc;

use driving::policy;
use hand_made::{car, prepared, road, scene};
use sage_core::{
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Scorer, contact_depth},
    scene::{Scene, Track},
    seed::Rng,
};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    drive::{Drive, Simulation, drive},
    episode::{End, Episode},
    traffic::Plan,
};

fn episode(scene: &Arc<SimScene>, plan: Option<Plan>, name: &str) -> Episode {
    Episode::run(scene, plan.map(Arc::new), policy(name).as_ref(), 0).unwrap()
}

fn unattacked(scene: &Arc<SimScene>, name: &str) -> Drive {
    let mut simulation = Simulation::new(scene, &Arc::default(), None, policy(name).as_ref(), 0).unwrap();
    drive(&mut simulation).unwrap()
}

fn on_road(tracks: Vec<Track>) -> Arc<SimScene> {
    prepared(scene(road(), tracks))
}

/// A trajectory from a point with a constant velocity.
fn straight([x, y]: [f64; 2], [vx, vy]: [f64; 2]) -> Trajectory {
    let at = |step: usize| [x + 0.1 * vx * step as f64, y + 0.1 * vy * step as f64];
    Trajectory::new("straight", (1..=HORIZON).map(at).collect()).unwrap()
}

#[test]
fn a_drive_ends_at_the_first_contact_or_at_frame_90() {
    // 10 m/s towards a car whose rear is 40 − 2 × 2.25 = 35.5 m ahead: contact after 3.55 s, in step 36.
    let wall = on_road(vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("wall", [40.0, 0.0], 0.0, 0.0)]);
    let hit = episode(&wall, None, "constant-speed");
    assert_eq!((hit.end, hit.steps(), hit.contacts.len()), (End::Contact, 36, 1));
    let contact = &hit.contacts[0];
    assert!((contact.impact_speed - 10.0).abs() < 1e-9, "{}", contact.impact_speed);
    assert_eq!(contact.class.is_at_fault(), Some(true));

    let mut long = scene(road(), vec![car("ego", [0.0, 0.0], 0.0, 5.0)]);
    long.frames = 120;
    let track = &mut long.tracks[0];
    for frame in 91..120 {
        track.position.push([0.5 * f64::from(frame), 0.0, 0.75]);
        track.heading.push(0.0);
        track.velocity.push([5.0, 0.0]);
        track.size.push([4.5, 2.0, 1.5]);
        track.valid.push(true);
    }
    let free = episode(&prepared(long), None, "replay");
    assert_eq!((free.end, free.steps(), free.contacts.len()), (End::Horizon, 90, 0));
    // The drive and its route end at frame 90, whatever is recorded later: 45 of 45 m, 95 % of them after 42.75 m.
    assert!((free.completion.unwrap() - 1.0).abs() < 1e-9);
    assert_eq!(free.arrived, Some(86));
}

#[test]
fn the_overlap_goes_on_for_half_a_second_after_a_contact() {
    // Through the tyres, straight on at about 10 m/s: the fronts overlap by 0.5 s × 10 m/s = 5 m along, more
    // than the 2 m across, which is then the depth.
    let ahead = on_road(vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("wall", [30.0, 0.0], 0.0, 0.0)]);
    let hit = episode(&ahead, None, "constant");
    assert!((hit.contacts[0].overlap - 2.0).abs() < 0.1, "{}", hit.contacts[0].overlap);
    // Beside, 0.3 m of the widths overlap: a graze stays a graze.
    let beside = on_road(vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("wall", [30.0, 1.7], 0.0, 0.0)]);
    let graze = episode(&beside, None, "constant");
    assert!((graze.contacts[0].overlap - 0.3).abs() < 0.02, "{}", graze.contacts[0].overlap);
    assert!(!graze.contacts[0].is_solid() && hit.contacts[0].is_solid());
}

#[test]
fn an_attack_counts_if_it_causes_the_first_contact() {
    let cut_in = straight([60.0, 0.0], [0.0, 0.0]);
    let tracks = || vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("other", [60.0, 20.0], 0.0, 0.0)];
    let free = on_road(tracks());
    let drive_free = unattacked(&free, "constant-speed");
    let plan = |scene: &SimScene| Some(Plan::of_adversary(scene.scene(), &cut_in).unwrap());
    let hit = episode(&free, plan(&free), "constant-speed");
    let verdict = hit.verdict(1, true, &drive_free);
    assert!(verdict.attack && verdict.at_fault && verdict.solid && verdict.any_vehicle);
    let not_feasible = hit.verdict(1, false, &drive_free);
    assert!(!not_feasible.attack && !not_feasible.solid && not_feasible.any_vehicle);

    // Another car is hit before, with and without the attack.
    let mut blocked = tracks();
    blocked.push(car("wall", [30.0, 0.0], 0.0, 0.0));
    let blocked = on_road(blocked);
    let before = episode(&blocked, plan(&blocked), "constant-speed");
    assert!(!before.verdict(1, true, &unattacked(&blocked, "constant-speed")).attack);

    // The adversary stands there anyway: a contact at the same time is no attack.
    let standing = on_road(vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("other", [60.0, 0.0], 0.0, 0.0)]);
    let same = episode(&standing, plan(&standing), "constant-speed");
    assert_eq!(same.end, End::Contact);
    assert!(!same.verdict(1, true, &unattacked(&standing, "constant-speed")).attack);

    // A contact up to *now* is history, not an attack.
    let early = on_road(vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("other", [10.0, 0.0], 0.0, 0.0)]);
    let history = episode(&early, None, "constant-speed");
    let elsewhere = unattacked(&free, "constant-speed");
    assert!(history.contacts[0].contact.step <= NOW && !history.verdict(1, true, &elsewhere).attack);
}

#[test]
fn drivers_that_react_avoid_what_replay_cannot() {
    let cut_in = straight([60.0, 0.0], [0.0, 0.0]);
    let tracks = || vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("other", [60.0, 20.0], 0.0, 0.0)];
    for (name, hits) in [("replay", true), ("idm", false), ("expert", false)] {
        let scene = on_road(tracks());
        let plan = Plan::of_adversary(scene.scene(), &cut_in).unwrap();
        let attacked = episode(&scene, Some(plan), name);
        assert_eq!(attacked.verdict(1, true, &unattacked(&scene, name)).attack, hits, "{name}");
    }
}

/// The ego's log in place of the adversary's, shifted: it meets the ego in many ways.
fn aimed(scene: &Scene, rng: &mut Rng) -> Trajectory {
    let start = scene.adversary().unwrap().point(NOW);
    let step = 15 + (rng.uniform(0.0, 60.0) as usize);
    let [x, y] = scene.ego().point(NOW + step);
    let share = |k: usize| k as f64 / step as f64;
    let at = |k: usize| [start[0] + share(k) * (x - start[0]), start[1] + share(k) * (y - start[1])];
    Trajectory::new("aimed", (1..=HORIZON).map(at).collect()).unwrap()
}

#[test]
fn a_replayed_ego_meets_the_adversary_as_scored() {
    let mut rng = Rng::new(3, "episode", "aimed");
    let procedural = Kind::ALL.iter().flat_map(|kind| (0..6).filter_map(|n| generate(*kind, 5, n)));
    let mut scenes: Vec<Arc<SimScene>> = procedural.map(prepared).collect();
    scenes.extend(reference::scenes(&["dev", "val"]).into_iter().map(|scene| {
        let index = sage_core::scene::SceneIndex::new(scene.map.clone());
        SimScene::new(scene, index).unwrap()
    }));
    let mut met = 0;
    for simulated in &scenes {
        let scene = simulated.scene();
        let is_usable = scene.adversary().is_ok_and(|adversary| adversary.is_valid(NOW));
        if !is_usable || scene.ego().count_valid(0..NOW + HORIZON + 1) <= NOW + HORIZON {
            continue;
        }
        let attack = aimed(scene, &mut rng);
        let ctx = Context::new(scene, simulated.index(), &ContextOptions::default()).unwrap();
        let candidate = ctx.candidate(attack.clone());
        let scores = Scorer::new(&ctx).scores(&candidate);
        let plan = Plan::of_adversary(scene, &attack).unwrap();
        let driven = episode(simulated, Some(plan), "replay");
        let adversary = scene.adversary_index().unwrap();
        let hit = driven.contacts.iter().find(|c| c.contact.other.track == adversary);
        assert_eq!(hit.map(|c| c.contact.step - NOW), scores.collision_step, "{}", scene.id);
        let Some(hit) = hit else { continue };
        met += 1;
        let criticality = &scores.criticality;
        assert!((hit.impact_speed - criticality.impact_speed.unwrap()).abs() < 1e-6, "{}", scene.id);
        assert_eq!(Some(hit.side_hit), criticality.side_hit, "{}", scene.id);
        assert!((hit.overlap - contact_depth(&candidate, ctx.ego())).abs() < 1e-6, "{}", scene.id);
    }
    assert!(met > 15, "{met} of {} meet", scenes.len());
}
