//! What a policy sees of a drive: adversary, ego and the three road users nearest to the ego, at every fifth frame.

use sage_core::{
    geometry::{Point, distance, norm, sub, wrap_angle},
    motion::{DT, Pose},
    scene::{Scene, Track, TrackKind},
};

use crate::goose::networks::{FEATURES, Features};

/// Frames from one row to the next.
pub(super) const STRIDE: usize = 5;
/// Numbers of an agent: position and velocity (forward, left), heading, absolute acceleration and yaw rate, 1.
pub(super) const NUMBERS: usize = 8;
/// Agents of a row.
const AGENTS: usize = FEATURES / NUMBERS;
/// Units of the numbers of an agent, if they are scaled: 50 m, 10 m/s, 1 rad, 10 m/s², 1 rad/s.
const UNITS: [f64; NUMBERS] = [50.0, 50.0, 10.0, 10.0, 1.0, 10.0, 1.0, 1.0];
/// Largest scaled number. Recorded tracks jump.
const MOST: f64 = 10.0;

/// Poses of a road user, frame by frame.
type Poses<'a> = &'a dyn Fn(usize) -> Option<Pose>;

/// A number in a unit, limited; as it is without one.
pub(super) fn scaled(number: f64, unit: Option<f64>) -> f32 {
    unit.map_or(number, |unit| (number / unit).clamp(-MOST, MOST)) as f32
}

/// Poses of a track.
pub(super) fn pose_of(track: &Track, frame: usize) -> Option<Pose> {
    track.is_valid(frame).then(|| Pose { position: track.point(frame), heading: track.heading[frame] })
}

/// How rows are made.
pub(super) struct View<'a> {
    /// The scene, for the other road users.
    pub scene: &'a Scene,
    /// Where the curve begins: origin and x axis.
    pub origin: Pose,
    pub first_frame: usize,
    pub is_scaled: bool,
}

impl View<'_> {
    /// Rows at every fifth frame of a drive, from the first frame of the curve to a last one.
    pub(super) fn rows(&self, adversary: Poses, ego: Poses, last: usize) -> Vec<Features> {
        (self.first_frame..=last).step_by(STRIDE).map(|frame| self.row(adversary, ego, frame)).collect()
    }

    fn row(&self, adversary: Poses, ego: Poses, frame: usize) -> Features {
        let mut row = [0.0; FEATURES];
        let own = [adversary, ego].into_iter().map(|poses| self.numbers(poses, frame));
        let others = self.nearest(ego(frame).map(|pose| pose.position), frame).into_iter();
        let others = others.map(|track| self.numbers(&|frame| pose_of(track, frame), frame));
        for (to, numbers) in row.as_chunks_mut::<NUMBERS>().0.iter_mut().zip(own.chain(others)) {
            *to = numbers;
        }
        row
    }

    /// The road users nearest to the ego, the nearest first.
    fn nearest(&self, ego: Option<Point>, frame: usize) -> Vec<&Track> {
        let Some(ego) = ego else { return Vec::new() };
        let is_other = |(number, track): &(usize, &Track)| {
            *number != self.scene.ego
                && Some(*number) != self.scene.adversary
                && !matches!(track.kind, TrackKind::Other(_))
                && track.is_valid(frame)
        };
        let others = self.scene.tracks.iter().enumerate().filter(is_other).map(|(_, track)| track);
        let mut others: Vec<(f64, &Track)> =
            others.map(|track| (distance(track.point(frame), ego), track)).collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        others.truncate(AGENTS - 2);
        others.into_iter().map(|(_, track)| track).collect()
    }

    /// Numbers of a road user; zeros where it is absent.
    fn numbers(&self, poses: Poses, frame: usize) -> [f32; NUMBERS] {
        let Some(pose) = poses(frame) else { return [0.0; NUMBERS] };
        let at = |back: usize| frame.checked_sub(back).and_then(poses);
        let velocity = |to: Option<Pose>, from: Option<Pose>| {
            Some(sub(to?.position, from?.position).map(|distance| distance / DT))
        };
        let [before, earlier] = [at(1), at(2)];
        let now = velocity(Some(pose), before);
        let gain = now.zip(velocity(before, earlier)).map_or(0.0, |(now, was)| (norm(now) - norm(was)) / DT);
        let turn = before.map_or(0.0, |before| wrap_angle(pose.heading - before.heading) / DT);
        let [x, y] = self.turned(sub(pose.position, self.origin.position));
        let [vx, vy] = self.turned(now.unwrap_or_default());
        let heading = wrap_angle(pose.heading - self.origin.heading);
        let numbers = [x, y, vx, vy, heading, gain.abs(), turn.abs(), 1.0];
        std::array::from_fn(|k| scaled(numbers[k], self.is_scaled.then_some(UNITS[k])))
    }

    fn turned(&self, [x, y]: Point) -> Point {
        let (sin, cos) = self.origin.heading.sin_cos();
        [cos * x + sin * y, cos * y - sin * x]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_data::procedural::{Kind, generate};

    #[test]
    fn a_row_holds_the_numbers_of_its_agents_in_the_frame_of_the_curve() {
        let scene = generate(Kind::FourWay, 1, 0).unwrap();
        let view = View {
            scene: &scene,
            origin: Pose::new(1.0, 2.0, std::f64::consts::FRAC_PI_2),
            first_frame: 10,
            is_scaled: false,
        };
        // 1 m in a frame, then 2 m: along y, which is forward.
        let ego = |frame: usize| {
            let y = [2.0, 3.0, 5.0].get(frame.checked_sub(8)?).copied()?;
            Some(Pose::new(1.0, y, std::f64::consts::FRAC_PI_2 + 0.1 * frame as f64))
        };
        let rows = view.rows(&|_| None, &ego, 10);
        assert_eq!(rows.len(), 1);
        let expected = [3.0, 0.0, 20.0, 0.0, 1.0, 100.0, 1.0, 1.0];
        for (found, expected) in rows[0][NUMBERS..2 * NUMBERS].iter().zip(expected) {
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
        assert!(rows[0][..NUMBERS].iter().all(|x| *x == 0.0), "an adversary that is absent");
        let scaled = View { is_scaled: true, ..view };
        let row = scaled.rows(&|_| None, &ego, 10)[0];
        assert!((row[NUMBERS] - 0.06).abs() < 1e-6 && (row[NUMBERS + 5] - MOST as f32).abs() < 1e-6);
        assert_eq!(view_count(&scaled, &ego), 1, "every fifth frame up to the last");
    }

    fn view_count(view: &View, ego: Poses) -> usize {
        view.rows(&|_| None, ego, 14).len()
    }

    #[test]
    fn the_others_are_the_nearest_to_the_ego() {
        let scene = generate(Kind::FourWay, 1, 0).unwrap();
        let view = View { scene: &scene, origin: Pose::new(0.0, 0.0, 0.0), first_frame: 0, is_scaled: false };
        let ego = scene.ego().point(20);
        let nearest = view.nearest(Some(ego), 20);
        let distances: Vec<f64> = nearest.iter().map(|track| distance(track.point(20), ego)).collect();
        assert!(distances.is_sorted() && distances.len() <= 3);
        let is_role = |track: &&Track| {
            track.id == scene.ego().id || track.id == scene.tracks[scene.adversary.unwrap()].id
        };
        assert!(!nearest.iter().any(is_role));
    }
}
