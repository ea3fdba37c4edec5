//! An attacker without a network.

use std::sync::Arc;

use sage_core::{generator::OperatingPoint, motion::Trajectory};
use sage_sim::{
    Error, SimScene, attack_test::AttackTest, attacker::Attacker, drive::Drive, policy::EgoPolicy,
    traffic::Plan,
};

/// Drives the adversary towards where the ego was: depends on drive and intensity as a generator does.
pub(crate) struct Chase {
    pub(crate) is_broken: bool,
    /// Whether it drives the policy of the moment, and chases where that ends.
    pub(crate) searches: bool,
}

impl Chase {
    fn towards(
        &self,
        scene: &SimScene,
        drive: Option<&Drive>,
        at: &OperatingPoint,
    ) -> Result<Trajectory, Error> {
        let track = &scene.scene().tracks[scene.scene().adversary_index()?];
        let from = track.point(10);
        let last = drive
            .and_then(|drive| drive.motions.last())
            .map_or_else(|| scene.scene().ego().point(90), |m| m.position);
        let to = if self.is_broken { [f64::NAN, 0.0] } else { last };
        let point = |k: usize| {
            let share = at.mu * k as f64 / 80.0;
            [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]))
        };
        Ok(Trajectory::new("chase", (1..=80).map(point).collect())?)
    }
}

impl Attacker for Chase {
    fn plan(
        &self,
        scene: &SimScene,
        drive: Option<&Drive>,
        at: &OperatingPoint,
        _: u64,
    ) -> Result<Arc<Plan>, Error> {
        let trajectory = self.towards(scene, drive, at)?;
        Ok(Arc::new(Plan::of_adversary(scene.scene(), &trajectory)?))
    }

    fn searched(
        &self,
        policy: &dyn EgoPolicy,
        scene: &Arc<SimScene>,
        at: &OperatingPoint,
        seed: u64,
    ) -> Option<Result<Trajectory, Error>> {
        let towards_its_end = || {
            let test = AttackTest::new(policy, scene, seed)?;
            self.towards(scene, Some(test.unattacked()), at)
        };
        self.searches.then(towards_its_end)
    }
}
