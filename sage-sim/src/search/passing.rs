//! When a driver passes a test. That is not the negation of finding a failure: a driver that stands meets no attack, and a
//! graze that no person would call an attack is a contact.
//!
//! A driver passes if it is at fault in no contact with anybody, stays on the road, and makes *progress*: along its route
//! from *now* on, at least half of what the reference driver does that prevents the contact, or, where none prevents it, of
//! its own unattacked drive up to where the plan would meet it, or of the recording if it does less than half
//! of that; all up to the contact of the driver under test. Where that is less than 5 m, progress is not asked, but of a driver that is less than half as fast *now* as the recording:
//! the reference driver starts from its state, so it is compared with the recording. A contact that is not its fault, or whose fault is unknown,
//! passes with a mark.

use sage_core::{
    geometry::norm,
    motion::{NOW, Trajectory},
    objective::Encounter,
};
use serde::{Deserialize, Serialize};

use super::Met;
use crate::{
    Error,
    attack_test::{AttackOutcome, AttackTest},
    reference::Watching,
    route::Localization,
    unattacked::{UnattackedDrive, until_contact},
    vehicle::Motion,
};

/// Least share of the expected progress.
const SHARE: f64 = 0.5;
/// Progress below which none is asked, metres.
const SHORTEST: f64 = 5.0;
/// Where progress is compared with the driver's own drive without the attack.
pub const UNATTACKED: &str = "unattacked drive";
/// Where it is compared with the recording: a driver that stands without an attack is no measure of itself.
pub const RECORDING: &str = "recording";

/// What is asked of a driver beyond passing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Asked {
    /// No contact at all, whosever fault.
    pub no_contact: bool,
    /// nuPlan's bounds of comfort, up to the first contact.
    pub comfort: bool,
}

/// Why a driver fails a test.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shortfall {
    /// A contact, and it is at fault.
    AtFault,
    /// It left the road.
    OffRoad,
    /// Too little progress.
    NoProgress,
    /// A contact that is not its fault, or whose fault is unknown, where none is allowed.
    Contact,
    /// Beyond the bounds of comfort, where they are asked.
    Discomfort,
}

/// Progress along the route from *now* on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MadeProgress {
    /// Of the driver under test, metres.
    pub made: f64,
    /// Of the drive that it is compared with, metres.
    pub compared: f64,
    /// That drive: a reference driver, [`UNATTACKED`] or [`RECORDING`].
    pub with: String,
}

impl MadeProgress {
    /// Whether the comparison is long enough to ask.
    pub fn is_asked(&self) -> bool {
        self.compared >= SHORTEST
    }

    /// Least progress that passes, metres.
    pub fn least(&self) -> f64 {
        SHARE * self.compared
    }

    /// Whether it is enough, or not asked.
    pub fn is_enough(&self) -> bool {
        !self.is_asked() || self.made >= self.least()
    }
}

/// What a driver does in a test.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TestDrive {
    /// First contact.
    pub contact: Option<Met>,
    /// Whether it is at fault in a contact; `None` if it has none, or if the fault is unknown.
    pub at_fault: Option<bool>,
    /// Frame at which it leaves the road, and the recording does not.
    pub off_road: Option<usize>,
    /// Progress from *now* on.
    pub progress: MadeProgress,
    /// Whether it keeps the bounds of comfort; `None` if that cannot be measured.
    pub comfortable: Option<bool>,
}

impl TestDrive {
    /// Drives a driver against the plan of a test; also gives the drive.
    ///
    /// *Errors*: those of the driver.
    pub fn new(
        test: &AttackTest,
        watching: &Watching,
        plan: &Trajectory,
    ) -> Result<(Self, AttackOutcome), Error> {
        let outcome = test.attack(plan, true)?;
        let prevention = watching.prevention(plan)?;
        let drive = &outcome.episode.drive;
        let facts = UnattackedDrive::of(drive, test.simulated(), test.car());
        let faults = || outcome.episode.contacts.iter().map(|contact| contact.class.is_at_fault());
        let at_fault = if faults().any(|fault| fault == Some(true)) {
            Some(true)
        } else if outcome.episode.contacts.is_empty() || faults().any(|fault| fault.is_none()) {
            None
        } else {
            Some(false)
        };
        let route = test.simulated().route();
        let along = |motion: &Motion| route.locate(motion.position, Localization::Nearest).along;
        let until = until_contact(drive);
        let steps = until.len().saturating_sub(NOW + 1);
        let furthest = |places: Vec<f64>| {
            let first = places.first().copied().unwrap_or_default();
            places.into_iter().take(steps + 1).fold(first, f64::max) - first
        };
        let progress = |motions: &[Motion]| furthest(motions.iter().map(along).collect());
        let from_now = |motions: &[Motion]| motions.get(NOW..).map(progress).unwrap_or_default();
        let recorded = || {
            let ego = test.simulated().scene().ego();
            let frames = (NOW..ego.valid.len()).filter(|frame| ego.valid[*frame]);
            furthest(
                frames.map(|frame| route.locate(ego.point(frame), Localization::Nearest).along).collect(),
            )
        };
        let slowed_before = || {
            let ego = test.simulated().scene().ego();
            let now = drive.motions.get(NOW).map_or(0.0, Motion::speed);
            ego.valid[NOW] && now < SHARE * norm(ego.velocity[NOW])
        };
        let (compared, with) = match prevention.by() {
            Some(reference) => match progress(&prevention.motions) {
                short if short < SHORTEST && slowed_before() => (recorded(), RECORDING),
                other => (other, reference),
            },
            None => {
                let (own, recorded) = (until_contact(test.unattacked()), recorded());
                if from_now(own) < SHARE * recorded {
                    (recorded, RECORDING)
                } else {
                    // Who waits where the plan passes drives well.
                    let meeting = meeting(test, plan)?.unwrap_or(own.len());
                    (from_now(&own[..own.len().min(meeting)]), UNATTACKED)
                }
            }
        };
        let measured = Self {
            contact: Met::first(&outcome, test),
            at_fault,
            off_road: drive.off_road.step().filter(|_| !facts.recording_leaves_road),
            progress: MadeProgress { made: from_now(until), compared, with: with.to_owned() },
            comfortable: facts.is_comfortable,
        };
        Ok((measured, outcome))
    }

    /// The first thing that the driver fails at; `None` if it passes.
    pub fn shortfall(&self, asked: Asked) -> Option<Shortfall> {
        let found = [
            (self.at_fault == Some(true), Shortfall::AtFault),
            (self.off_road.is_some(), Shortfall::OffRoad),
            (!self.progress.is_enough(), Shortfall::NoProgress),
            (asked.no_contact && self.contact.is_some(), Shortfall::Contact),
            (asked.comfort && self.comfortable == Some(false), Shortfall::Discomfort),
        ];
        found.into_iter().find_map(|(fails, shortfall)| fails.then_some(shortfall))
    }
}

/// Frame at which the unattacked drive would meet a plan.
fn meeting(test: &AttackTest, plan: &Trajectory) -> Result<Option<usize>, Error> {
    let ctx = test.context()?;
    let encounter = Encounter::of(&ctx.candidate(plan.clone()), ctx.ego());
    Ok(encounter.contact.map(|step| NOW + step))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passing_asks_fault_the_road_and_progress_in_this_order() {
        let met = Met {
            step: 10,
            track: "a".to_owned(),
            is_adversary: true,
            // A graze counts as any other contact.
            overlap: 0.03,
            impact_speed: 14.3,
            class: crate::fault::FaultClass::ActiveFront,
        };
        let progress = |made, compared| MadeProgress { made, compared, with: "pdm".to_owned() };
        let drive = |at_fault, off_road, progress| TestDrive {
            contact: Some(met.clone()),
            at_fault,
            off_road,
            progress,
            comfortable: Some(false),
        };
        let plain = Asked::default();
        let fault = |at_fault, off_road, made: f64, compared: f64| {
            drive(at_fault, off_road, progress(made, compared)).shortfall(plain)
        };
        assert_eq!(fault(Some(true), Some(20), 0.0, 40.0), Some(Shortfall::AtFault));
        assert_eq!(fault(Some(false), Some(20), 0.0, 40.0), Some(Shortfall::OffRoad));
        assert_eq!(fault(None, None, 19.9, 40.0), Some(Shortfall::NoProgress));
        assert_eq!(fault(None, None, 20.0, 40.0), None, "half of it is enough");
        assert_eq!(fault(Some(false), None, 0.0, 4.9), None, "not asked of less than 5 m");
        let passed = drive(None, None, progress(40.0, 40.0));
        assert_eq!(passed.shortfall(Asked { no_contact: true, comfort: true }), Some(Shortfall::Contact));
        assert_eq!(passed.shortfall(Asked { no_contact: false, comfort: true }), Some(Shortfall::Discomfort));
        let free = TestDrive { contact: None, comfortable: None, ..passed };
        assert_eq!(free.shortfall(Asked { no_contact: true, comfort: true }), None);
    }
}
