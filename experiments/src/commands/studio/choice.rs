//! What a request chooses: numbers of what was offered, and road users of the scene.

use anyhow::{Result, ensure};
use sage_core::geometry::Point;
use serde::Deserialize;

use super::method::{Dial, STEPS};

/// Most drives side by side.
const MOST_DRIVERS: usize = 2;

/// A choice.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Choice {
    pub(super) scene: usize,
    pub(super) generator: usize,
    pub(super) dial: Dial,
    /// Place of the slider.
    pub(super) step: usize,
    pub(super) drivers: Vec<usize>,
    pub(super) adversary: Option<String>,
    pub(super) without: Vec<String>,
    pub(super) goal: Option<Point>,
    /// A failure that a search of the first driver found: its plan in place of one of the generator.
    #[serde(default)]
    pub(super) found: Option<FoundChoice>,
}

/// A failure by its number, 0 the first, in a search without some road users.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FoundChoice {
    pub(super) number: usize,
    pub(super) without: Vec<String>,
}

impl Choice {
    /// *Errors*: a place that the slider has not; another number of drivers.
    pub(super) fn check(&self) -> Result<()> {
        let count = self.drivers.len();
        ensure!((1..=MOST_DRIVERS).contains(&count), "choose one or two drivers");
        ensure!(self.step < STEPS, "there is no place {} of the slider", self.step);
        Ok(())
    }

    /// Ids of the road users that are taken away, sorted.
    pub(super) fn sorted_without(&self) -> Vec<String> {
        let mut without = self.without.clone();
        without.sort();
        without.dedup();
        without
    }
}
