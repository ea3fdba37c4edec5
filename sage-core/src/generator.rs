//! Interface of all generators of adversarial scenes.
//!
//! Most generators are a [`Proposer`], whose input is an [`Observation`] that ends *now*, and a selector
//! among its proposals that may use the ego's path. Optimisers and rules implement [`Generator`] directly.

mod apart_now;
mod attack;
mod driver_under_test;
mod observation;
mod operating_point;
mod reaction;

use std::fmt;

use crate::{Error, objective::Context};

pub use apart_now::ApartNow;
pub use attack::{Attack, Extension, Note, Proposal};
pub use driver_under_test::{DrivenEgo, DriverUnderTest};
pub use observation::Observation;
pub use operating_point::{Mixture, OperatingPoint, corner};
pub use reaction::{Reaction, ReactiveDriver, ReactivePolicy};

/// Information that a generator uses beyond the observation up to *now*.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Knowledge {
    /// The ego's future path.
    pub ego_future: bool,
    /// The logged future of the other agents.
    pub others_future: bool,
    /// The logged future of the adversary.
    pub own_future: bool,
    /// What the driver under test does against its plans: it queries the driver.
    pub driver: bool,
}

impl Knowledge {
    /// Only the observation up to *now*.
    pub const NOW: Self = Self { ego_future: false, others_future: false, own_future: false, driver: false };

    /// Union of the two.
    pub fn and(self, other: Self) -> Self {
        Self {
            ego_future: self.ego_future || other.ego_future,
            others_future: self.others_future || other.others_future,
            own_future: self.own_future || other.own_future,
            driver: self.driver || other.driver,
        }
    }
}

impl Knowledge {
    /// What is known beyond *now*; empty for nothing.
    pub fn beyond_now(self) -> String {
        if self == Self::NOW { String::new() } else { self.to_string() }
    }
}

impl fmt::Display for Knowledge {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let known = [
            (self.ego_future, "ego's path"),
            (self.others_future, "others' log"),
            (self.own_future, "adversary's log"),
            (self.driver, "queries the driver"),
        ];
        let known: Vec<&str> = known.into_iter().filter(|(known, _)| *known).map(|(_, what)| what).collect();
        f.write_str(if known.is_empty() { "history only" } else { "" })?;
        f.write_str(&known.join(", "))
    }
}

/// Proposes trajectories for the adversary from the observation up to *now*.
///
/// Implementations are pure: the same observation, mixture and seed give the same bits on any thread.
pub trait Proposer: Send + Sync {
    /// Computes, once per scene, everything that does not depend on the mixture.
    ///
    /// *Errors*: [`Error::Scene`] for a scene that it cannot handle.
    fn prepare(&self, now: &Observation) -> Result<Box<dyn PreparedProposer>, Error>;
}

/// A proposer that is prepared for one scene.
pub trait PreparedProposer: Send + Sync {
    /// Proposals at a mixture of experts: at least one, sorted by descending probability if they have
    /// probabilities.
    ///
    /// *Errors*: [`Error::Scene`] if the network's output is not finite.
    fn propose(&self, at: &Mixture, seed: u64) -> Result<Vec<Proposal>, Error>;
}

/// Generates attacks: new futures of the adversary in a scene.
///
/// Implementations are pure: the same context, operating points and seed give the same bits on any thread. A generator gets all
/// operating points at once, so a sweep prepares a scene once. The attack at one point does not depend on the other points
/// (tested).
pub trait Generator: Send + Sync {
    /// An attack for each operating point, in their order.
    ///
    /// *Errors*: [`Error::Scene`] for a scene that it cannot handle.
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, Error>;

    /// The same against a driver that can be asked what it does. `ctx` holds its drive without an attack as the ego's path.
    ///
    /// A generator that queries the driver implements it; [`Generator::attacks`] then takes the ego's path as what the driver
    /// does against every plan.
    ///
    /// *Errors*: as [`Generator::attacks`], and those of the driver.
    fn attacks_on(
        &self,
        ctx: &Context,
        driver: &dyn DriverUnderTest,
        at: &[OperatingPoint],
        seed: u64,
    ) -> Result<Vec<Attack>, Error> {
        let _ = driver;
        self.attacks(ctx, at, seed)
    }

    /// What its attacks in a scene share, for callers that ask for one after the other; `None` if there is nothing to keep.
    ///
    /// *Errors*: as [`Generator::attacks`].
    fn prepare(&self, ctx: &Context) -> Result<Option<Box<dyn PreparedProposer>>, Error> {
        let _ = ctx;
        Ok(None)
    }

    /// [`Generator::attacks`] with what [`Generator::prepare`] gave for the same observation.
    ///
    /// *Errors*: as [`Generator::attacks`].
    fn attacks_prepared(
        &self,
        prepared: &dyn PreparedProposer,
        ctx: &Context,
        at: &[OperatingPoint],
        seed: u64,
    ) -> Result<Vec<Attack>, Error> {
        let _ = prepared;
        self.attacks(ctx, at, seed)
    }
}
