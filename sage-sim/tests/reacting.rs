//! Adversaries that react: a policy takes over in mid-drive.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::sync::{Arc, Mutex};

use sage_core::{
    Error,
    generator::{Attack, Proposal, Reaction, ReactiveDriver, ReactivePolicy},
    geometry::distance,
    motion::{HORIZON, NOW, Trajectory},
    scene::SceneIndex,
};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    attack_test::{AttackPath, AttackTest},
    drive::{Simulation, drive},
    environment::{Environment, EnvironmentOptions},
    observation::LENGTH,
    policy::{EgoPolicy, policies},
    traffic::Plan,
    vehicle::Action,
};

/// Frame and observation.
type Seen = (usize, Vec<f32>);

/// Gives constant actions and notes what it is given.
#[derive(Clone, Default)]
struct Constant {
    action: [f64; 2],
    seen: Arc<Mutex<Vec<Seen>>>,
}

impl ReactivePolicy for Constant {
    fn start(&self, _: &str, _: u64) -> Box<dyn ReactiveDriver> {
        Box::new(self.clone())
    }
}

impl ReactiveDriver for Constant {
    fn action(&mut self, frame: usize, observation: &[f32]) -> Result<[f64; 2], Error> {
        self.seen.lock().unwrap().push((frame, observation.to_vec()));
        Ok(self.action)
    }

    fn boxed_clone(&self) -> Box<dyn ReactiveDriver> {
        Box::new(self.clone())
    }
}

fn scene(kind: Kind, seed: u64) -> Arc<SimScene> {
    let scene = Arc::new(generate(kind, seed, 0).unwrap());
    SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone())).unwrap()
}

fn policy(name: &str) -> Box<dyn EgoPolicy> {
    policies().unwrap().build_default(name).unwrap()
}

/// The adversary's recording as an attack, with a reaction from a frame on.
fn attack(scene: &SimScene, policy: &Constant, from: usize) -> Attack {
    let log = scene.scene().adversary().unwrap();
    let points = (NOW + 1..=NOW + HORIZON).map(|frame| log.point(frame)).collect();
    let proposal = Proposal::of(Trajectory::new("log", points).unwrap());
    let reaction = Reaction { from, policy: Arc::new(policy.clone()), seed: 0 };
    Attack { reaction: Some(reaction), ..Attack::only(proposal) }
}

#[test]
fn the_adversary_follows_its_plan_and_then_its_policy() {
    let scene = scene(Kind::FourWay, 1);
    let coasting = Constant::default();
    let attacked = attack(&scene, &coasting, 40);
    let path = AttackPath::driven(&*policy("replay"), &scene, &attacked, 0).unwrap().trajectory;
    let plan = attacked.trajectory().points();
    // Up to frame 40 the plan, bit for bit; the first action is for the step to frame 41.
    assert_eq!(&path.points()[..40 - NOW], &plan[..40 - NOW]);
    assert_ne!(path.points()[41 - NOW], plan[41 - NOW]);
    let seen = coasting.seen.lock().unwrap();
    assert_eq!(seen[0].0, 40);
    assert_eq!(seen.len(), 90 - 40);
    assert!(seen.iter().enumerate().all(|(k, (frame, numbers))| *frame == 40 + k && numbers.len() == LENGTH));
}

#[test]
fn brakes_stop_it_and_throttle_takes_it_further() {
    let scene = scene(Kind::Straight, 2);
    let way = |action: [f64; 2]| {
        let attacked = attack(&scene, &Constant { action, ..Constant::default() }, 15);
        let path = AttackPath::driven(&*policy("replay"), &scene, &attacked, 0).unwrap().trajectory;
        distance(path.points()[0], path.points()[HORIZON - 1])
    };
    let [brake, coast, throttle] = [-1.0, 0.0, 1.0].map(|throttle| way([0.0, throttle]));
    assert!(brake < coast && coast < throttle, "{brake} {coast} {throttle}");
}

#[test]
fn the_observation_is_that_of_the_adversary() {
    let scene = scene(Kind::FourWay, 3);
    let still = Constant::default();
    let attacked = attack(&scene, &still, 20);
    AttackPath::driven(&*policy("replay"), &scene, &attacked, 0).unwrap();
    let seen = still.seen.lock().unwrap()[0].1.clone();
    // The same numbers as for an ego with the adversary's recording, in the scene with both roles swapped.
    let swapped = {
        let mut swapped = (**scene.scene()).clone();
        (swapped.ego, swapped.adversary) = (scene.scene().adversary.unwrap(), Some(scene.scene().ego));
        let swapped = Arc::new(swapped);
        SimScene::new(swapped.clone(), SceneIndex::new(swapped.map.clone())).unwrap()
    };
    let mut environment = Environment::reset(swapped.clone(), Arc::default(), None, 0).unwrap();
    let mut driver = policy("replay")
        .start(&sage_sim::policy::Start::new(&swapped, swapped.scene().ego, policy("replay").knows(), 0))
        .unwrap();
    for _ in 0..20 {
        let control = {
            let world = environment.world();
            let view = sage_sim::policy::View::of_ego(world, policy("replay").knows(), None);
            driver.control(&view).unwrap()
        };
        environment.step_with(control).unwrap();
    }
    let mut expected = [0.0; LENGTH];
    environment.observe(&mut expected);
    // Headings and velocities of plans come from positions and differ a little from recorded ones, so one of the 72 beams may
    // just miss the end of a line.
    let far: Vec<usize> = (0..LENGTH).filter(|&k| (seen[k] - expected[k]).abs() > 0.02).collect();
    assert!(far.len() <= 1, "{far:?}: {:?}", far.iter().map(|&k| (seen[k], expected[k])).collect::<Vec<_>>());
}

#[test]
fn a_reaction_has_the_same_bits_in_every_way_to_drive_it() {
    for (kind, seed) in [(Kind::FourWay, 1), (Kind::Merge, 2), (Kind::Straight, 3)] {
        let scene = scene(kind, seed);
        let throttle = Constant { action: [0.05, 0.4], ..Constant::default() };
        let attacked = attack(&scene, &throttle, 25);
        for name in ["replay", "idm", "expert"] {
            let ego = policy(name);
            let test = AttackTest::new(&*ego, &scene, seed).unwrap();
            let [first, second] = [0, 1].map(|_| test.path_of(&attacked).unwrap());
            assert_eq!(first.trajectory, second.trajectory);
            let outcome = test.attack_along(first.clone(), true).unwrap();
            // A drive to the end moves the ego in the same way until its first contact, and the adversary throughout.
            let plan = Arc::new(Plan::of_attack(scene.scene(), &attacked).unwrap());
            let mut simulation =
                Simulation::new(&scene, &Arc::default(), Some(plan.clone()), &*ego, seed).unwrap();
            let mut copied = simulation.try_clone().unwrap();
            let whole = drive(&mut simulation).unwrap();
            let motions = &outcome.episode.drive.motions;
            assert_eq!(&whole.motions[..motions.len()], &motions[..], "{kind:?} {name}");
            assert_eq!(drive(&mut copied).unwrap(), whole);
            let adversary = scene.scene().adversary.unwrap();
            let last = simulation.world().bodies().iter().find(|body| body.track == adversary).unwrap();
            assert_eq!(last.area.center, first.trajectory.points()[HORIZON - 1]);
        }
        // The environment of reinforcement learning drives the same adversary.
        let plan = Arc::new(Plan::of_attack(scene.scene(), &attacked).unwrap());
        let mut environment =
            Environment::reset(scene.clone(), Arc::new(EnvironmentOptions::default()), Some(plan), 0)
                .unwrap();
        while !environment.is_over() && environment.world().step_count() < 30 {
            environment.step(Action { steer: 0.0, throttle: -1.0 }).unwrap();
        }
        let mut copy = environment.clone();
        for _ in 0..3 {
            if environment.is_over() {
                break;
            }
            environment.step(Action::default()).unwrap();
            copy.step(Action::default()).unwrap();
            assert_eq!(environment.world().bodies(), copy.world().bodies());
        }
    }
}

#[test]
fn a_reaction_before_now_or_after_the_end_is_refused() {
    let scene = scene(Kind::FourWay, 1);
    for from in [NOW - 1, NOW + HORIZON + 1] {
        let error = attack(&scene, &Constant::default(), from).check(scene.scene()).unwrap_err().to_string();
        assert!(
            error.contains(&format!("reacts from frame {from} on; expected a frame from 10 to 90")),
            "{error}"
        );
    }
    let attacked = attack(&scene, &Constant::default(), 35);
    let path = attacked.trajectory().clone();
    let driven = attacked.with_drive(path, "`idm`");
    let note = driven.note.clone().unwrap().to_string();
    assert_eq!(note, "the adversary reacts from 2.5 s on; this is the path that it drove against `idm`");
    assert!(driven.reaction.is_none());
}

#[test]
fn it_brakes_after_a_contact() {
    let mut contacts = 0;
    for seed in 0..12 {
        let Some(found) = generate(Kind::FourWay, seed, 0) else { continue };
        let found = Arc::new(found);
        let scene = SimScene::new(found.clone(), SceneIndex::new(found.map.clone())).unwrap();
        // Straight to where the ego is in 3 s, then on with full throttle.
        let [from, to] = [scene.scene().adversary().unwrap().point(NOW), scene.scene().ego().point(NOW + 30)];
        let at = |step: usize| [0, 1].map(|k| from[k] + (to[k] - from[k]) * step as f64 / 30.0);
        let plan = Trajectory::new("straight", (1..=HORIZON).map(at).collect()).unwrap();
        let throttle = Constant { action: [0.0, 1.0], ..Constant::default() };
        let reaction = Reaction { from: NOW + 20, policy: Arc::new(throttle), seed: 0 };
        let attacked = Attack { reaction: Some(reaction), ..Attack::only(Proposal::of(plan)) };
        let ego = policy("replay");
        let test = AttackTest::new(&*ego, &scene, 0).unwrap();
        let path = test.path_of(&attacked).unwrap();
        let last = path.trajectory.points()[HORIZON - 1];
        let outcome = test.attack_along(path.clone(), true).unwrap();
        if outcome.meets_adversary() && outcome.episode.steps() < 60 {
            contacts += 1;
            assert!(distance(path.trajectory.points()[HORIZON - 2], last) < 0.02, "seed {seed}");
        }
    }
    assert!(contacts > 3, "{contacts}");
}
