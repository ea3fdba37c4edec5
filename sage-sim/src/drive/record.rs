//! The record of a drive.

use sage_core::{
    geometry::{OrientedBox, Point, distance},
    scene::Map,
};

use crate::{body::Body, policy::Shown, vehicle::Motion, world::Control};

/// The record of a drive.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drive {
    /// Motion at each step, the start first.
    pub motions: Vec<Motion>,
    /// First contact with each road user, in the order of time. A contact that lasts from the start is none.
    pub contacts: Vec<DriveContact>,
    /// Progress along the route, metres, from the start to the farthest point.
    pub progress: f64,
    /// When the car leaves the road.
    pub off_road: OffRoad,
    /// What the driver showed, in the order of the steps.
    pub shown: Vec<Shown>,
    /// What the car did in each step.
    pub(crate) controls: Vec<Control>,
}

/// When a car leaves the road: it touches an edge, or is on a sidewalk. What it touches at the start does not count until it
/// has left it, because recorded boxes overlap kerbs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OffRoad {
    /// The map has no edges: tables leave it out.
    #[default]
    NotMeasured,
    /// At no step.
    Never,
    /// First at this step.
    At(usize),
}

impl OffRoad {
    /// The record of a drive that begins on a map.
    pub fn start(map: &Map) -> Self {
        if map.has_edges() { Self::Never } else { Self::NotMeasured }
    }

    /// The first step off the road, if there is one.
    pub fn step(self) -> Option<usize> {
        match self {
            Self::At(step) => Some(step),
            Self::Never | Self::NotMeasured => None,
        }
    }

    /// Whether the map says where the road ends.
    pub fn is_measured(self) -> bool {
        self != Self::NotMeasured
    }
}

impl Drive {
    /// A drive of which only the motions are known.
    pub fn of_motions(motions: Vec<Motion>) -> Self {
        Self { motions, ..Self::default() }
    }

    /// Distance of the car from where its newest plan has it, metres, for each step that a plan has a row for; up to a step.
    pub fn distances_to_plan(&self, until: usize) -> Vec<f64> {
        let mut distances = Vec::new();
        for (k, shown) in self.shown.iter().enumerate() {
            let next = self.shown.get(k + 1).map_or(usize::MAX, |next| next.step);
            let rows = shown.plan.iter().enumerate().skip(1);
            // The plan holds where the car is at the step itself.
            let due = rows
                .map(|(row, point)| (shown.step + row, point))
                .take_while(|(step, _)| *step <= next.min(until));
            distances.extend(due.filter_map(|(step, point)| {
                self.motions.get(step).map(|motion| distance(motion.position, *point))
            }));
        }
        distances
    }

    /// The car's box at the end of the step of a contact.
    pub(crate) fn area(&self, contact: &DriveContact) -> OrientedBox {
        let (motion, sizes) = (&self.motions[contact.step], &contact.areas[0]);
        let [length, width] = [2.0 * sizes.half_length, 2.0 * sizes.half_width];
        OrientedBox::new(motion.position, motion.heading, length, width)
    }
}

/// A contact of the car with one road user: the first.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveContact {
    /// Step of the drive, 1 the first after frame 0: the frame of the contact. *Now* is frame 10.
    pub step: usize,
    /// Substep, 1 to 5.
    pub substep: usize,
    /// The car before that step: a contact changes its velocity.
    pub car: Motion,
    /// The other road user at that step.
    pub other: Body,
    /// Boxes of the car and of the other when they meet.
    pub areas: [OrientedBox; 2],
    /// Velocities of the car and of the other in that step until they meet, m/s.
    pub velocities: [Point; 2],
    /// Whether the other came into being within 0.3 s before: recordings have gaps.
    pub appeared: bool,
}
