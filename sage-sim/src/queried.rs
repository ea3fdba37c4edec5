//! The driver of a test, as a generator may query it: what does it do against a plan?

use sage_core::{
    Error,
    generator::{DrivenEgo, DriverUnderTest},
    motion::{Pose, Trajectory},
};

use crate::{attack_test::AttackTest, episode::Progress, vehicle::Motion};

/// A driver that generators may query. Its drives share their way up to *now*.
pub struct QueriedDriver<'t, 'p> {
    test: &'t AttackTest<'p>,
    /// `None` for a driver that cannot be copied: each of its drives begins at frame 0.
    until_now: Option<Progress>,
}

impl<'t, 'p> QueriedDriver<'t, 'p> {
    /// The driver of a test.
    pub fn new(test: &'t AttackTest<'p>) -> Self {
        Self { test, until_now: test.until_now() }
    }
}

impl DriverUnderTest for QueriedDriver<'_, '_> {
    fn drive(&self, plan: &Trajectory) -> Result<DrivenEgo, Error> {
        let scene = self.test.scene();
        let fail = |error: crate::Error| match error {
            crate::Error::Core(error) => error,
            other => Error::Scene { scene: scene.id.clone(), problem: other.to_string() },
        };
        let adversary = scene.adversary_index()?;
        let episode = self.test.attack_from(self.until_now.as_ref(), plan, true).map_err(fail)?.episode;
        let pose = |motion: &Motion| Some(Pose { position: motion.position, heading: motion.heading });
        let hits_adversary = episode.first_contacts().any(|contact| contact.contact.other.track == adversary);
        Ok(DrivenEgo { poses: episode.drive.motions.iter().map(pose).collect(), hits_adversary })
    }
}
