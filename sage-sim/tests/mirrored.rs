//! A mirrored observation is what the car sees in the mirror image of the scene, and a turned steering drives it there.

use std::sync::Arc;

use sage_core::{
    scene::{Scene, SceneIndex},
    seed::Rng,
};
use sage_data::procedural::{Kind, generate};
use sage_sim::{
    SimScene,
    environment::{Environment, EnvironmentOptions},
    observation::{LENGTH, ObservationKind, mirror},
    vehicle::Action,
};

/// The mirror image of a scene about the x axis.
fn mirror_image(scene: &Scene) -> Scene {
    let mut image = scene.clone();
    for track in &mut image.tracks {
        track.position.iter_mut().for_each(|p| p[1] = -p[1]);
        track.heading.iter_mut().for_each(|heading| *heading = -*heading);
        track.velocity.iter_mut().for_each(|v| v[1] = -v[1]);
    }
    let mut map = (*scene.map).clone();
    map.points.iter_mut().for_each(|p| p[1] = -p[1]);
    image.map = Arc::new(map);
    image.lights.iter_mut().for_each(|light| {
        if let Some(stop) = &mut light.stop_point {
            stop[1] = -stop[1];
        }
    });
    image
}

fn environment(scene: Scene, kind: ObservationKind, goes_on: bool) -> Option<Environment> {
    let index = SceneIndex::new(scene.map.clone());
    let scene = SimScene::new(Arc::new(scene), index).ok()?;
    let rules = EnvironmentOptions { observation: kind, goes_on, ..EnvironmentOptions::training() };
    Environment::reset(scene, Arc::new(rules), None, 0).ok()
}

#[test]
fn the_mirror_image_of_a_drive_is_the_drive_in_the_mirror_image() {
    let (mut compared, mut differing) = (0, 0);
    for (number, kind) in (0..Kind::ALL.len() as u64).zip(Kind::ALL) {
        let scene = generate(kind, 0, number).expect("a scene");
        for observed in [ObservationKind::Corrected, ObservationKind::Continued] {
            let goes_on = observed == ObservationKind::Continued;
            let drives =
                [scene.clone(), mirror_image(&scene)].map(|scene| environment(scene, observed, goes_on));
            let [Some(mut drive), Some(mut image)] = drives else { continue };
            let mut rng = Rng::new(0, &scene.id, "actions");
            while !drive.is_over() && !image.is_over() {
                let [mut seen, mut expected] = [[0.0; LENGTH]; 2];
                drive.observe(&mut seen);
                image.observe(&mut expected);
                // As in MetaDrive, a car 2 m to the right of the route keeps its checkpoints, one to the left does not.
                if !goes_on && (seen[58] - 0.5).abs() >= 2.0 / 40.0 {
                    break;
                }
                mirror(&mut seen);
                for (k, (x, y)) in seen.iter().zip(&expected).enumerate() {
                    compared += 1;
                    // A beam that grazes a corner may meet it or not by rounding.
                    if (x - y).abs() > 1e-4 {
                        differing += 1;
                        let is_beam = k < 30 || (36..48).contains(&k) || k > 70;
                        assert!(is_beam, "{}: number {k} is {x} and {y}", scene.id);
                    }
                }
                let (steer, throttle) = (rng.uniform(-0.1, 0.1), rng.uniform(-0.3, 0.6));
                drive.step(Action { steer, throttle }).expect("a step");
                image.step(Action { steer: -steer, throttle }).expect("a step");
            }
            assert_eq!(drive.is_over(), image.is_over(), "{}", scene.id);
        }
    }
    assert!(compared > 50_000, "{compared} numbers are compared");
    assert!(differing * 10_000 < compared, "{differing} of {compared} numbers differ");
}

#[test]
fn a_mirrored_observation_changes_sides_and_twice_mirrored_is_itself() {
    let mut rng = Rng::new(1, "mirrored", "test");
    let mut numbers: [f32; LENGTH] = std::array::from_fn(|_| rng.unit() as f32);
    let before = numbers;
    mirror(&mut numbers);
    assert!(numbers.iter().zip(&before).filter(|(a, b)| a == b).count() < 25);
    mirror(&mut numbers);
    assert!(numbers.iter().zip(&before).all(|(a, b)| (a - b).abs() < 1e-6));
}
