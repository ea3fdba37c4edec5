//! Encounter of a candidate with the ego: first contact and least distance.
//!
//! The reward is `10 (1 − t / T)` at the first contact, with `t` = 1…T in `paper` (0 at the last step,
//! although it is a contact) and 0…T−1 in `release`. Without contact it is `exp(−0.2 d)` with the least
//! distance `d` of the centres; `release` sets it to 0 beyond 20 m. Source: the paper's reward section and
//! the published code.

use super::{Candidate, Convention, EgoPath};
use crate::{geometry::OrientedBox, motion::HORIZON};

/// Reward of an immediate contact.
const CONTACT: f64 = 10.0;
/// Decay of closeness with distance, 1/m.
const DECAY: f64 = 0.2;
/// Distance of the centres within which two cars can touch, metres: nearer ones on another level are left out.
const NEAR: f64 = 30.0;
/// Distance beyond which the published code's reward is 0, metres.
const RELEASE_REACH: f64 = 20.0;

/// Encounter of two trajectories.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encounter {
    /// First step with contact, from 1.
    pub contact: Option<usize>,
    /// Least distance of the centres up to the contact, metres; infinite if they have no common step.
    pub least_distance: f64,
    /// Number of steps compared.
    pub steps: usize,
}

impl Encounter {
    /// Compares two sequences of boxes step by step, up to the first contact or the end of the shorter one.
    pub fn follow<'b>(
        adversary: &[OrientedBox],
        ego: impl ExactSizeIterator<Item = Option<&'b OrientedBox>>,
    ) -> Self {
        Self::until(OrientedBox::intersects, |_| true, adversary, ego)
    }

    /// As [`Encounter::follow`], up to the first step at which `is_contact` holds; near boxes count only at steps at which
    /// they are on one level.
    fn until<'b>(
        is_contact: impl Fn(&OrientedBox, &OrientedBox) -> bool,
        is_level: impl Fn(usize) -> bool,
        adversary: &[OrientedBox],
        ego: impl ExactSizeIterator<Item = Option<&'b OrientedBox>>,
    ) -> Self {
        let steps = adversary.len().min(ego.len());
        let mut least2 = f64::INFINITY;
        for (step, (a, e)) in adversary.iter().zip(ego).enumerate() {
            let Some(e) = e else { continue };
            let d = [a.center[0] - e.center[0], a.center[1] - e.center[1]];
            let d2 = d[0] * d[0] + d[1] * d[1];
            if d2 < NEAR * NEAR && !is_level(step + 1) {
                continue;
            }
            least2 = least2.min(d2);
            if is_contact(a, e) {
                return Self { contact: Some(step + 1), least_distance: least2.sqrt(), steps };
            }
        }
        Self { contact: None, least_distance: least2.sqrt(), steps }
    }

    /// The encounter of a candidate with an ego path.
    pub fn of(candidate: &Candidate, ego: &EgoPath) -> Self {
        Self::by_level(OrientedBox::intersects, candidate, ego)
    }

    /// The encounter of a candidate with an ego path, with what counts as a contact of boxes on one level.
    fn by_level(
        is_contact: impl Fn(&OrientedBox, &OrientedBox) -> bool,
        candidate: &Candidate,
        ego: &EgoPath,
    ) -> Self {
        Self::until(
            is_contact,
            |step| ego.is_on_level_of(candidate, step),
            candidate.boxes(),
            ego.boxes().iter().map(Option::as_ref),
        )
    }

    /// This encounter with contact counted only from an overlap depth on, metres.
    pub fn from_depth(self, candidate: &Candidate, ego: &EgoPath, min_depth: f64) -> Self {
        // Without any contact there is no deep one either.
        if self.contact.is_none() || min_depth <= 0.0 {
            return self;
        }
        let is_deep = |a: &OrientedBox, e: &OrientedBox| a.overlap_depth(e) >= min_depth;
        Self::by_level(is_deep, candidate, ego)
    }

    /// The adversarial reward of this encounter.
    ///
    /// T is 80 however long the recording is, so a contact at a time is worth the same in every scene.
    pub fn reward(&self, convention: Convention) -> f64 {
        self.reward_within(HORIZON, convention)
    }

    /// The reward with T = `horizon`.
    pub(super) fn reward_within(&self, horizon: usize, convention: Convention) -> f64 {
        let horizon = horizon as f64;
        match (self.contact, convention) {
            (Some(step), Convention::Paper) => CONTACT * (1.0 - step as f64 / horizon),
            (Some(step), Convention::Release) => CONTACT * (1.0 - (step - 1) as f64 / horizon),
            (None, Convention::Release) if self.least_distance > RELEASE_REACH => 0.0,
            (None, _) => (-DECAY * self.least_distance).exp(),
        }
    }
}
