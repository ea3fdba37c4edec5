//! Checkpoints on the route: where the car is to go next.

use sage_core::geometry::{Point, dot, sub};

use crate::{
    route::{Coordinates, Localization, Route},
    vehicle::Motion,
};

/// Distance between checkpoints, metres.
const SPACING: f64 = 8.0;
/// A car this far to the right of the route keeps its checkpoints, metres.
const ASIDE: f64 = 2.0;
/// Reach of the navigation numbers, metres.
const REACH: f64 = 50.0;

/// The next two checkpoints of a car, and its place on the route.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Navigation {
    next: [usize; 2],
    /// Whether a car aside of the route keeps its checkpoints, as in MetaDrive: on the right only.
    keeps_aside: bool,
    /// Coordinates on the route at the last update.
    pub at: Coordinates,
}

impl Navigation {
    /// Navigation at the start of a drive.
    pub fn start(route: &Route, how: Localization, position: Point, keeps_aside: bool) -> Self {
        let mut navigation = Self { next: [0, 1], keeps_aside, at: Coordinates::default() };
        navigation.update(route, how, position);
        navigation
    }

    /// Updates the checkpoints for a position. They stay once both are the end of the route.
    pub fn update(&mut self, route: &Route, how: Localization, position: Point) {
        let found = match how {
            Localization::Nearest => route.locate(position, how),
            Localization::MetaDrive => route.locate_restricted(position),
        };
        self.at = found;
        let last = last(route);
        if self.next == [last, last] || (self.keeps_aside && found.across >= ASIDE) {
            return;
        }
        // Truncation towards zero, as in MetaDrive: just before the start counts as the first stretch.
        let stretch = (found.along / SPACING).trunc() + 1.0;
        let next = stretch.clamp(0.0, last as f64) as usize;
        self.next = [next, (next + 1).min(last)];
    }

    /// The two checkpoints, metres.
    pub fn checkpoints(&self, route: &Route) -> [Point; 2] {
        let last = last(route);
        self.next.map(|k| {
            let along = if k >= last { route.length() } else { k as f64 * SPACING };
            route.point_metadrive(Coordinates { along, across: 0.0 })
        })
    }

    /// Vectors to the checkpoints in the frame of a motion: forward and left, each in [0, 1], 0.5 for none.
    pub fn numbers(&self, route: &Route, motion: &Motion) -> [[f64; 2]; 2] {
        let (sin, cos) = motion.heading.sin_cos();
        self.checkpoints(route).map(|checkpoint| {
            let mut d = sub(checkpoint, motion.position);
            let length = dot(d, d).sqrt();
            if length > REACH {
                d = d.map(|x| x * REACH / length);
            }
            let local = [d[0] * cos + d[1] * sin, d[1] * cos - d[0] * sin];
            local.map(|x| (0.5 * (x / REACH + 1.0)).clamp(0.0, 1.0))
        })
    }
}

/// Index of the last checkpoint, the end of the route.
fn last(route: &Route) -> usize {
    (route.length() / SPACING) as usize
}
