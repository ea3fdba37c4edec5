//! The driver of a test, as a generator may query it: what does it do against a plan?

use sage_core::{
    Error,
    generator::{DrivenEgo, DriverUnderTest},
    motion::{NOW, Pose, Trajectory},
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
        let adversary = scene.adversary_index()?;
        let outcome = self.test.attack_from(self.until_now.as_ref(), plan, true);
        let episode = outcome.map_err(|error| error.in_scene(scene))?.episode;
        let pose = |motion: &Motion| Some(Pose { position: motion.position, heading: motion.heading });
        // Until now all plans are the recording: a contact there is none of a plan.
        let hits_adversary = episode
            .first_contacts()
            .any(|contact| contact.contact.step > NOW && contact.contact.other.track == adversary);
        Ok(DrivenEgo { poses: episode.drive.motions.iter().map(pose).collect(), hits_adversary })
    }
}
