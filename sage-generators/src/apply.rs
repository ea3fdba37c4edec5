//! Writes an attack into its scene.

use sage_core::{
    motion::{NOW, Trajectory},
    scene::{Hitch, Scene},
};

/// The scene in which the adversary follows an attack. Its frames 11 to 90, as far as they are recorded, are rewritten
/// (position, heading, velocity, the size at *now*, valid) and later frames are not valid. A trailer of the adversary follows
/// it. Nothing else changes.
///
/// *Errors*: a scene without an adversary, or one too short to hold the attack.
///
/// ```
/// use sage_core::motion::{NOW, Trajectory};
/// use sage_data::procedural::{Kind, generate};
/// use sage_generators::attacked;
///
/// let scene = generate(Kind::Merge, 1, 0).ok_or("no scene for this seed")?;
/// let start = scene.adversary()?.point(NOW);
/// let stops = Trajectory::new("stops", vec![start; 80])?;
/// let changed = attacked(&scene, &stops)?;
/// // The history stays, the future of the adversary is the plan, and nobody else changes.
/// assert_eq!(changed.adversary()?.point(90), start);
/// assert_eq!(changed.adversary()?.position[..=NOW], scene.adversary()?.position[..=NOW]);
/// assert_eq!(changed.ego(), scene.ego());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn attacked(scene: &Scene, attack: &Trajectory) -> Result<Scene, sage_core::Error> {
    let adversary = scene.adversary_index()?;
    scene.attackable_horizon()?;
    let mut scene = scene.clone();
    let hitch = Hitch::of(&scene, adversary);
    // What follows a plan is not held.
    let is_changed = |track: usize| track == adversary || hitch.is_some_and(|hitch| hitch.trailer == track);
    scene.held.iter_mut().filter(|held| is_changed(held.track)).for_each(|held| {
        held.end_before(NOW + 1);
    });
    scene.tracks[adversary] = scene.tracks[adversary].following(attack);
    if let Some(hitch) = hitch {
        scene.tracks[hitch.trailer] = hitch.towed(&scene.tracks[hitch.trailer], &scene.tracks[adversary]);
    }
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::motion::HORIZON;
    use sage_data::procedural::{self, Kind};

    #[test]
    fn an_adversary_without_a_valid_frame_now_has_plausible_velocities() {
        let mut scene = procedural::generate(Kind::Straight, 1, 0).unwrap();
        let adversary = scene.adversary.unwrap();
        for unseen in [0, 1, 3] {
            let track = &mut scene.tracks[adversary];
            for frame in NOW + 1 - unseen..=NOW {
                track.valid[frame] = false;
            }
            // 8 m/s along x from its last valid position.
            let last = NOW - unseen;
            let [x, y] = track.point(last);
            let points = (NOW + 1..=NOW + HORIZON).map(|f| [x + 0.8 * (f - last) as f64, y]).collect();
            let attacked_scene = attacked(&scene, &Trajectory::new("straight", points).unwrap()).unwrap();
            for frame in [NOW + 1, NOW + 2, NOW + HORIZON] {
                let [vx, vy] = attacked_scene.tracks[adversary].velocity[frame];
                assert!((vx - 8.0).abs() < 1e-9 && vy.abs() < 1e-9, "{unseen} unseen, frame {frame}: {vx}");
            }
        }
    }
}
