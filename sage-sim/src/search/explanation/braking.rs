//! Whether braking would have done, and when the driver brakes.

use sage_core::{geometry::distance, motion::DT};
use serde::{Deserialize, Serialize};

use crate::{avoidable::Avoidable, search::AttackedPath};

/// Deceleration from which a driver brakes, m/s².
const BRAKES: f64 = 1.5;
/// Speed below which a car stands, m/s: who brakes to a stop does not release the brake.
const STANDING: f64 = 0.5;
/// Difference of two times that are the same, seconds.
pub(super) const ROUNDING: f64 = 0.05;
/// Steps of a break within one braking, and before the contact: drivers act at 10 Hz.
const BREAK: usize = 3;
const LAST_BREAK: usize = 1;
/// Steps before the contact within which a braking that was released is told.
const RELEASED: usize = 20;

/// Braking against the plan, seconds before the contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Braking {
    /// When the driver begins to brake, by 1.5 m/s² or more, up to the contact; `None` if it does not.
    pub brakes_before_contact: Option<f64>,
    /// When the driver released the brake, if it does not brake up to the contact and did within the last 2 s.
    pub released_before_contact: Option<f64>,
    /// Largest deceleration of that braking, m/s².
    pub own_deceleration: Option<f64>,
    /// How far the adversary is from its recording at the last moment for full braking, metres; `None` if it is not recorded there, or if
    /// braking alone is never enough.
    pub adversary_off: Option<f64>,
    /// Up to when full braking alone prevents the contact; `None` if it never does.
    pub time_to_brake: Option<f64>,
    /// The same of steering alone.
    pub time_to_steer: Option<f64>,
    /// The same of any evasive manoeuvre.
    pub time_to_evade: Option<f64>,
}

/// Distance from its recording from which an adversary can be seen to do something else, metres.
const VISIBLE: f64 = 0.5;

impl Braking {
    /// Whether full braking would have to begin while the adversary still drives as recorded.
    pub(super) fn is_hindsight(&self) -> bool {
        self.adversary_off.is_some_and(|off| off < VISIBLE)
    }

    /// Whether the driver brakes too late, too weakly, not up to the contact or not, or whether braking alone is not enough.
    pub fn class(&self) -> &'static str {
        match (self.time_to_brake, self.brakes_before_contact) {
            (None, _) if self.time_to_steer.is_some() => "only steering helps",
            (None, _) => "braking alone is not enough",
            (Some(_), _) if self.is_hindsight() => "would have to know the plan",
            (Some(_), None) if self.released_before_contact.is_some() => "releases the brake",
            (Some(_), None) => "does not brake",
            (Some(time), Some(own)) if own < time - ROUNDING => "brakes too late",
            (Some(_), Some(_)) => "brakes too weakly",
        }
    }

    /// The braking of an attacked drive with a contact at a step, 1 or later; `off` says how far the adversary
    /// is from its recording at a step.
    pub(super) fn of(
        path: &AttackedPath,
        avoidable: &Avoidable,
        contact: usize,
        off: impl Fn(usize) -> Option<f64>,
    ) -> Self {
        let now = path.history.last().map(|[x, y, _]| [*x, *y]);
        let until = path.positions.iter().take(contact.saturating_sub(1)).copied();
        let points: Vec<_> = now.into_iter().chain(until).collect();
        let speeds: Vec<f64> = points.windows(2).map(|w| distance(w[0], w[1]) / DT).collect();
        let before = |step: usize| ((contact - step) as f64 * DT * 10.0).round() / 10.0;
        let begin = last_braking(&speeds);
        let released = if begin.is_none() { last_release(&speeds) } else { None };
        let hardest = |(first, last): (usize, usize)| {
            let changes = speeds[first - 1..=last].windows(2).map(|w| (w[0] - w[1]) / DT);
            changes.fold(0.0, f64::max)
        };
        Self {
            brakes_before_contact: begin.map(before),
            released_before_contact: released.map(|(_, last)| before(last)),
            own_deceleration: begin.map(|first| (first, speeds.len() - 1)).or(released).map(hardest),
            adversary_off: avoidable
                .latest_brake
                .and_then(|time| off(contact.saturating_sub((time / DT).round() as usize))),
            time_to_brake: avoidable.latest_brake,
            time_to_steer: avoidable.latest_steer,
            time_to_evade: avoidable.latest_start,
        }
    }
}

/// Step at which the braking begins that goes on up to the end; `speeds` are those of the steps from *now* on.
fn last_braking(speeds: &[f64]) -> Option<usize> {
    let brakes = |k: usize| (speeds[k - 1] - speeds[k]) / DT >= BRAKES;
    let is_braking: Vec<bool> =
        (1..speeds.len()).map(|k| brakes(k) || speeds[k - 1].max(speeds[k]) < STANDING).collect();
    let (mut first, mut quiet) = (None, 0);
    for (k, braking) in is_braking.iter().enumerate().rev() {
        if *braking {
            (first, quiet) = (Some(k), 0);
        } else {
            quiet += 1;
            if quiet > if first.is_some() { BREAK } else { LAST_BREAK } {
                break;
            }
        }
    }
    // A car that stood all the time did not brake.
    first.filter(|first| (*first..is_braking.len()).any(|k| brakes(k + 1))).map(|first| first + 1)
}

/// First and last step of a braking that ended within [`RELEASED`] steps before the end.
fn last_release(speeds: &[f64]) -> Option<(usize, usize)> {
    let earliest = speeds.len().saturating_sub(RELEASED).max(1);
    let last = (earliest..speeds.len()).rfind(|k| (speeds[k - 1] - speeds[*k]) / DT >= BRAKES)?;
    last_braking(&speeds[..=last]).map(|first| (first, last))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn braking_is_what_goes_on_up_to_the_contact() {
        let constant = vec![8.0; 20];
        assert_eq!(last_braking(&constant), None);
        let late: Vec<f64> = (0..20).map(|k| 8.0 - 0.3 * (k as f64 - 16.0).max(0.0)).collect();
        assert_eq!(last_braking(&late), Some(17));
        // A braking that ended a second before is another one.
        let early: Vec<f64> = (0..20).map(|k| 8.0 - 0.3 * f64::min(k as f64, 8.0)).collect();
        assert_eq!(last_braking(&early), None);
        assert_eq!(last_release(&early), Some((1, 8)), "and is told as released");
        assert_eq!(last_release(&[early, vec![5.6; 20]].concat()), None, "too long ago");
        assert_eq!(last_release(&constant), None);
        assert_eq!(last_release(&[]), None);
        let stops: Vec<f64> = (0..20).map(|k| (4.0 - 0.4 * k as f64).max(0.0)).collect();
        assert_eq!(last_braking(&stops), Some(1), "it stands because it braked");
        assert_eq!(last_braking(&[0.0; 20]), None, "it stood before");
        assert_eq!(last_braking(&[]), None);
    }
}
