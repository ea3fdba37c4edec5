//! When a road user is there.

use sage_core::{
    geometry::{norm, sub},
    scene::Track,
};

use super::actions::Pose;

/// Longest gap in a recording that a player bridges by interpolation, frames. In a longer one the road user
/// leaves and appears again.
const LONGEST_GAP: usize = 10;
/// Largest displacement of a road user that stands, metres.
const STANDS: f64 = 0.1;

/// A stretch of frames in which a road user is there. Its first and last frames are valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stretch {
    pub(super) first: usize,
    pub(super) last: usize,
}

impl Stretch {
    /// The stretches of a track, in order.
    pub(super) fn all(track: &Track, frames: usize) -> Vec<Self> {
        let mut stretches: Vec<Self> = Vec::new();
        for frame in (0..frames).filter(|frame| track.is_valid(*frame)) {
            match stretches.last_mut() {
                Some(stretch) if frame - stretch.last - 1 <= LONGEST_GAP => stretch.last = frame,
                _ => stretches.push(Self { first: frame, last: frame }),
            }
        }
        stretches
    }

    /// The valid frames of a track within the stretch.
    pub(super) fn frames(self, track: &Track) -> impl Iterator<Item = usize> {
        (self.first..=self.last).filter(|frame| track.is_valid(*frame))
    }

    /// Whether the track leaves a place of 0.1 m.
    pub(super) fn moves(self, track: &Track) -> bool {
        let start = track.point(self.first);
        self.frames(track).any(|frame| norm(sub(track.point(frame), start)) > STANDS)
    }

    /// Whether the file needs a trajectory, because the road user does not stay in its first written pose.
    /// Heights of parked cars vary with the sensor by some centimetres, and do not count.
    pub(super) fn needs_trajectory(self, track: &Track, origin: [f64; 3]) -> bool {
        let start = Pose::of(track, self.first, origin);
        self.frames(track).any(|frame| !Pose::of(track, frame, origin).stays_at(start, STANDS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::scene::TrackKind;

    #[test]
    fn gaps_of_up_to_ten_frames_are_bridged() {
        let mut valid = vec![false; 40];
        for frame in [0, 1, 12, 24, 39] {
            valid[frame] = true;
        }
        let track = Track {
            id: String::new(),
            kind: TrackKind::Vehicle,
            position: vec![[0.0; 3]; 40],
            heading: vec![0.0; 40],
            velocity: vec![[0.0; 2]; 40],
            size: vec![[1.0; 3]; 40],
            valid,
        };
        let stretch = |first, last| Stretch { first, last };
        assert_eq!(Stretch::all(&track, 40), [stretch(0, 12), stretch(24, 24), stretch(39, 39)]);
        assert_eq!(stretch(0, 12).frames(&track).collect::<Vec<_>>(), [0, 1, 12]);
    }
}
