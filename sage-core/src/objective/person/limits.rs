//! What people on foot and on bicycles can do.
//!
//! | limit | pedestrian | cyclist |
//! | --- | --- | --- |
//! | top speed | 8 km/h: the running adult of Euro NCAP's tests | 25 km/h: a fast cyclist, and where pedelecs stop to help |
//! | strict speed | 5 km/h: the walking adult of Euro NCAP, UN R152 and UN R157 | 15 km/h: the crossing cyclist of Euro NCAP and UN R152 |
//! | acceleration, braking | 2 m/s² | 2 m/s² |
//! | lateral acceleration | 2 m/s² | 3 m/s² |
//!
//! `docs/people.md` holds the sources and what recorded people do.

use serde::Serialize;

use crate::scene::TrackKind;

/// km/h in m/s.
const KMH: f64 = 1.0 / 3.6;
/// Tolerance of a speed: a step of rounding, m/s.
const ROUNDING: f64 = 0.05;

/// Limits of the motion of people.
///
/// ```
/// use sage_core::{objective::PersonLimits, scene::TrackKind};
///
/// let limits = PersonLimits::of(&TrackKind::Pedestrian).ok_or("a pedestrian is a person")?;
/// // 8 and 5 km/h, with 0.05 m/s of tolerance.
/// assert!(limits.top_speed > 2.2 && limits.strict_speed < 1.45);
/// assert!(PersonLimits::of(&TrackKind::Vehicle).is_none());
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PersonLimits {
    /// Largest speed, m/s.
    pub top_speed: f64,
    /// Largest speed of the clause `strict`, m/s.
    pub strict_speed: f64,
    /// Largest acceleration and braking, m/s².
    pub acceleration: f64,
    /// Largest lateral acceleration, m/s².
    pub lateral: f64,
}

impl PersonLimits {
    const PEDESTRIAN: Self = Self {
        top_speed: 8.0 * KMH + ROUNDING,
        strict_speed: 5.0 * KMH + ROUNDING,
        acceleration: 2.0,
        lateral: 2.0,
    };
    const CYCLIST: Self = Self {
        top_speed: 25.0 * KMH + ROUNDING,
        strict_speed: 15.0 * KMH + ROUNDING,
        acceleration: 2.0,
        lateral: 3.0,
    };

    /// The limits of a kind; `None` if it is no person.
    pub fn of(kind: &TrackKind) -> Option<Self> {
        match kind {
            TrackKind::Pedestrian => Some(Self::PEDESTRIAN),
            TrackKind::Cyclist => Some(Self::CYCLIST),
            TrackKind::Vehicle | TrackKind::Other(_) => None,
        }
    }
}
