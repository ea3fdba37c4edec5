//! The time that a policy takes for its steps.

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::{Duration, Instant},
};

use super::{Driver, EgoPolicy, Knowledge, OtherWay, Shown, Start, View};
use crate::{Error, observation::ObservationKind, world::Control};

/// Bins of times in a doubling: each is 4 % wide.
const A_DOUBLING: f64 = 16.0;
/// Number of bins: up to four seconds.
const BINS: usize = 512;

/// Times of steps, counted in bins, so that they take no more memory with more steps. Threads may share them.
pub struct StepTimes {
    nanoseconds: AtomicU64,
    bins: Vec<AtomicU64>,
}

impl Default for StepTimes {
    fn default() -> Self {
        Self { nanoseconds: AtomicU64::new(0), bins: (0..BINS).map(|_| AtomicU64::new(0)).collect() }
    }
}

impl StepTimes {
    /// Adds a step.
    pub fn add(&self, time: Duration) {
        let time = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX).max(1);
        let bin = ((time as f64).log2() * A_DOUBLING) as usize;
        self.nanoseconds.fetch_add(time, Relaxed);
        self.bins[bin.min(BINS - 1)].fetch_add(1, Relaxed);
    }

    /// Adds the steps of another one.
    pub fn add_all(&self, other: &Self) {
        self.nanoseconds.fetch_add(other.nanoseconds.load(Relaxed), Relaxed);
        for (own, other) in self.bins.iter().zip(&other.bins) {
            own.fetch_add(other.load(Relaxed), Relaxed);
        }
    }

    fn count(&self) -> u64 {
        self.bins.iter().map(|bin| bin.load(Relaxed)).sum()
    }

    /// Mean time of a step, milliseconds; `None` without steps.
    pub fn mean(&self) -> Option<f64> {
        let count = self.count();
        (count > 0).then(|| 1e-6 * self.nanoseconds.load(Relaxed) as f64 / count as f64)
    }

    /// The time that a share of the steps do not exceed, milliseconds, to within 4 %; `None` without steps.
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let least = (share * self.count() as f64).ceil() as u64;
        let mut count = 0;
        let bin = self.bins.iter().position(|bin| {
            count += bin.load(Relaxed);
            count > 0 && count >= least
        })?;
        Some(1e-6 * ((bin + 1) as f64 / A_DOUBLING).exp2())
    }
}

/// A policy that drives as another one does. The times of its steps, those of copies of its drivers too, are counted; its
/// starts are not.
pub struct Timed<'p> {
    policy: &'p dyn EgoPolicy,
    times: Arc<StepTimes>,
}

impl<'p> Timed<'p> {
    /// A policy whose times are added to others.
    pub fn new(policy: &'p dyn EgoPolicy, times: Arc<StepTimes>) -> Self {
        Self { policy, times }
    }
}

impl EgoPolicy for Timed<'_> {
    fn knows(&self) -> Knowledge {
        self.policy.knows()
    }

    fn is_recording(&self) -> bool {
        self.policy.is_recording()
    }

    fn observes(&self) -> ObservationKind {
        self.policy.observes()
    }

    fn other_ways(&self) -> Result<Vec<OtherWay>, Error> {
        self.policy.other_ways()
    }

    fn write_logs_to(&self, folder: &Path) {
        self.policy.write_logs_to(folder);
    }

    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(TimedDriver { driver: self.policy.start(start)?, times: self.times.clone() }))
    }
}

struct TimedDriver {
    driver: Box<dyn Driver>,
    times: Arc<StepTimes>,
}

impl Driver for TimedDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let start = Instant::now();
        let control = self.driver.control(view);
        self.times.add(start.elapsed());
        control
    }

    fn shown(&mut self) -> Option<Shown> {
        self.driver.shown()
    }

    fn end(&mut self, view: &View) -> Result<(), Error> {
        self.driver.end(view)
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(Self { driver: self.driver.boxed_clone()?, times: self.times.clone() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_quantile_are_those_of_the_steps() {
        let (times, more) = (StepTimes::default(), StepTimes::default());
        assert_eq!((times.mean(), times.quantile(0.99)), (None, None));
        (0..98).for_each(|_| times.add(Duration::from_millis(1)));
        more.add(Duration::from_millis(3));
        more.add(Duration::from_millis(100));
        times.add_all(&more);
        assert!((times.mean().unwrap() - 2.01).abs() < 1e-9);
        for (share, ms) in [(0.5, 1.0), (0.99, 3.0), (1.0, 100.0)] {
            let found = times.quantile(share).unwrap();
            assert!(found >= ms && found < 1.05 * ms, "{share}: {found} for {ms}");
        }
    }
}
