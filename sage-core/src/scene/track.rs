//! The recording of one road user.

use crate::{
    geometry::{OrientedBox, Point, dot, norm, sub},
    motion::{DT, NOW, Pose, Trajectory, kinematics::paper},
};

/// Largest standard deviation of the positions of a parked vehicle, metres.
const PARKED: f64 = 3.0;

/// Kind of a road user.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum TrackKind {
    /// Car, van, truck, bus, motorcycle.
    Vehicle,
    /// Person on foot.
    Pedestrian,
    /// Person on a bicycle or the like.
    Cyclist,
    /// Any other name of the file: TRAFFIC_CONE, TRAFFIC_BARRIER, RIDERLESS_BICYCLE, UNSET, …
    Other(String),
}

impl TrackKind {
    /// The name of a track without a type.
    pub const UNSET: &str = "UNSET";

    /// The kind of a type name, in upper or lower case: MetaDrive's, or one that converters take over from nuScenes, nuPlan or
    /// Argoverse 2.
    ///
    /// A motorcyclist is a vehicle, because a motorcycle drives at the speed of cars. A bicycle without rider stands, so it is
    /// an object.
    pub fn from_name(name: &str) -> Self {
        match &name.to_ascii_uppercase()[..] {
            "VEHICLE" | "CAR" | "VAN" | "BUS" | "SCHOOL_BUS" | "TRUCK" | "TRAILER" | "MOTORCYCLE"
            | "MOTORCYCLIST" => Self::Vehicle,
            "PEDESTRIAN" => Self::Pedestrian,
            "CYCLIST" | "BICYCLE" => Self::Cyclist,
            _ => Self::Other(name.to_owned()),
        }
    }

    /// True if the file does not know the type.
    pub fn is_unknown(&self) -> bool {
        let words = [Self::UNSET, "UNKNOWN", "NONE", ""];
        matches!(self, Self::Other(name) if words.iter().any(|word| word.eq_ignore_ascii_case(name)))
    }

    /// Whether it is a person on foot or on a bicycle.
    pub fn is_person(&self) -> bool {
        matches!(self, Self::Pedestrian | Self::Cyclist)
    }

    /// The MetaDrive type name. A bus has that of a vehicle here; files keep their own word.
    pub fn name(&self) -> &str {
        match self {
            Self::Vehicle => "VEHICLE",
            Self::Pedestrian => "PEDESTRIAN",
            Self::Cyclist => "CYCLIST",
            Self::Other(name) => name,
        }
    }
}

/// A recorded road user: columns of equal length, one value per frame. Frames that are not valid hold the
/// file's values, usually zeros, and are never read.
///
/// A bus that drives along +x at 5 m/s:
///
/// ```
/// use sage_core::{motion::NOW, scene::{Track, TrackKind}};
///
/// let bus = Track {
///     id: "7".to_owned(),
///     kind: TrackKind::from_name("BUS"),
///     position: (0..91).map(|frame| [0.5 * f64::from(frame), 0.0, 1.5]).collect(),
///     heading: vec![0.0; 91],
///     velocity: vec![[5.0, 0.0]; 91],
///     size: vec![[12.0, 2.5, 3.0]; 91],
///     valid: vec![true; 91],
/// };
/// // *Now* is 1 s after the first frame. The position is that of the centre, half the length behind the front.
/// assert_eq!(bus.point(NOW), [5.0, 0.0]);
/// assert_eq!(bus.oriented_box(NOW).corners()[0], [11.0, 1.25]);
/// assert_eq!(bus.ground(NOW), 0.0);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Identifier, unique in the scene.
    pub id: String,
    /// Kind.
    pub kind: TrackKind,
    /// Centre, metres, with height.
    pub position: Vec<[f64; 3]>,
    /// Heading, radians, not wrapped.
    pub heading: Vec<f64>,
    /// Velocity, m/s.
    pub velocity: Vec<Point>,
    /// Length, width, height, metres.
    pub size: Vec<[f64; 3]>,
    /// Whether the frame is valid: the road user was observed.
    pub valid: Vec<bool>,
}

impl Track {
    /// Whether the frame exists and is valid.
    #[inline]
    pub fn is_valid(&self, frame: usize) -> bool {
        self.valid.get(frame).copied().unwrap_or(false)
    }

    /// Position in the plane at a frame.
    #[inline]
    pub fn point(&self, frame: usize) -> Point {
        let [x, y, _] = self.position[frame];
        [x, y]
    }

    /// Height of the ground under it at a frame, metres.
    #[inline]
    pub fn ground(&self, frame: usize) -> f64 {
        self.position[frame][2] - 0.5 * self.size[frame][2]
    }

    /// Whether it drives backwards at a frame: it moves, and more than 90° off its heading. The motion is that from the frame
    /// before, or the recorded velocity if that frame is not valid.
    pub fn reverses(&self, frame: usize) -> bool {
        if !self.is_valid(frame) {
            return false;
        }
        let before = frame.checked_sub(1).filter(|before| self.is_valid(*before));
        let velocity = match before {
            Some(before) => sub(self.point(frame), self.point(before)).map(|d| d / DT),
            None => self.velocity[frame],
        };
        let (sin, cos) = self.heading[frame].sin_cos();
        norm(velocity) >= paper::MOVING && dot(velocity, [cos, sin]) < 0.0
    }

    /// Box at a frame with that frame's logged heading and size.
    #[inline]
    pub fn oriented_box(&self, frame: usize) -> OrientedBox {
        let [length, width, _] = self.size[frame];
        OrientedBox::new(self.point(frame), self.heading[frame], length, width)
    }

    /// Whether it is a parked vehicle by MetaDrive's rule: its valid positions have a standard deviation of at
    /// most 3 m on either axis.
    pub fn is_parked(&self) -> bool {
        let deviation = |axis: usize| {
            let valid = || self.position.iter().zip(&self.valid).filter(|(_, v)| **v).map(|(p, _)| p[axis]);
            let n = valid().count().max(1) as f64;
            let mean = valid().sum::<f64>() / n;
            (valid().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt()
        };
        self.kind == TrackKind::Vehicle && deviation(0).max(deviation(1)) <= PARKED
    }

    /// The recording up to *now*, then a trajectory as far as the recording reaches: position, heading by the
    /// `paper` convention, or the recorded one if it repeats the recording, velocity, the last size up to *now*. Later frames are
    /// not valid.
    pub fn following(&self, trajectory: &Trajectory) -> Self {
        let mut track = self.clone();
        let last = (0..=NOW).rev().find(|&frame| track.is_valid(frame)).unwrap_or(NOW);
        let start = Pose { position: track.point(last), heading: track.heading[last] };
        let repeated = self.headings_if_repeated(trajectory);
        let axes = paper::profile_from(trajectory.points(), &start, self.reverses(last)).axis;
        let (height, size) = (track.position[last][2], track.size[last]);
        let mut before = start.position;
        // If the last valid frame is earlier than *now*, the first step takes more than one frame.
        let mut elapsed = (NOW + 1 - last) as f64 * DT;
        let frames = NOW + 1..track.valid.len();
        for (frame, (&[x, y], axis)) in frames.zip(trajectory.points().iter().zip(&axes)) {
            track.position[frame] = [x, y, height];
            track.heading[frame] = match &repeated {
                Some(headings) => headings[frame - NOW - 1],
                None => axis[1].atan2(axis[0]),
            };
            track.velocity[frame] = sub([x, y], before).map(|d| d / elapsed);
            track.size[frame] = size;
            track.valid[frame] = true;
            (before, elapsed) = ([x, y], DT);
        }
        // The trajectory says nothing of later frames, and the recording there is of another drive.
        track.valid.iter_mut().skip(NOW + 1 + trajectory.points().len()).for_each(|valid| *valid = false);
        track
    }

    /// The recorded headings after *now*, if a trajectory repeats the recorded positions; where the recording has gaps, the last
    /// heading before. A car may drive backwards there, which positions alone do not say.
    pub fn headings_if_repeated(&self, trajectory: &Trajectory) -> Option<Vec<f64>> {
        let points = trajectory.points();
        let valid = || (NOW + 1..self.valid.len().min(NOW + 1 + points.len())).filter(|f| self.valid[*f]);
        if valid().next().is_none() || valid().any(|f| self.point(f) != points[f - NOW - 1]) {
            return None;
        }
        let before = (0..=NOW).rev().chain(valid()).find(|f| self.is_valid(*f))?;
        let mut heading = self.heading[before];
        Some(
            (NOW + 1..NOW + 1 + points.len())
                .map(|frame| {
                    if self.is_valid(frame) {
                        heading = self.heading[frame];
                    }
                    heading
                })
                .collect(),
        )
    }

    /// Number of valid frames among `frames`, as far as they exist.
    pub fn count_valid(&self, frames: std::ops::Range<usize>) -> usize {
        let end = frames.end.min(self.valid.len());
        let start = frames.start.min(end);
        self.valid[start..end].iter().filter(|v| **v).count()
    }

    /// Least and greatest height of the centre over valid frames.
    pub fn height_range(&self) -> Option<(f64, f64)> {
        let heights = self.position.iter().zip(&self.valid).filter(|(_, valid)| **valid);
        heights.fold(None, |range, (p, _)| {
            let (lo, hi) = range.unwrap_or((p[2], p[2]));
            Some((lo.min(p[2]), hi.max(p[2])))
        })
    }

    pub(super) fn append_numbers(&self, out: &mut Vec<f64>) {
        out.extend(self.position.iter().flatten());
        out.extend(&self.heading);
        out.extend(self.velocity.iter().flatten());
        out.extend(self.size.iter().flatten());
        out.extend(self.valid.iter().map(|&v| f64::from(u8::from(v))));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_other_formats_have_their_kind_in_any_case() {
        let known = [
            (TrackKind::Vehicle, "VEHICLE CAR VAN BUS SCHOOL_BUS TRUCK TRAILER MOTORCYCLE MOTORCYCLIST"),
            (TrackKind::Pedestrian, "PEDESTRIAN"),
            (TrackKind::Cyclist, "CYCLIST BICYCLE"),
        ];
        for (kind, names) in &known {
            for name in names.split(' ') {
                let title = format!("{}{}", &name[..1], name[1..].to_lowercase());
                for name in [name, &name.to_lowercase(), &title] {
                    assert_eq!(TrackKind::from_name(name), *kind, "{name}");
                }
            }
        }
        for name in [
            "RIDERLESS_BICYCLE",
            "riderless_bicycle",
            "TRAFFIC_CONE",
            "STATIC",
            "Animal",
            "CARS",
            "BUS ",
            "1",
        ] {
            let kind = TrackKind::from_name(name);
            assert_eq!((kind.name(), kind.is_unknown()), (name, false), "files keep their own word");
        }
        for name in ["UNSET", "UNKNOWN", "NONE", "", "unknown", "None"] {
            assert!(TrackKind::from_name(name).is_unknown(), "{name}");
        }
    }
}
