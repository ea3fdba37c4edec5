//! Scenes of a list that could not be read or worked on.

use advsage::in_one_line;

use crate::{
    AnyError, Outcome,
    outcome::may_pass,
    progress::{self, count},
};

/// Why a scene could not be read or worked on.
#[derive(Clone, Default)]
pub struct Failed {
    /// Why, in words.
    pub reason: String,
    /// True if another try may succeed.
    pub may_pass: bool,
}

impl Failed {
    pub(super) fn add(&mut self, error: &AnyError) {
        let separator = if self.reason.is_empty() { "" } else { "; " };
        self.reason += &format!("{separator}{}", in_one_line(error));
        self.may_pass |= may_pass(error);
    }
}

/// Outcome of a command in which a number of scenes failed.
pub fn outcome_without(failed: usize) -> Outcome {
    if failed == 0 {
        return Outcome::Done;
    }
    progress::say(&format!("{} failed; the results are of the others", count(failed, "scene")));
    Outcome::BadScenes
}
