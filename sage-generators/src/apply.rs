//! An attack put into its scene.

use sage_core::{
    geometry::Point,
    motion::{DT, HORIZON, NOW, Start, Trajectory, kinematics::paper},
    scene::Scene,
};

/// The scene in which the adversary drives an attack: its frames 11 to 90 are rewritten (position,
/// heading, velocity, size as it is now, seen), later ones count as not seen. Nothing else changes.
///
/// *Errors*: a scene without an adversary, or one too short to hold the attack.
pub fn attacked(scene: &Scene, attack: &Trajectory) -> Result<Scene, sage_core::Error> {
    let adversary = scene.adversary_index()?;
    if scene.frames <= NOW + HORIZON {
        return Err(sage_core::Error::Scene {
            scene: scene.id.clone(),
            problem: format!(
                "it ends at frame {}, and an attack needs frames up to {}",
                scene.frames - 1,
                NOW + HORIZON
            ),
        });
    }
    let mut scene = scene.clone();
    let track = &mut scene.tracks[adversary];
    let last = (0..=NOW).rev().find(|f| track.is_valid(*f)).unwrap_or(NOW);
    let start = Start { position: track.point(last), heading: track.heading[last] };
    let points = attack.points();
    let axes = paper::profile(points, &start).axis;
    let (height, size) = (track.position[last][2], track.size[last]);
    let mut before: Point = start.position;
    for (frame, (&[x, y], axis)) in (NOW + 1..).zip(points.iter().zip(&axes)) {
        track.position[frame] = [x, y, height];
        track.heading[frame] = axis[1].atan2(axis[0]);
        track.velocity[frame] = [(x - before[0]) / DT, (y - before[1]) / DT];
        track.size[frame] = size;
        track.valid[frame] = true;
        before = [x, y];
    }
    for frame in NOW + HORIZON + 1..scene.frames {
        track.valid[frame] = false;
    }
    Ok(scene)
}
