//! How far a path may lead: limits that no road user reaches.
//!
//! What follows a path samples it at a fixed spacing, so a small file with one far position would take time and
//! memory without bound. Readers of tracks, trajectories and drives check these limits.

use crate::geometry::{Point, distance};

/// Longest step of a path from one frame to the next, metres: 1000 m/s at 10 Hz. Across frames that are not valid,
/// each of them counts.
pub const MAX_STEP: f64 = 100.0;
/// Longest path, metres: two hours at 100 km/h.
pub const MAX_PATH: f64 = 200e3;

/// A path beyond a limit.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("is {}; expected {}", self.found(), self.expected())]
pub enum PathTooLong {
    /// A step beyond [`MAX_STEP`].
    Step {
        /// Frame at the end of the step.
        frame: usize,
        /// Length of the step, metres.
        length: f64,
    },
    /// A path beyond [`MAX_PATH`].
    Path {
        /// Frame at which the limit is exceeded.
        frame: usize,
    },
}

impl PathTooLong {
    /// Frame at which the path exceeds a limit.
    pub fn frame(&self) -> usize {
        match self {
            Self::Step { frame, .. } | Self::Path { frame } => *frame,
        }
    }

    /// What is wrong with the position of that frame.
    pub fn found(&self) -> String {
        match self {
            Self::Step { length, .. } => format!("{length:.0} m from the position before"),
            Self::Path { .. } => format!("at the end of a path longer than {:.0} km", 1e-3 * MAX_PATH),
        }
    }

    /// What is accepted instead.
    pub fn expected(&self) -> String {
        match self {
            Self::Step { .. } => format!("at most {MAX_STEP} m a frame"),
            Self::Path { .. } => format!("at most {:.0} km", 1e-3 * MAX_PATH),
        }
    }
}

/// Checks the positions of a path, each with its frame, in ascending order. NaN is no position.
///
/// *Errors*: the first position beyond [`MAX_STEP`] or [`MAX_PATH`].
pub fn check_path(positions: impl IntoIterator<Item = (usize, Point)>) -> Result<(), PathTooLong> {
    let mut positions = positions.into_iter();
    let Some(mut last) = positions.next() else { return Ok(()) };
    let mut total = 0.0;
    for (frame, point) in positions {
        let length = distance(last.1, point);
        // NaN fails the comparison as well.
        if !(length <= MAX_STEP * (frame - last.0) as f64) {
            return Err(PathTooLong::Step { frame, length });
        }
        total += length;
        if total > MAX_PATH {
            return Err(PathTooLong::Path { frame });
        }
        last = (frame, point);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_refused_and_a_gap_counts_each_frame() {
        let at = |x: f64, frame: usize| (frame, [x, 0.0]);
        assert_eq!(check_path([]), Ok(()));
        assert_eq!(check_path([at(0.0, 0), at(MAX_STEP, 1), at(0.0, 2)]), Ok(()));
        let jump = check_path([at(0.0, 0), at(1.001 * MAX_STEP, 1)]).unwrap_err();
        assert_eq!((jump.frame(), jump.to_string().contains("100 m from the position before")), (1, true));
        assert_eq!(check_path([at(0.0, 0), at(2.0 * MAX_STEP, 2)]), Ok(()));
        assert!(check_path([at(0.0, 0), at(f64::NAN, 1)]).is_err());
    }

    #[test]
    fn a_long_path_of_short_steps_is_refused() {
        let to_and_fro = |k: usize| (k, [MAX_STEP * (k % 2) as f64, 0.0]);
        let steps = (MAX_PATH / MAX_STEP) as usize;
        assert_eq!(check_path((0..=steps).map(to_and_fro)), Ok(()));
        let found = check_path((0..=steps + 1).map(to_and_fro));
        assert_eq!(found, Err(PathTooLong::Path { frame: steps + 1 }));
    }
}
