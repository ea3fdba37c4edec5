//! Trailers: a road user that a car tows. Data sets record car and trailer as two road users.

use super::{Levels, Scene, Track};
use crate::{
    geometry::{OrientedBox, Point, distance, dot, norm, sub},
    motion::{DT, NOW},
};

/// Largest distance between the rear of a car and the front of its trailer, metres, and largest overlap of their boxes.
const DRAWBAR: f64 = 0.8;
const OVERLAP: f64 = 1.5;
/// Largest distance of a trailer's centre from the car's axis, metres, and largest angle between their headings, rad.
const ASIDE: f64 = 1.5;
const ANGLE: f64 = 1.2;
/// Speed from which two road users that touch move together, m/s, and from which two with a gap do: cars in a queue keep
/// one, but not at speed.
const MOVING: [f64; 2] = [0.5, 3.0];
/// Largest change of the distance of the centres over the history, metres. It changes a little in a curve.
const STRETCH: f64 = 0.3;
/// Fewest frames of the history that both are recorded in.
const FEWEST: usize = 4;

/// A car and its trailer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hitch {
    /// Index of the car's track.
    pub car: usize,
    /// Index of the trailer's track.
    pub trailer: usize,
    /// Distance from the car's centre back to the hitch, metres.
    behind: f64,
    /// Distance from the hitch to the trailer's centre, metres.
    length: f64,
}

impl Hitch {
    /// What a car tows: the road user behind it that touches it *now*, or nearly so, and has moved with it since frame 0.
    pub fn of(scene: &Scene, car: usize) -> Option<Self> {
        let levels = Levels::of(&scene.map);
        let tracks = || (0..scene.tracks.len()).filter(|k| *k != car && *k != scene.ego);
        tracks().filter(|k| Some(*k) != scene.adversary).find_map(|trailer| {
            let [behind, length] = towed(&scene.tracks[car], &scene.tracks[trailer], &levels)?;
            Some(Self { car, trailer, behind, length })
        })
    }

    /// Centre and heading of the trailer after the car has moved to a pose: it turns to the hitch.
    pub fn follow(&self, car: &OrientedBox, trailer: Point) -> (Point, f64) {
        let hitch = [0, 1].map(|k| car.center[k] - self.behind * car.axis[k]);
        let pull = sub(hitch, trailer);
        let apart = norm(pull);
        let axis = if apart > 1e-6 { pull.map(|x| x / apart) } else { car.axis };
        ([0, 1].map(|k| hitch[k] - self.length * axis[k]), axis[1].atan2(axis[0]))
    }

    /// The trailer's recording up to *now*, then behind a car that moves otherwise than recorded.
    pub fn towed(&self, trailer: &Track, car: &Track) -> Track {
        let mut track = trailer.clone();
        let (mut center, size) = (trailer.point(NOW), trailer.size[NOW]);
        let above = trailer.position[NOW][2] - car.position[NOW][2];
        for frame in NOW + 1..track.valid.len() {
            track.valid[frame] = car.is_valid(frame);
            if !car.is_valid(frame) {
                continue;
            }
            let (next, heading) = self.follow(&car.oriented_box(frame), center);
            track.position[frame] = [next[0], next[1], car.position[frame][2] + above];
            track.heading[frame] = heading;
            track.velocity[frame] = sub(next, center).map(|d| d / DT);
            track.size[frame] = size;
            center = next;
        }
        track
    }
}

/// Distance of the hitch behind the car's centre and before the trailer's, if one tows the other.
fn towed(car: &Track, trailer: &Track, levels: &Levels) -> Option<[f64; 2]> {
    if !(car.is_valid(NOW) && trailer.is_valid(NOW)) || levels.differ_at(NOW, car, trailer) {
        return None;
    }
    let [own, other] = [car, trailer].map(|track| track.oriented_box(NOW));
    let apart = distance(own.center, other.center);
    let [ahead, aside] = own.box_from_world(other.center);
    let gap = -ahead - own.half_length - other.half_length;
    if !(-OVERLAP..=DRAWBAR).contains(&gap) || aside.abs() > ASIDE || dot(own.axis, other.axis) < ANGLE.cos()
    {
        return None;
    }
    let both: Vec<usize> = (0..=NOW).filter(|f| car.is_valid(*f) && trailer.is_valid(*f)).collect();
    let first = *both.first().filter(|_| both.len() >= FEWEST)?;
    let elapsed = DT * (NOW - first) as f64;
    let least = MOVING[usize::from(!own.intersects(&other))];
    let moves = |track: &Track| distance(track.point(first), track.point(NOW)) >= least * elapsed;
    let is_rigid =
        |frame: &usize| (distance(car.point(*frame), trailer.point(*frame)) - apart).abs() <= STRETCH;
    if !(moves(car) && moves(trailer) && both.iter().all(is_rigid)) {
        return None;
    }
    let behind = own.half_length + 0.5 * gap;
    let hitch = [0, 1].map(|k| own.center[k] - behind * own.axis[k]);
    Some([behind, distance(hitch, other.center)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{AdversaryOrigin, Map, TrackKind};

    /// A car of 4.6 m, and something of 8 m behind it by a gap; they move at a speed along x.
    fn scene(gap: f64, speed: f64) -> Scene {
        let track = |id: &str, at: f64, length: f64| Track {
            id: id.into(),
            kind: TrackKind::Vehicle,
            position: (0..91).map(|f| [at + DT * speed * f64::from(f), 0.0, 0.0]).collect(),
            heading: vec![0.0; 91],
            velocity: vec![[speed, 0.0]; 91],
            size: vec![[length, 2.0, 1.5]; 91],
            valid: vec![true; 91],
        };
        let tracks = [track("ego", 100.0, 4.6), track("car", 0.0, 4.6), track("t", -6.3 - gap, 8.0)];
        Scene {
            id: "trailer".into(),
            frames: 91,
            timestamps: vec![],
            tracks: tracks.into_iter().collect(),
            map: Map::default().into(),
            lights: vec![],
            ego: 0,
            adversary: Some(1),
            adversary_origin: AdversaryOrigin::File,
            notes: vec![],
            held: vec![],
        }
    }

    #[test]
    fn what_touches_a_car_and_moves_with_it_is_its_trailer() {
        for (gap, speed, expected) in [
            (-0.3, 10.0, true),
            (0.0, 1.0, true),
            (0.5, 10.0, true),
            (0.5, 1.0, false),
            (-0.3, 0.0, false),
            (1.2, 10.0, false),
            (-3.0, 10.0, false),
        ] {
            assert_eq!(Hitch::of(&scene(gap, speed), 1).is_some(), expected, "{gap} {speed}");
        }
        let mut leaving = scene(-0.3, 10.0);
        (0..10).for_each(|frame| leaving.tracks[2].position[frame][0] -= 1.0);
        assert_eq!(Hitch::of(&leaving, 1), None);
    }

    #[test]
    fn a_trailer_keeps_its_distance_from_the_hitch_and_turns_to_it() {
        let scene = scene(-0.3, 10.0);
        let hitch = Hitch::of(&scene, 1).unwrap();
        let mut car = scene.tracks[1].clone();
        for frame in NOW + 1..91 {
            let s = 0.05 * (frame - NOW) as f64;
            car.position[frame] = [10.0 + 20.0 * s.sin(), 20.0 * (1.0 - s.cos()), 0.0];
            car.heading[frame] = s;
        }
        let towed = hitch.towed(&scene.tracks[2], &car);
        for frame in NOW..91 {
            let b = car.oriented_box(frame);
            let at = [0, 1].map(|k| b.center[k] - hitch.behind * b.axis[k]);
            assert!((distance(at, towed.point(frame)) - hitch.length).abs() < 1e-9, "{frame}");
        }
        let lag = car.heading[60] - towed.heading[60];
        assert!(lag > 0.05 && lag < 0.5, "it turns later and inside: {lag}");
        assert_eq!(towed.position[NOW], scene.tracks[2].position[NOW]);
    }
}
