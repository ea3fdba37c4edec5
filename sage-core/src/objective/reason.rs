//! Why a person would not believe an attack, with its words.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::{
    Violation,
    violation::{LATERAL_ACCELERATION, TURNING_CIRCLE},
};
use crate::motion::DT;

/// Least overlap depth of a believable attack, metres. Replayed in MetaDrive, nearly all contacts deeper than
/// 0.6 m touch the ego, and none below 0.3 m.
pub const MIN_DEPTH: f64 = 0.5;

/// Of cars.
pub(super) const AGAINST_TRAFFIC: &str = "against_traffic";
pub(super) const ACROSS_LANES: &str = "across_lanes";
pub(super) const U_TURN: &str = "u_turn";
pub(super) const WRONG_LANE: &str = "wrong_lane";
pub(super) const HARD_ACCELERATION: &str = "acceleration";
pub(super) const HARD_BRAKING: &str = "braking";
pub(super) const SPEEDS: &str = "speeding";
const CONTACT_DEPTH: &str = "contact_depth";
/// Of pedestrians and cyclists.
pub(super) const NOT_BY_FRONT: &str = "not_by_front";
pub(super) const AT_CORNER: &str = "at_corner";
pub(super) const EGO_STANDS: &str = "ego_stands";
pub(super) const DASH: &str = "dash";
pub(super) const TURNED: &str = "turned_before";
pub(super) const ALONG: &str = "not_across";
pub(super) const UNSEEN: &str = "unseen";

/// Why an attack is not believable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// `contact_depth`, `against_traffic`, `across_lanes`, `turning_circle`, `lateral_acceleration`, `acceleration`, `braking`,
    /// `speeding`, `u_turn`, `wrong_lane`, or the violated rule.
    pub reason: Cow<'static, str>,
    /// The measured value: depth in metres, time against the traffic or across the lanes in seconds, turn in rad/m,
    /// accelerations in m/s², speed relative to the limit of the lane, of people shares of the ego's width, m/s, s and rad, or time
    /// after *now* of the U-turn, the turn from the wrong lane or the first violation in seconds.
    pub value: f64,
    /// The limit that it breaks; `None` for a violated rule.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<f64>,
}

impl Reason {
    pub(super) fn violated(violation: &Violation) -> Self {
        Self { reason: violation.rule.clone(), value: violation.step as f64 * DT, limit: None }
    }

    /// A contact of too small a depth, metres.
    pub fn shallow(depth: f64) -> Self {
        Self { reason: CONTACT_DEPTH.into(), value: depth, limit: Some(MIN_DEPTH) }
    }

    /// The reason as words, for tables and captions.
    pub fn words(&self) -> String {
        let value = self.value;
        match (&*self.reason, self.limit) {
            (CONTACT_DEPTH, _) => format!("contact only {value:.2} m deep"),
            (AGAINST_TRAFFIC, _) => format!("{value:.1} s against the traffic"),
            (ACROSS_LANES, _) => format!("{value:.1} s across the lanes"),
            (TURNING_CIRCLE, _) => format!("turns within {:.1} m", value.recip()),
            (LATERAL_ACCELERATION, Some(_)) => format!("{value:.1} m/s² of lateral acceleration"),
            (HARD_ACCELERATION, _) => format!("accelerates by {value:.1} m/s²"),
            (HARD_BRAKING, _) => format!("brakes by {value:.1} m/s²"),
            (SPEEDS, _) => format!("{value:.1} times the speed limit"),
            (U_TURN, _) => format!("U-turn without a lane after {value:.1} s"),
            (WRONG_LANE, _) => format!("turns from the wrong lane after {value:.1} s"),
            (NOT_BY_FRONT, _) => "not met by the ego's front".to_owned(),
            (AT_CORNER, _) => format!("met {:.0} % of the ego's width beside its middle", 100.0 * value),
            (EGO_STANDS, _) => format!("the ego goes at {value:.1} m/s"),
            (DASH, _) => format!("walks for only {value:.1} s"),
            (TURNED, _) => format!("turns by {:.0}° in the last second", value.to_degrees()),
            (ALONG, _) => format!("{:.0}° off a right angle to the ego", value.to_degrees()),
            (UNSEEN, _) => format!("in sight for only {value:.1} s"),
            (rule, _) => format!("{} after {value:.1} s", rule.replace('_', " ")),
        }
    }
}

/// A verdict as words, with the reasons; `None` without contact.
///
/// ```
/// use sage_core::objective::{Reason, verdict};
///
/// assert_eq!(verdict(Some(true), &[]).as_deref(), Some("believable"));
/// // A contact of 0.2 m is a graze; 0.5 m are asked.
/// let graze = [Reason::shallow(0.2)];
/// assert_eq!(verdict(Some(false), &graze).as_deref(), Some("not believable (contact only 0.20 m deep)"));
/// // Without contact there is nothing to believe.
/// assert_eq!(verdict(None, &[]), None);
/// ```
pub fn verdict(believable: Option<bool>, reasons: &[Reason]) -> Option<String> {
    let words = || reasons.iter().map(Reason::words).collect::<Vec<_>>().join(", ");
    Some(if believable? { "believable".to_owned() } else { format!("not believable ({})", words()) })
}
