//! Distance of a candidate's motion from the adversary's logged future: 1-D Wasserstein distances of
//! speeds, accelerations and yaw rates.
//!
//! In `paper` the profiles are the backward differences of [`paper::profile`] over pairs of valid neighbouring frames. Each run
//! of valid frames is separate; at its first step acceleration and yaw rate are 0. In `release` the valid frames are
//! concatenated, and accelerations are norms of vectors. [`LoggedProfile::published`] is what the published evaluation compares
//! with by mistake.

use serde::{Deserialize, Serialize};

use super::{Candidate, Context, Convention};
use crate::{
    geometry::Point,
    motion::{
        HORIZON, NOW, Pose,
        kinematics::{paper, release},
    },
    scene::Track,
    statistics::wasserstein,
};

/// Speeds, accelerations and yaw rates of a logged future.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoggedProfile {
    /// Speeds, m/s.
    pub speed: Vec<f64>,
    /// Accelerations, m/s².
    pub acceleration: Vec<f64>,
    /// Signed yaw rates, rad/s.
    pub yaw_rate: Vec<f64>,
}

/// Distances of a candidate from the log; `None` if the log has no value to compare with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DistributionDistances {
    /// Of speeds, m/s.
    pub wd_speed: Option<f64>,
    /// Of accelerations, m/s².
    pub wd_acceleration: Option<f64>,
    /// Of signed yaw rates, rad/s.
    pub wd_yaw_rate: Option<f64>,
}

impl LoggedProfile {
    /// Profile of the adversary's logged future at its valid frames.
    pub fn of(ctx: &Context) -> Self {
        match ctx.convention() {
            Convention::Paper => Self::paper(ctx.adversary()),
            Convention::Release => Self::release(ctx.adversary()),
        }
    }

    fn paper(track: &Track) -> Self {
        let mut out = Self::default();
        let mut frame = NOW;
        while frame <= NOW + HORIZON {
            let run: Vec<Point> =
                (frame..=NOW + HORIZON).take_while(|&f| track.is_valid(f)).map(|f| track.point(f)).collect();
            if let [first, rest @ ..] = &run[..] {
                let start = Pose { position: *first, heading: track.heading[frame] };
                let profile = paper::profile(rest, &start);
                out.speed.extend(profile.speed);
                out.acceleration.extend(profile.acceleration);
                out.yaw_rate.extend(profile.yaw_rate);
            }
            frame += run.len().max(1);
        }
        out
    }

    fn release(track: &Track) -> Self {
        let valid = (NOW + 1..=NOW + HORIZON).filter(|&f| track.is_valid(f));
        let profile = release::profile(&valid.map(|f| track.point(f)).collect::<Vec<_>>());
        Self { speed: profile.speed, acceleration: profile.acceleration_norm, yaw_rate: profile.yaw_rate }
    }

    /// What the published evaluation compares with: flags of validity are used as row numbers, so that each of the 80
    /// points is the second logged one (valid frames) or the first (others). Where the adversary is valid throughout,
    /// this is a standing car, and the distances are means of absolute values.
    pub fn published(track: &Track) -> Self {
        let point = |frame: usize| if track.is_valid(frame) { track.point(frame) } else { [0.0; 2] };
        let [first, second] = [NOW + 1, NOW + 2].map(point);
        let rows = (NOW + 1..=NOW + HORIZON).map(|f| if track.is_valid(f) { second } else { first });
        let profile = release::profile(&rows.collect::<Vec<_>>());
        Self { speed: profile.speed, acceleration: profile.acceleration_norm, yaw_rate: profile.yaw_rate }
    }

    /// Distances of a candidate of the same context.
    pub fn distances(&self, candidate: &Candidate, convention: Convention) -> DistributionDistances {
        let profile = candidate.profile();
        let acceleration = match convention {
            Convention::Paper => &profile.acceleration,
            Convention::Release => &profile.acceleration_norm,
        };
        // In the published code the distance to an empty sample is 0.
        let measured = |mine: &[f64], log: &[f64]| {
            (convention == Convention::Release || !log.is_empty()).then(|| wasserstein(mine, log))
        };
        DistributionDistances {
            wd_speed: measured(&profile.speed, &self.speed),
            wd_acceleration: measured(acceleration, &self.acceleration),
            wd_yaw_rate: measured(&profile.yaw_rate, &self.yaw_rate),
        }
    }
}
