//! What every planner of somebody else is told and may answer, whether it is a program ([`super::Process`]) or an object of the
//! process that hosts this library. `docs/testing-a-driver.md` describes all fields.
//!
//! One struct is the message of the protocol and the fields in process, so the same planner drives the same bits.

mod answer;
mod follow;
mod told_map;
mod told_scene;
mod told_step;

pub use answer::{Answer, PlannedPose};
pub(super) use answer::{EXPECTED, error_of, shortened};
pub use follow::Follower;
pub use told_scene::{Asks, ToldLight, ToldScene, ToldVehicle};
pub use told_step::{StepBefore, ToldAgent, ToldStep};

/// Distance from the route within which the map is told by default, metres.
pub const RADIUS: f64 = 50.0;
/// Road users that are told by default at most: the nearest ones.
pub const AGENTS: usize = 64;

/// Numbers are rounded to a billionth: a planner that is the same as one of ours then drives the same to a micrometre.
const DIGITS: f64 = 1e9;

fn rounded(number: f64) -> f64 {
    (number * DIGITS).round() / DIGITS
}

fn all_rounded<const N: usize>(numbers: [f64; N]) -> [f64; N] {
    numbers.map(rounded)
}
