//! What the results of attacks are of, in the order of their rows.

use super::Attacks;
use crate::{
    rows::{Key, Subject},
    study::PlannedAgainst,
};

/// Arm of attacks on the recording.
const RECORDING: &str = "recording";

/// What a result is of. Drivers, groups, generators, points and targets are given by their numbers; without drivers the recorded ego is
/// number 0.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Slot {
    /// The drive of a driver in the unchanged scene.
    Drive { ego: usize },
    /// An attack of a generator at a point.
    Attack { by: Source, point: usize, what: OfAttack },
}

/// Attacks of a generator.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Source {
    pub(super) ego: usize,
    /// The path that attacks on a driver are planned against; `None` for the recorded ego.
    pub(super) path: Option<PlannedAgainst>,
    pub(super) group: usize,
    pub(super) generator: usize,
}

/// What is measured of an attack.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum OfAttack {
    /// The plan.
    Plan,
    /// The plan whose latest start is nearest to a target.
    AtTarget(usize),
    /// The attacked drive.
    Drive,
}

impl Slot {
    pub(super) fn ego(&self) -> usize {
        match self {
            Self::Drive { ego } | Self::Attack { by: Source { ego, .. }, .. } => *ego,
        }
    }

    pub(super) fn source(&self) -> Option<Source> {
        match self {
            Self::Drive { .. } => None,
            Self::Attack { by, .. } => Some(*by),
        }
    }
}

impl Attacks {
    /// Ego by ego: the unchanged drive, then for each group, path, generator and point the plan, or the plan at each target, and the
    /// attacked drive.
    pub(super) fn make_slots(&self) -> Vec<Slot> {
        let mut slots = Vec::new();
        for ego in 0..self.egos.len().max(1) {
            let is_driver = ego < self.egos.len();
            if is_driver && self.measures.drive {
                slots.push(Slot::Drive { ego });
            }
            let groups = 0..self.groups.len();
            for (group, path) in groups.flat_map(|group| self.paths(is_driver).map(move |path| (group, path)))
            {
                for (generator, built) in self.groups[group].built.iter().enumerate() {
                    let by = Source { ego, path, group, generator };
                    for point in 0..built.keys.len() {
                        let slot = |what| Slot::Attack { by, point, what };
                        if self.measures.trajectory && self.targets.is_empty() {
                            slots.push(slot(OfAttack::Plan));
                        }
                        slots.extend((0..self.targets.len()).map(OfAttack::AtTarget).map(slot));
                        if self.measures.attacked_drive && is_driver {
                            slots.push(slot(OfAttack::Drive));
                        }
                    }
                }
            }
        }
        slots
    }

    /// How rows name a slot.
    pub(super) fn key(&self, slot: &Slot) -> Key {
        let ego = self.egos.get(slot.ego());
        let knows = || ego.map(|ego| ego.policy.knows().to_string()).unwrap_or_default();
        let label = ego.map(|ego| ego.label.clone());
        let (by, point, what) = match *slot {
            Slot::Drive { .. } => {
                let arm = label.unwrap_or_default();
                return Key { knows: knows(), ..Key::new(Subject::Drive, &*arm, self.seed) };
            }
            Slot::Attack { by, point, what } => (by, point, what),
        };
        let group = &self.groups[by.group];
        let built = &group.built[by.generator];
        let labels = [label, Some(group.arm.clone())];
        let labels: Vec<String> = labels.into_iter().flatten().filter(|label| !label.is_empty()).collect();
        let arm = if labels.is_empty() { RECORDING.to_owned() } else { labels.join(", ") };
        let (subject, target, knows) = match what {
            OfAttack::Plan => (Subject::Trajectory, None, built.facts.knows.beyond_now()),
            OfAttack::AtTarget(k) => {
                (Subject::Trajectory, Some(self.targets[k]), built.facts.knows.beyond_now())
            }
            OfAttack::Drive => (Subject::AttackedDrive, None, knows()),
        };
        let made_against = match (by.path, self.planned_against.len()) {
            (_, 1) | (None, _) => "",
            (Some(PlannedAgainst::Drive), _) => "its drive",
            (Some(PlannedAgainst::Log), _) => "the log",
        };
        let row = &built.keys[point];
        Key {
            made_against: made_against.to_owned(),
            training_seed: group.training_seed,
            attack: row.part().to_string(),
            point: row.point.clone(),
            target,
            knows,
            ..Key::new(subject, &*arm, self.seed)
        }
    }
}
