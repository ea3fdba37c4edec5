//! What is made of odd scenes after they are read: contacts by level, cars that reverse, gaps, trailers, short recordings.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

#[path = "../../sage-data/tests/odd_scenes/mod.rs"]
mod odd;

use std::{path::Path, sync::Arc};

use odd::OddScene;
use sage_core::{
    geometry::{Point, distance, wrap_angle},
    motion::{HORIZON, NOW, Trajectory},
    objective::{
        Candidate, Clearance, Context, ContextOptions, Convention, DifferentiableReward, EgoPaths, Encounter,
        Feasibility, MapFeasibility, PoseGradient, contact_depth, feasibilities,
    },
    scene::{Hitch, Scene, SceneIndex},
    seed::Rng,
};
use sage_data::{ReadOptions, Recording};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    avoidable::{Avoidance, AvoidanceOptions},
    episode::Episode,
    fault::FaultClass,
    policy::policies,
    traffic::Plan,
};

fn read(scene: &OddScene) -> Scene {
    let options = ReadOptions { now: scene.now(), rate: scene.rate(), ..ReadOptions::default() };
    let path = format!("odd.{}", scene.ending());
    let read = Recording::from_bytes_as(Path::new(&path), scene.bytes(), &options);
    read.unwrap_or_else(|error| panic!("{}: {error}", scene.describe())).scene
}

fn odd(parameter: &str, value: &str, adversary: &str) -> Scene {
    read(&OddScene::plain().with(parameter, value)).with_roles(None, Some(adversary)).unwrap()
}

fn context(scene: &Scene) -> Context {
    let index = SceneIndex::new(scene.map.clone());
    Context::new(&Arc::new(scene.clone()), &index, &ContextOptions::default()).unwrap()
}

fn simulated(scene: &Scene) -> Arc<SimScene> {
    SimScene::new(Arc::new(scene.clone()), SceneIndex::new(scene.map.clone())).unwrap()
}

fn plan(at: impl Fn(usize) -> Point) -> Trajectory {
    Trajectory::new("plan", (1..=HORIZON).map(at).collect()).unwrap()
}

/// The adversary's recording as its plan.
fn recorded(scene: &Scene) -> Trajectory {
    let track = scene.adversary().unwrap();
    let last = scene.frames - 1;
    plan(|step| track.point((NOW + step).min(last)))
}

/// The adversary straight to where the recorded ego is at a step.
fn towards_ego(scene: &Scene, meets: usize) -> Trajectory {
    let (from, to) = (scene.adversary().unwrap().point(NOW), scene.ego().point(NOW + meets));
    plan(|step| [0, 1].map(|k| from[k] + step as f64 / meets as f64 * (to[k] - from[k])))
}

fn rules(candidate: &Candidate, ctx: &Context, name: &str) -> Vec<String> {
    let rule = feasibilities().unwrap().build_default(name).unwrap();
    rule.violations(candidate, ctx).into_iter().map(|violation| violation.rule.into_owned()).collect()
}

fn driven(scene: &Scene, ego: &str, trajectory: Option<&Trajectory>) -> Episode {
    let plan = trajectory.map(|trajectory| Arc::new(Plan::of_adversary(scene, trajectory).unwrap()));
    let policy = policies().unwrap().build_default(ego).unwrap();
    Episode::run(&simulated(scene), plan, &*policy, 0).unwrap()
}

#[test]
fn a_car_on_a_bridge_is_no_contact_for_anybody() {
    for value in ["over-6m", "under-6m", "over-4m"] {
        let scene = odd("level", value, "c");
        let ctx = context(&scene);
        let candidate = ctx.candidate(recorded(&scene));
        let ego = ctx.ego();
        let overlap =
            candidate.boxes().iter().zip(ego.boxes()).any(|(a, e)| a.intersects(e.as_ref().unwrap()));
        assert!(overlap, "{value}: they meet in the plane");
        assert_eq!(Encounter::of(&candidate, ego).contact, None, "{value}");
        assert_eq!(contact_depth(&candidate, ego), 0.0, "{value}");
        // The same by a given path, whose heights are those of its lanes.
        let path = EgoPaths::one("ego", ego.positions().to_vec(), None).unwrap();
        let given = ctx.with_ego(&path).unwrap();
        assert_eq!(Encounter::of(&candidate, given.ego()).contact, None, "{value}");
        let beside = odd("level", value, "a");
        let met = context(&beside).with_ego(&path).unwrap();
        let attack = met.candidate(towards_ego(&beside, 40));
        assert!(Encounter::of(&attack, met.ego()).contact.is_some(), "{value}: they are on one level");
        // The road above has neither edges nor traffic of the road below.
        assert_eq!(rules(&candidate, &ctx, "paper"), rules(&candidate, &ctx, "drivable"), "{value}");
        assert!(!rules(&candidate, &ctx, "paper").contains(&"road_edge".to_owned()), "{value}");
        let contacts = driven(&scene, "replay", Some(&recorded(&scene))).contacts;
        assert!(contacts.iter().all(|c| scene.tracks[c.contact.other.track].id != "c"), "{value}");
        // The published code has one level.
        let options = ContextOptions { convention: Convention::Release, ..ContextOptions::default() };
        let release = Context::new(ctx.scene(), ctx.index(), &options).unwrap();
        let rule = MapFeasibility::default();
        assert!(!rule.violations(&release.candidate(recorded(&scene)), &release).is_empty(), "{value}");
    }
    assert!(!odd("level", "over-now", "c").is_in_contact_now());
    assert!(!context(&odd("level", "over-now", "c")).is_in_contact_now());
}

#[test]
fn an_evasive_manoeuvre_does_not_evade_what_is_above() {
    let scene = odd("level", "over-6m", "c");
    let time = |scene: &Scene| {
        let ctx = context(scene);
        let avoidance = Avoidance::new(&ctx, AvoidanceOptions::default()).unwrap();
        avoidance.of_contact(&ctx.candidate(recorded(scene)), Some(49)).latest_start.unwrap()
    };
    // On one level the car is in the way.
    let mut flat = scene.clone();
    let mut map = (*scene.map).clone();
    map.points.iter_mut().for_each(|point| point[2] = 0.0);
    flat.map = map.into();
    assert!(time(&flat) > time(&scene) + 0.3, "{} {}", time(&flat), time(&scene));
}

#[test]
fn clearance_is_by_level() {
    let scene = odd("level", "over-6m", "c");
    let ctx = context(&scene);
    let poses: Vec<sage_core::motion::Pose> = (1..=ctx.horizon())
        .map(|step| {
            let track = ctx.adversary();
            sage_core::motion::Pose { position: track.point(NOW + step), heading: track.heading[NOW + step] }
        })
        .collect();
    let missing = |ctx: &Context| {
        let mut gradient = PoseGradient::zeros(poses.len());
        Clearance::default().value(&poses, ctx, &mut gradient)
    };
    assert_eq!(missing(&ctx), 0.0, "the edges are those of the road below");
}

#[test]
fn a_recorded_drive_has_the_heights_of_its_road() {
    let scene = odd("level", "over-6m", "c");
    let simulated = simulated(&scene);
    let idm = policies().unwrap().build_default("idm").unwrap();
    let test = AttackTest::new(&*idm, &simulated, 0).unwrap();
    let recorded = test.scene_as_driven();
    let lowest = recorded.ego().position.iter().map(|p| p[2]).fold(f64::INFINITY, f64::min);
    assert!((0.0..2.0).contains(&lowest), "{lowest}");
}

#[test]
fn a_car_that_reverses_keeps_its_heading() {
    for value in ["driveway", "along", "rolls-back"] {
        let scene = odd("reversing", value, "r");
        assert!(scene.adversary().unwrap().reverses(NOW), "{value}");
        let (ctx, log) = (context(&scene), recorded(&scene));
        let candidate = ctx.candidate(log.clone());
        let now = scene.adversary().unwrap().heading[NOW];
        let turn = |heading: f64| wrap_angle(heading - now).abs();
        assert!(candidate.profile().heading.iter().all(|heading| turn(*heading) < 1e-6), "{value}");
        assert_eq!(candidate.half_turn(), None, "{value}");
        let followed = scene.adversary().unwrap().following(&log);
        assert!(followed.heading.iter().all(|heading| turn(*heading) < 1e-6), "{value}");
        // So does a plan that is not quite the recording.
        let near = plan(|step| log.points()[step - 1].map(|x| x + 1e-3));
        let candidate = ctx.candidate(near.clone());
        assert!(candidate.profile().heading.iter().all(|heading| turn(*heading) < 0.03), "{value}");
        let followed = scene.adversary().unwrap().following(&near);
        assert!(followed.heading.iter().all(|heading| turn(*heading) < 0.03), "{value}");
        // When it goes on forwards it does not turn either.
        let [x, y] = scene.adversary().unwrap().point(NOW);
        let (sin, cos) = now.sin_cos();
        let forwards = plan(|step| [x + 0.5 * step as f64 * cos, y + 0.5 * step as f64 * sin]);
        let candidate = ctx.candidate(forwards);
        assert!(candidate.profile().heading.iter().all(|heading| turn(*heading) < 1e-6), "{value}");
    }
}

#[test]
fn a_recording_that_reverses_from_rest_keeps_its_headings_and_is_no_half_turn() {
    let scene = odd("reversing", "from-rest", "r");
    assert!(!scene.adversary().unwrap().reverses(NOW));
    let (ctx, log) = (context(&scene), recorded(&scene));
    let candidate = ctx.candidate(log.clone());
    assert_eq!(candidate.half_turn(), None);
    let followed = scene.adversary().unwrap().following(&log);
    assert_eq!(followed.heading, scene.adversary().unwrap().heading);
    // A plan that does the same, but is none of the recording, turns on the spot.
    let other = plan(|step| {
        let [x, y] = log.points()[step - 1];
        [x + 1e-3, y]
    });
    let candidate = ctx.candidate(other);
    assert!(candidate.half_turn().is_some());
    for rule in ["paper", "drivable"] {
        assert!(rules(&candidate, &ctx, rule).contains(&"half_turn".to_owned()), "{rule}");
    }
}

#[test]
fn half_a_turn_in_a_frame_is_never_feasible() {
    let scene = odd("level", "flat", "a");
    let ctx = context(&scene);
    let [x, y] = scene.adversary().unwrap().point(NOW);
    for turns_at in [1, 20, 60] {
        let there_and_back = plan(|step| {
            let forth = step.min(turns_at - 1) as f64;
            [x + forth - (step as f64 - forth), y]
        });
        let candidate = ctx.candidate(there_and_back);
        assert_eq!(candidate.half_turn(), Some(turns_at));
        assert!(rules(&candidate, &ctx, "paper").contains(&"half_turn".to_owned()), "{turns_at}");
    }
    let straight = ctx.candidate(recorded(&scene));
    assert_eq!((straight.half_turn(), rules(&straight, &ctx, "paper").len()), (None, 0));
}

#[test]
fn a_held_car_is_in_the_way_and_one_that_appears_is_nobodys_fault() {
    for ego in ["idm", "expert", "pdm"] {
        let seen = driven(&odd("gaps", "none", "b"), ego, None);
        for value in ["unseen-3s", "flickers"] {
            assert_eq!(
                driven(&odd("gaps", value, "b"), ego, None).drive.motions,
                seen.drive.motions,
                "{ego} {value}"
            );
        }
    }
    // It appears in the ego's lane where the ego is.
    let scene = read(&OddScene::plain().with("gaps", "appears"));
    let episode = driven(&scene, "replay", None);
    let first = episode.contacts.first().unwrap();
    assert_eq!(
        (first.class, first.class.is_at_fault(), first.class.rule()),
        (FaultClass::Appeared, Some(false), 0)
    );
    // As the adversary it would be no attack.
    let scene = scene.with_roles(None, Some("b")).unwrap();
    let adversary = scene.tracks.iter().position(|track| track.id == "q").unwrap();
    let unattacked = driven(&odd("level", "flat", "b"), "replay", None).drive;
    assert!(!episode.verdict(adversary, true, &unattacked).attack);
}

#[test]
fn a_trailer_is_towed_along_and_is_in_nobodys_way() {
    for value in ["touching", "half-metre"] {
        let scene = odd("trailer", value, "b");
        let hitch = Hitch::of(&scene, scene.adversary.unwrap()).unwrap();
        let ctx = context(&scene);
        assert!(ctx.others().iter().all(|other| other.track != hitch.trailer), "{value}");
        let log = ctx.candidate(recorded(&scene));
        assert!(!rules(&log, &ctx, "paper").contains(&"agent".to_owned()), "{value}");
        // In the simulation it stays behind the adversary.
        let attack = towards_ego(&scene, 40);
        let plan = Arc::new(Plan::of_adversary(&scene, &attack).unwrap());
        let mut world =
            sage_sim::world::World::new(simulated(&scene), Arc::default(), Some(plan), 0).unwrap();
        let apart = |world: &sage_sim::world::World| {
            let at = |track: usize| world.bodies().iter().find(|b| b.track == track).unwrap().area.center;
            distance(at(hitch.car), at(hitch.trailer))
        };
        let before = apart(&world);
        for _ in 0..60 {
            let coast = sage_sim::world::Control::Drive(sage_sim::vehicle::Action::default());
            world.step(coast, None).unwrap();
            assert!((apart(&world) - before).abs() < 0.4, "{value}: {} {before}", apart(&world));
        }
    }
}

#[test]
fn the_egos_trailer_follows_it_and_is_no_contact() {
    let mut scene = odd("trailer", "of-the-ego", "b");
    // Recorded boxes of a car and its trailer may overlap.
    let trailer = scene.tracks.iter_mut().find(|track| track.id == "t").unwrap();
    trailer.size.iter_mut().for_each(|size| size[0] += 0.5);
    for ego in ["idm", "expert", "pdm", "r157"] {
        let episode = driven(&scene, ego, None);
        assert!(episode.contacts.iter().all(|c| scene.tracks[c.contact.other.track].id != "t"), "{ego}");
    }
    let ctx = context(&scene);
    let avoidance = Avoidance::new(&ctx, AvoidanceOptions::default()).unwrap();
    let attack = ctx.candidate(towards_ego(&scene, 45));
    assert!(avoidance.of(&attack).avoidable_reason.is_none(), "its own trailer does not refuse the search");
}

#[test]
fn tables_do_not_count_where_the_recording_leaves_the_road() {
    for (value, leaves) in [("entrance", true), ("across", true), ("on-the-road", false)] {
        let scene = odd("recording", value, "b");
        let simulated = simulated(&scene);
        assert_eq!(simulated.recording_leaves_road(), leaves, "{value}");
        let replay = policies().unwrap().build_default("replay").unwrap();
        let drive = AttackTest::new(&*replay, &simulated, 0).unwrap().unattacked_drive();
        assert_eq!((drive.off_road.step().is_some(), drive.is_off_road()), (leaves, Some(false)), "{value}");
    }
}

#[test]
fn every_rule_and_verdict_keeps_within_the_recording() {
    let mut rng = Rng::new(0, "odd", "horizon");
    let mut tried = 0;
    // Every kind of edge with every length, then random combinations.
    let mut all: Vec<OddScene> = Vec::new();
    for edges in ["boundary", "none", "sidewalk", "guardrail", "median", "open"] {
        for length in ["91", "90", "81", "66", "50", "31", "21"] {
            all.push(OddScene::plain().with("edges", edges).with("length", length));
        }
    }
    all.extend((0..300).map(|seed| OddScene::draw(&mut Rng::new(seed, "odd", "objectives"), 0.3)));
    for odd in all {
        let options = ReadOptions { now: odd.now(), rate: odd.rate(), ..ReadOptions::default() };
        let path = format!("odd.{}", odd.ending());
        let Ok(recording) = Recording::from_bytes_as(Path::new(&path), odd.bytes(), &options) else {
            continue;
        };
        let scene = recording.scene;
        if scene.attackable_horizon().is_err() || scene.adversary.is_none() {
            continue;
        }
        let index = SceneIndex::new(scene.map.clone());
        let Ok(ctx) = Context::new(&Arc::new(scene.clone()), &index, &ContextOptions::default()) else {
            continue;
        };
        let [x, y] = scene.adversary().unwrap().point(NOW);
        let meets = 1 + rng.below(scene.horizon());
        let aside = rng.uniform(-15.0, 15.0);
        let plans = [
            towards_ego(&scene, meets),
            plan(|step| [x + 0.2 * step as f64, y + aside * step as f64 / HORIZON as f64]),
            plan(|_| [x, y]),
        ];
        for trajectory in plans {
            let candidate = ctx.candidate(trajectory);
            assert_eq!(candidate.boxes().len(), scene.horizon(), "{}", odd.describe());
            for name in ["paper", "drivable"] {
                let rule = feasibilities().unwrap().build_default(name).unwrap();
                for violation in rule.violations(&candidate, &ctx) {
                    assert!(
                        candidate.steps().contains(&violation.step),
                        "{name} {}: {violation:?}",
                        odd.describe()
                    );
                }
            }
            let contact = Encounter::of(&candidate, ctx.ego()).contact;
            assert!(contact.is_none_or(|step| candidate.steps().contains(&step)), "{}", odd.describe());
            if let Ok(avoidance) = Avoidance::new(&ctx, AvoidanceOptions::default()) {
                avoidance.of(&candidate);
            }
        }
        tried += 1;
    }
    assert!(tried > 150, "{tried}");
}
