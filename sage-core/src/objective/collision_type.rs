//! Collision types of contacts between adversary and ego.

use serde::{Deserialize, Serialize};

use super::{Criticality, SideHit, Situation};
use crate::geometry::OrientedBox;

/// Collision types, defined by the side of the ego that is hit and the angle between the headings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CollisionType {
    /// The adversary hits the ego from behind.
    RearEnd,
    /// The ego hits the adversary, which has cut in ahead of it in the same direction.
    CutIn,
    /// Both drive in the same direction, side by side.
    Sideswipe,
    /// The adversary crosses in front of the ego.
    Crossing,
    /// The adversary hits the ego's side.
    SideImpact,
    /// Both drive in opposite directions.
    HeadOn,
}

/// Headings that differ by less than this count as the same direction; by more than π minus this, as
/// opposite directions, radians.
const ALONG: f64 = std::f64::consts::FRAC_PI_4;

impl CollisionType {
    /// All collision types.
    pub const ALL: [Self; 6] =
        [Self::RearEnd, Self::CutIn, Self::Sideswipe, Self::Crossing, Self::SideImpact, Self::HeadOn];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::RearEnd => "rear-end",
            Self::CutIn => "cut-in",
            Self::Sideswipe => "sideswipe",
            Self::Crossing => "crossing",
            Self::SideImpact => "side-impact",
            Self::HeadOn => "head-on",
        }
    }

    /// Collision type of a candidate that touches the ego; `None` without contact.
    pub fn of(situation: &Situation, criticality: &Criticality) -> Option<Self> {
        let step = situation.encounter.contact?;
        let (ego, adversary) = (situation.ego.box_at(step)?, &situation.candidate.boxes()[step - 1]);
        Some(Self::classify(criticality.side_hit?, turn(ego, adversary)))
    }

    /// Collision type of two boxes that touch.
    pub fn between(ego: &OrientedBox, adversary: &OrientedBox) -> Self {
        Self::classify(SideHit::of(ego, adversary), turn(ego, adversary))
    }

    fn classify(side: SideHit, turn: f64) -> Self {
        let opposed = turn > std::f64::consts::PI - ALONG;
        match side {
            _ if opposed => Self::HeadOn,
            SideHit::Rear if turn < ALONG => Self::RearEnd,
            SideHit::Front if turn < ALONG => Self::CutIn,
            SideHit::Left | SideHit::Right if turn < ALONG => Self::Sideswipe,
            SideHit::Front => Self::Crossing,
            _ => Self::SideImpact,
        }
    }
}

/// Angle between the headings of two boxes, rad, 0 to π.
fn turn(ego: &OrientedBox, adversary: &OrientedBox) -> f64 {
    let ([a, b], [c, d]) = (ego.axis, adversary.axis);
    (a * d - b * c).atan2(a * c + b * d).abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn side_and_angle_define_the_collision_type() {
        use CollisionType::*;
        let cases = [
            (SideHit::Rear, 0.1, RearEnd),
            (SideHit::Front, 0.1, CutIn),
            (SideHit::Left, 0.3, Sideswipe),
            (SideHit::Right, 1.5, SideImpact),
            (SideHit::Front, 1.5, Crossing),
            (SideHit::Front, 3.0, HeadOn),
            (SideHit::Left, 3.0, HeadOn),
            (SideHit::Rear, 1.5, SideImpact),
        ];
        for (side, turn, kind) in cases {
            assert_eq!(CollisionType::classify(side, turn), kind, "{side:?} at {turn}");
        }
    }
}
