//! The example as recordings of other lengths, rates and quality.

#![allow(dead_code)] // Each test program uses a part of it.

use std::path::{Path, PathBuf};

use sage_core::{motion::NOW, scene::Scene};
use sage_data::Recording;

use crate::program::example;

/// The example with another content, as a pickle.
pub fn made(folder: &Path, name: &str, change: impl FnOnce(&mut Scene)) -> PathBuf {
    let mut scene = Recording::read(Path::new(&example())).unwrap().scene;
    scene.id = name.to_owned();
    scene.notes.clear();
    change(&mut scene);
    let path = folder.join(format!("{name}.pkl"));
    std::fs::write(&path, Recording::procedural(scene).to_pickle().unwrap()).unwrap();
    path
}

/// Frames of a scene by index; an index may occur twice.
pub fn frames(scene: &mut Scene, indices: &[usize], step: f64) {
    for track in &mut scene.tracks {
        track.position = indices.iter().map(|f| track.position[*f]).collect();
        track.heading = indices.iter().map(|f| track.heading[*f]).collect();
        track.velocity = indices.iter().map(|f| track.velocity[*f]).collect();
        track.size = indices.iter().map(|f| track.size[*f]).collect();
        track.valid = indices.iter().map(|f| track.valid[*f]).collect();
    }
    for light in &mut scene.lights {
        light.states = indices.iter().map(|f| light.states[*f]).collect();
    }
    scene.frames = indices.len();
    scene.timestamps = (0..indices.len()).map(|f| f as f64 * step).collect();
}

pub fn first(count: usize) -> impl FnOnce(&mut Scene) {
    move |scene| frames(scene, &(0..count).collect::<Vec<_>>(), 0.1)
}

/// 20 Hz: each frame twice would stand still every second frame, so that there is linear motion in between.
fn at_20_hz(scene: &mut Scene) {
    let old = scene.clone();
    frames(scene, &(0..181).map(|f| f / 2).collect::<Vec<_>>(), 0.05);
    for (track, old) in scene.tracks.iter_mut().zip(&old.tracks) {
        for frame in (1..181).step_by(2) {
            let (a, b) = (old.position[frame / 2], old.position[frame / 2 + 1]);
            track.position[frame] = [0, 1, 2].map(|k| 0.5 * (a[k] + b[k]));
            track.valid[frame] = old.valid[frame / 2] && old.valid[frame / 2 + 1];
        }
    }
}

/// Moves the adversary onto the ego's side.
fn beside_now(scene: &mut Scene) {
    let (ego, adversary) = (scene.ego, scene.adversary.unwrap());
    let ([x, y], [a, b]) = (scene.tracks[ego].point(NOW), scene.tracks[adversary].point(NOW));
    for position in &mut scene.tracks[adversary].position {
        position[0] += x - a + 1.5;
        position[1] += y - b;
    }
}

/// A position of a bystander that is no number.
fn bystander_without_a_place(scene: &mut Scene) {
    let (ego, adversary) = (scene.ego, scene.adversary.unwrap());
    let is_other = |k: &usize| *k != ego && *k != adversary && scene.tracks[*k].valid[40];
    let other = (0..scene.tracks.len()).find(is_other).unwrap();
    scene.tracks[other].position[40][0] = f64::NAN;
}

/// The recordings of the page `recordings.md`.
pub fn write(folder: &Path) {
    made(folder, "short", first(50));
    made(folder, "history", first(11));
    made(folder, "fast", at_20_hz);
    made(folder, "long", |scene| frames(scene, &(0..91).chain((0..90).rev()).collect::<Vec<_>>(), 0.1));
    made(folder, "still", |scene| scene.tracks.iter_mut().for_each(|track| track.velocity.fill([0.0; 2])));
    let [pair, bad] = ["pair", "bad"].map(|name| folder.join(name));
    [&pair, &bad].iter().for_each(|folder| std::fs::create_dir(folder).unwrap());
    made(&pair, "touching", beside_now);
    made(&pair, "apart", |_| ());
    made(&bad, "bad", bystander_without_a_place);
    std::fs::write(bad.join("no-scene.pkl"), b"\x80\x04N.").unwrap();
}
