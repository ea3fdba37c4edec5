//! Collision types of contacts between adversary and ego, by what happened up to them.
//!
//! | type | what happened |
//! | --- | --- |
//! | `rear-ended` | the adversary drives into the ego's rear, in the same direction |
//! | `rear-end` | the ego drives into the adversary, which was ahead in its path for 1.5 s, or since *now* |
//! | `cut-in` | the same, but the adversary came into its path later than that |
//! | `sideswipe` | side against side in the same direction |
//! | `oncoming` | in opposite directions |
//! | `turning-across` | at an angle, and 3 s before, or *now*, in the same or in opposite directions: one of them turned |
//! | `crossing` | at an angle, and at an angle before |
//!
//! Directions are the same if the headings differ by less than 45°, and opposite if by more than 135°. The ego's *path* leads
//! from where it is to the contact, and straight on from there. A car is in it if its centre is at most half the larger width
//! beside it, and its direction the same.

use serde::{Deserialize, Serialize};

use super::{SideHit, Situation};
use crate::geometry::{OrientedBox, Point, dot, norm, sub};

/// Collision types: the module defines them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CollisionType {
    /// The ego drives into a car that was ahead of it.
    RearEnd,
    /// The ego drives into a car that came into its path.
    CutIn,
    /// At an angle, both since before.
    Crossing,
    /// At an angle, because one of them turned.
    TurningAcross,
    /// In opposite directions.
    Oncoming,
    /// Side against side, in the same direction.
    Sideswipe,
    /// The adversary drives into the ego's rear.
    RearEnded,
}

/// Cosine of 45°, within which directions are the same.
const ALONG: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Steps for which a car ahead was in the path, if it did not cut in.
const AHEAD: usize = 15;
/// Steps before the contact at which its earlier direction is looked at.
const BEFORE: usize = 30;

impl CollisionType {
    /// All collision types.
    pub const ALL: [Self; 7] = [
        Self::RearEnd,
        Self::CutIn,
        Self::Crossing,
        Self::TurningAcross,
        Self::Oncoming,
        Self::Sideswipe,
        Self::RearEnded,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::RearEnd => "rear-end",
            Self::CutIn => "cut-in",
            Self::Crossing => "crossing",
            Self::TurningAcross => "turning-across",
            Self::Oncoming => "oncoming",
            Self::Sideswipe => "sideswipe",
            Self::RearEnded => "rear-ended",
        }
    }

    /// Collision type of a candidate that touches the ego; `None` without contact.
    pub fn of(situation: &Situation) -> Option<Self> {
        let step = situation.encounter.contact?;
        let ego: Option<Vec<OrientedBox>> =
            (1..=step).map(|step| situation.ego.box_at(step).copied()).collect();
        Self::between(&ego?, &situation.candidate.boxes()[..step])
    }

    /// Collision type of two cars by their boxes at the steps after *now*, the last that of the contact; `None` without
    /// boxes.
    pub fn between(ego: &[OrientedBox], adversary: &[OrientedBox]) -> Option<Self> {
        let last = ego.len().min(adversary.len()).checked_sub(1)?;
        let cosine = |step: usize| dot(ego[step].axis, adversary[step].axis);
        let (now, before) = (cosine(last), cosine(last.saturating_sub(BEFORE)));
        let is_at_angle = |cosine: f64| cosine.abs() <= ALONG;
        if is_at_angle(now) {
            return Some(if is_at_angle(before) { Self::Crossing } else { Self::TurningAcross });
        }
        if now < 0.0 {
            return Some(Self::Oncoming);
        }
        Some(match SideHit::of(&ego[last], &adversary[last]) {
            SideHit::Rear => Self::RearEnded,
            SideHit::Left | SideHit::Right => Self::Sideswipe,
            SideHit::Front => {
                let mut steps = last.saturating_sub(AHEAD)..=last;
                let was_ahead = steps.all(|step| is_in_path(&ego[step..=last], &adversary[step]));
                if was_ahead { Self::RearEnd } else { Self::CutIn }
            }
        })
    }
}

/// Whether a car is in the path of another, given by its boxes from now to the contact.
fn is_in_path(path: &[OrientedBox], car: &OrientedBox) -> bool {
    /// Straight part after the contact, metres.
    const ON: f64 = 100.0;
    let end = &path[path.len() - 1];
    let on = [end.center[0] + ON * end.axis[0], end.center[1] + ON * end.axis[1]];
    let points = path.iter().map(|area| area.center).chain([on]);
    let nearest =
        points.clone().zip(points.skip(1)).zip(path).map(|((a, b), area)| (beside(a, b, car.center), area));
    let nearest = nearest.min_by(|a, b| a.0.total_cmp(&b.0));
    nearest.is_some_and(|(distance, area)| {
        distance <= area.half_width.max(car.half_width) && dot(area.axis, car.axis) > ALONG
    })
}

/// Distance of a point from a straight way, metres.
fn beside(a: Point, b: Point, p: Point) -> f64 {
    let (way, to) = (sub(b, a), sub(p, a));
    let length2 = dot(way, way);
    let share = if length2 > 0.0 { (dot(way, to) / length2).clamp(0.0, 1.0) } else { 0.0 };
    norm([to[0] - share * way[0], to[1] - share * way[1]])
}
