//! What happens when a driver drives the unchanged scene.

use crate::{
    comfort::is_comfortable,
    drive::{Drive, OffRoad},
    fault::{FaultClass, classify},
    red_lights::over_red,
    scene::SimScene,
    vehicle::{Motion, Vehicle},
    wrong_way::is_wrong_way,
};

/// Largest distance from a plan at which a car counts as on it, metres.
pub const ON_PLAN: f64 = 0.3;

/// Scenes with a shorter logged drive have no completion, metres.
const SHORTEST_LOG: f64 = 5.0;

/// A drive in the unchanged scene.
#[derive(Clone, Debug)]
pub struct UnattackedDrive {
    /// Number of steps of 0.1 s.
    pub steps: usize,
    /// First contacts: frame, track and class.
    pub contacts: Vec<(usize, String, FaultClass)>,
    /// When the car leaves the road.
    pub off_road: OffRoad,
    /// Whether the recording leaves it too.
    pub recording_leaves_road: bool,
    /// Progress by the progress of the log; `None` if that is below 5 m.
    pub completion: Option<f64>,
    /// Whether it keeps nuPlan's bounds of comfort, up to its first contact.
    pub is_comfortable: Option<bool>,
    /// Frames at which it runs over red, up to its first contact; `None` without a light ahead on its route.
    pub over_red: Option<Vec<usize>>,
    /// Whether it drives against the lanes for half a second, up to its first contact, and the recording does not; `None` on a
    /// map without lanes.
    pub wrong_way: Option<bool>,
    /// Largest distance of the car from its newest plan, metres, up to its first contact; `None` for a driver that shows no plan.
    pub off_plan: Option<f64>,
    /// Share of the steps in which it is within [`ON_PLAN`] of it.
    pub on_plan: Option<f64>,
    /// The same driver once more in the same scene, if that was asked.
    pub again: Option<Again>,
}

/// A second drive in the same scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Again {
    /// Whether it is the same, bit for bit.
    pub is_same: bool,
    /// Mean time of its steps, milliseconds.
    pub step_time: Option<f64>,
}

impl UnattackedDrive {
    /// The facts of a drive of a car.
    pub fn of(drive: &Drive, scene: &SimScene, car: &Vehicle) -> Self {
        let log = scene.window_length();
        let contacts = drive.contacts.iter().map(|contact| {
            let track = scene.scene().tracks[contact.other.track].id.clone();
            (contact.step, track, classify(contact, car, scene.index()))
        });
        let until = until_contact(drive);
        let distances = drive.distances_to_plan(until.len().saturating_sub(1));
        Self {
            steps: drive.motions.len() - 1,
            contacts: contacts.collect(),
            off_road: drive.off_road,
            recording_leaves_road: drive.off_road.step().is_some() && scene.recording_leaves_road(),
            completion: (log >= SHORTEST_LOG).then(|| drive.progress / log),
            is_comfortable: is_comfortable(until),
            over_red: over_red(scene, until),
            wrong_way: is_wrong_way(until, scene),
            off_plan: distances.iter().copied().reduce(f64::max),
            on_plan: (!distances.is_empty()).then(|| {
                distances.iter().filter(|distance| **distance <= ON_PLAN).count() as f64
                    / distances.len() as f64
            }),
            again: None,
        }
    }

    /// Whether the ego is at fault in its first contact. Later ones are consequences of the first.
    pub fn is_at_fault(&self) -> bool {
        let first = self.contacts.first().map(|(step, ..)| *step);
        let at_first = self.contacts.iter().filter(|(step, ..)| Some(*step) == first);
        at_first.into_iter().any(|(_, _, class)| class.is_at_fault() == Some(true))
    }

    /// Whether the car leaves the road before any contact, and the recording does not; `None` on a map without edges.
    pub fn is_off_road(&self) -> Option<bool> {
        let first = self.contacts.first().map_or(usize::MAX, |(step, ..)| *step);
        let is_before = self.off_road.step().is_some_and(|step| step < first);
        self.off_road.is_measured().then_some(is_before && !self.recording_leaves_road)
    }
}

/// The motions before the first contact: what it does to the car is not the driver's.
pub(crate) fn until_contact(drive: &Drive) -> &[Motion] {
    let end = drive.contacts.first().map_or(drive.motions.len(), |contact| contact.step);
    &drive.motions[..end.min(drive.motions.len())]
}
