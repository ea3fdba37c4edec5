//! Driving against the direction of the lanes.

use std::f64::consts::FRAC_PI_2;

use sage_core::scene::SceneIndex;

use crate::{
    route_lanes::lanes_near,
    scene::{LAST_FRAME, SimScene},
    vehicle::Motion,
};

/// Lanes farther than this say nothing, metres.
const REACH: f64 = 2.5;
/// Slower cars are not counted: they turn round or stand, m/s.
const MOVES: f64 = 1.0;
/// Frames in a row that count: a car that turns crosses lanes of other directions.
const FRAMES: usize = 5;

/// Whether a drive goes against the lanes where the recording does not, as [`is_against_lanes`].
pub(crate) fn is_wrong_way(motions: &[Motion], scene: &SimScene) -> Option<bool> {
    let is_against = is_against_lanes(motions, scene.index())?;
    let log = scene.log();
    let recorded = || (0..log.valid.len().min(LAST_FRAME + 1)).filter(|frame| log.valid[*frame]);
    let motion = |frame: usize| Motion {
        position: log.point(frame),
        heading: log.heading[frame],
        velocity: log.velocity[frame],
        ..Motion::default()
    };
    let recording = || is_against_lanes(&recorded().map(motion).collect::<Vec<_>>(), scene.index());
    Some(is_against && recording() != Some(true))
}

/// Whether a car drives against every lane within 2.5 m for half a second; `None` on a map without lanes.
fn is_against_lanes(motions: &[Motion], index: &SceneIndex) -> Option<bool> {
    if index.motor_lanes().segments().is_empty() {
        return None;
    }
    let is_against = |motion: &Motion| {
        let mut near = lanes_near(index, motion.position, motion.heading, REACH).map(|lane| lane.angle);
        let first = near.next();
        first.is_some_and(|first| first > FRAC_PI_2 && near.all(|angle| angle > FRAC_PI_2))
    };
    let against: Vec<bool> =
        motions.iter().map(|motion| motion.speed() >= MOVES && is_against(motion)).collect();
    Some(against.windows(FRAMES).any(|window| window.iter().all(|is| *is)))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use sage_core::scene::{Map, MapFeature, MapKind};

    use super::*;

    #[test]
    fn a_car_drives_the_wrong_way_against_all_lanes_beside_it() {
        let lane = |id: &str, points| MapFeature {
            id: id.into(),
            kind: MapKind::LaneSurfaceStreet,
            points,
            lane: None,
        };
        let points = vec![[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [100.0, 4.0, 0.0], [0.0, 4.0, 0.0]];
        let features = vec![lane("there", 0..2), lane("back", 2..4)];
        let index = SceneIndex::new(Arc::new(Map { points, features }));
        let drive = |y: f64, speed: f64| -> Vec<Motion> {
            let position = |k: usize| [10.0 + 0.1 * speed * k as f64, y];
            let motion = |k| Motion { position: position(k), velocity: [speed, 0.0], ..Motion::default() };
            (0..20).map(motion).collect()
        };
        assert_eq!(is_against_lanes(&drive(0.0, 8.0), &index), Some(false));
        assert_eq!(is_against_lanes(&drive(4.0, 8.0), &index), Some(true));
        assert_eq!(is_against_lanes(&drive(2.0, 8.0), &index), Some(false), "between both");
        assert_eq!(is_against_lanes(&drive(4.0, 0.5), &index), Some(false), "it hardly moves");
        assert_eq!(is_against_lanes(&drive(4.0, 8.0)[..4], &index), Some(false), "too short");
        assert_eq!(is_against_lanes(&drive(0.0, 8.0), &SceneIndex::new(Arc::default())), None);
    }
}
