//! Contacts of the world: those of a plain test of all boxes, on the own level, with a response that stays
//! physical.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

mod driving;
mod hand_made;
mod reference;

use std::sync::Arc;

use driving::{policy, scenes, simulation};
use hand_made::{car, prepared, road, road_under_a_bridge, scene};
use sage_core::{
    geometry::{OrientedBox, distance},
    motion::Trajectory,
};
use sage_sim::{
    drive::{Simulation, drive},
    traffic::Plan,
    vehicle::{Action, Tyres, Wheels},
    world::{Control, World, WorldOptions},
};

#[test]
fn contacts_are_those_of_a_plain_test_of_all_boxes() {
    let mut contacts = 0;
    for scene in scenes() {
        let mut driver = simulation(&scene, "constant-speed", WorldOptions::default());
        for frame in 1..scene.scene().frames {
            let start = driver.world().area();
            let before = driver.world().bodies().to_vec();
            let level = driver.world().level();
            driver.step().unwrap();
            let world = driver.world();
            let end = world.area();
            let mut expected: Vec<usize> = Vec::new();
            for to in world.bodies() {
                let from = before.iter().find(|body| body.track == to.track);
                let meets = |substep: usize| {
                    let share = substep as f64 / 5.0;
                    let other = match from {
                        Some(from) => from.area.between(&to.area, share),
                        None if substep == 5 => to.area,
                        None => return false,
                    };
                    start.between(&end, share).intersects(&other)
                };
                if (1..=5).any(meets) {
                    expected.push(to.track);
                }
            }
            let found: Vec<usize> = world.events().contacts.iter().map(|contact| contact.track).collect();
            let has_levels = scene.index().has_levels(3.0);
            let ground =
                |track: usize| world.bodies().iter().find(|body| body.track == track).unwrap().ground;
            expected.retain(|&track| {
                found.contains(&track) || !has_levels || (ground(track) - level).abs() < 2.0
            });
            let mut sorted = found.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, expected, "{} frame {frame}", scene.scene().id);
            contacts += found.len();
        }
    }
    assert!(contacts > 10, "{contacts}");
}

#[test]
fn bodies_out_of_reach_do_not_change_the_path() {
    for scene in scenes().into_iter().step_by(3) {
        for name in ["idm", "constant"] {
            let whole = WorldOptions { whole_physics: true, ..WorldOptions::default() };
            let (mut near, mut all) =
                (simulation(&scene, name, WorldOptions::default()), simulation(&scene, name, whole));
            for _ in 1..scene.scene().frames {
                near.step().unwrap();
                all.step().unwrap();
                let (a, b) = (near.world().motion(), all.world().motion());
                assert!(distance(a.position, b.position) <= 1e-9, "{}", scene.scene().id);
                assert!(
                    (a.heading - b.heading).abs() <= 1e-9,
                    "{} {name} {:e} {:?}",
                    scene.scene().id,
                    a.heading - b.heading,
                    near.world().events().contacts.len()
                );
                let tracks = |s: &Simulation| -> Vec<usize> {
                    s.world().events().contacts.iter().map(|contact| contact.track).collect()
                };
                assert_eq!(tracks(&near), tracks(&all));
            }
        }
    }
}

#[test]
fn a_car_under_a_bridge_does_not_meet_the_cars_on_it() {
    let mut above = car("above", [40.0, -40.0], std::f64::consts::FRAC_PI_2, 10.0);
    above.position.iter_mut().for_each(|p| p[2] = 6.75);
    let tracks = vec![car("ego", [0.0, 0.0], 0.0, 10.0), above];
    let scene = prepared(scene(road_under_a_bridge(), tracks));
    let contacts = |flat: bool, name: &str| {
        let mut replay = simulation(&scene, name, WorldOptions { flat, ..WorldOptions::default() });
        drive(&mut replay).unwrap().contacts.len()
    };
    for name in ["replay", "tracking"] {
        assert_eq!((contacts(false, name), contacts(true, name)), (0, 1), "{name}");
    }
}

#[test]
fn traffic_is_not_pushed_and_the_ego_is() {
    // The ego drives at 15 m/s into a standing car.
    let tracks = vec![car("ego", [0.0, 0.0], 0.0, 15.0), car("wall", [30.0, 0.0], 0.0, 0.0)];
    let scene = prepared(scene(road(), tracks));
    let mut world = World::new(scene.clone(), Arc::default(), None, 0).unwrap();
    let mut first = None;
    for step in 1..60 {
        world.step(Control::Drive(Action { steer: 0.0, throttle: 0.1 }), None).unwrap();
        assert_eq!(world.bodies()[0].area.center, [30.0, 0.0]);
        first = first.or((!world.events().contacts.is_empty()).then_some(step));
        assert!(world.motion().position[0] < 25.6, "the ego is in the wall at step {step}");
    }
    // 25.5 m of free road at 15 m/s.
    assert_eq!(first, Some(17));
    assert!(world.motion().speed() < 0.5);
}

#[test]
fn contacts_of_a_drive_are_those_of_a_plain_test() {
    let mut contacts = 0;
    for scene in scenes() {
        let mut driver = simulation(&scene, "constant", WorldOptions::default());
        for frame in 1..scene.scene().frames {
            let (start, size) = (*driver.world().motion(), driver.world().size());
            let before = driver.world().bodies().to_vec();
            driver.step().unwrap();
            let world = driver.world();
            // Once something is touched, the path depends on the response.
            let mut expected: Vec<usize> = Vec::new();
            let (car, mut motion) = (*world.car(), start);
            let wheels = Wheels::set(&car, Action::default(), start.speed());
            let mut tyres = Tyres::default();
            for substep in 1..=5 {
                motion = motion.coasted(0.02);
                let own = OrientedBox::new(motion.position, motion.heading, size[0], size[1]);
                for to in world.bodies() {
                    let from = before.iter().find(|body| body.track == to.track);
                    let other = match from {
                        Some(from) => from.area.between(&to.area, f64::from(substep) / 5.0),
                        None if substep == 5 => to.area,
                        None => continue,
                    };
                    if own.intersects(&other) {
                        expected.push(to.track);
                    }
                }
                if !expected.is_empty() {
                    break;
                }
                tyres.apply(&car, &wheels, &mut motion);
            }
            if scene.index().has_levels(3.0) {
                break;
            }
            let found: Vec<usize> = world.events().contacts.iter().map(|contact| contact.track).collect();
            assert!(expected.iter().all(|track| found.contains(track)), "{} frame {frame}", scene.scene().id);
            assert_eq!(expected.is_empty(), found.is_empty(), "{} frame {frame}", scene.scene().id);
            if !found.is_empty() {
                contacts += 1;
                break;
            }
        }
    }
    assert!(contacts > 4, "{contacts}");
}

#[test]
fn a_car_that_is_squeezed_is_not_thrown_out() {
    for (offset, speed) in [(0.4, 8.0), (0.0, 5.0), (0.2, 30.0)] {
        let tracks = vec![
            car("ego", [0.0, 0.0], 0.0, 0.0),
            car("ahead", [6.0, 0.0], 0.0, 0.0),
            car("behind", [-20.0, offset], 0.0, speed),
        ];
        let scene = prepared(scene(road(), tracks));
        let mut world = World::new(scene, Arc::default(), None, 0).unwrap();
        for _ in 1..91 {
            world.step(Control::Drive(Action { steer: 0.0, throttle: -1.0 }), None).unwrap();
            assert!(
                world.motion().speed() < speed + 1.0,
                "{} m/s by a car of {speed}",
                world.motion().speed()
            );
        }
    }
}

#[test]
fn a_plan_on_a_slope_under_a_bridge_is_met() {
    // The road climbs 8 % and passes under a bridge, so levels count.
    let mut map = road_under_a_bridge();
    for point in &mut map.points[..81] {
        point[2] = 0.08 * (point[0] + 100.0);
    }
    map.points[81..].iter_mut().for_each(|point| point[2] += 0.08 * 140.0);
    let height = |x: f64| 0.08 * (x + 100.0) + 0.75;
    let climbing = |id: &str, x: f64, speed: f64| {
        let mut car = car(id, [x, 0.0], 0.0, speed);
        car.position.iter_mut().for_each(|p| p[2] = height(p[0]));
        car
    };
    let recorded = scene(map, vec![climbing("ego", 0.0, 12.0), climbing("adversary", 20.0, 12.0)]);
    // It drives on to 70 m and blocks the lane there.
    let points = (1..=80).map(|step| [(32.0 + 1.2 * f64::from(step)).min(70.0), 0.0]).collect();
    let plan = Plan::of_adversary(&recorded, &Trajectory::new("block", points).unwrap()).unwrap();
    let prepared_scene = prepared(recorded);
    assert!(prepared_scene.index().has_levels(3.0));
    let (ego, plan) = (policy("constant-speed"), Some(Arc::new(plan)));
    let mut simulation = Simulation::new(&prepared_scene, &Arc::default(), plan, ego.as_ref(), 0).unwrap();
    assert_eq!(drive(&mut simulation).unwrap().contacts.len(), 1);
}
