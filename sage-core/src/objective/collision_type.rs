//! What sort of accident a contact would be called.

use serde::{Deserialize, Serialize};

use super::{Criticality, SideHit, Situation};

/// Sorts of accidents, told by the ego's side that is hit and how the two are turned to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CollisionType {
    /// The adversary runs into the ego from behind.
    RearEnd,
    /// The ego runs into the adversary, which drives the same way in front of it.
    CutIn,
    /// Both drive the same way, side by side.
    Sideswipe,
    /// The adversary crosses in front of the ego.
    Crossing,
    /// The adversary runs into the ego's side.
    SideImpact,
    /// They meet face to face.
    HeadOn,
}

/// Turned less than this they drive the same way, and more than the rest to half a turn, radians.
const ALONG: f64 = std::f64::consts::FRAC_PI_4;

impl CollisionType {
    /// All of them.
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

    /// That of a candidate which touches the ego; `None` without contact.
    pub fn of(situation: &Situation, criticality: &Criticality) -> Option<Self> {
        let step = situation.encounter.contact?;
        let ([a, b], [c, d]) = (situation.ego.box_at(step)?.axis, situation.candidate.boxes()[step - 1].axis);
        let turn = (a * d - b * c).atan2(a * c + b * d).abs();
        Some(Self::told_by(criticality.side_hit?, turn))
    }

    fn told_by(side: SideHit, turn: f64) -> Self {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn side_and_turn_tell_the_sort() {
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
            assert_eq!(CollisionType::told_by(side, turn), kind, "{side:?} at {turn}");
        }
    }
}
