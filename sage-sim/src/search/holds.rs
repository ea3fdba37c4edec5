//! Whether a failure holds: whether it is one in every variant of the drive.
//!
//! A plan of the ego can be followed in more than one way, and no start is known to the centimetre. A failure that a little of either
//! ends says something of the simulation, not of the driver. Variants are the other ways of following that a driver offers, and three
//! small changes of the start: 0.1 m ahead, 0.1 m/s faster, and another seed.

use std::sync::Arc;

use sage_core::objective::Context;
use serde::{Deserialize, Serialize};

use super::Reason;
use crate::{
    Error,
    attack_test::AttackTest,
    drive::Drive,
    policy::{EgoPolicy, OtherWay},
    scene::SimScene,
};

/// Change of the place at the start, metres, and of the speed, m/s.
const AHEAD: f64 = 0.1;
const FASTER: f64 = 0.1;

/// A variant of a drive, and what becomes of a failure in it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Variation {
    /// What differs: a way of following, or a change of the start.
    pub variant: String,
    /// Why it is no failure; `None` if it is one.
    pub missing: Option<Reason>,
}

/// A variant with its drive without the attack.
struct Variant {
    name: String,
    /// The policy, if it is not that of the test.
    policy: Option<Box<dyn EgoPolicy>>,
    scene: Arc<SimScene>,
    seed: u64,
    /// The drive without the attack; the reason if there is none, which is the same for all plans.
    unattacked: Result<(Drive, Context), Error>,
}

/// The variants of a test.
pub(super) struct Variants(Vec<Variant>);

impl Variants {
    /// Drives all variants without the attack.
    ///
    /// *Errors*: a program that does not start, or a scene that cannot be simulated.
    pub(super) fn new(test: &AttackTest) -> Result<Self, Error> {
        let (scene, seed) = (test.simulated(), test.seed());
        let mut all = Vec::new();
        for OtherWay { name, policy } in test.policy().other_ways()? {
            all.push(Variant::new(test, format!("followed by `{name}`"), Some(policy), scene.clone(), seed));
        }
        for (name, [ahead, faster]) in [("0.1 m ahead", [AHEAD, 0.0]), ("0.1 m/s faster", [0.0, FASTER])] {
            let scene = started_at(scene, ahead, faster)?;
            all.push(Variant::new(test, name.to_owned(), None, scene, seed));
        }
        all.push(Variant::new(test, "another seed".to_owned(), None, scene.clone(), seed.wrapping_add(1)));
        Ok(Self(all))
    }

    /// Each variant with its name, its test and the context of its drive without the attack; `None` if there is no such drive, which
    /// is the same for all plans.
    pub(super) fn tests<'v>(
        &'v self,
        test: &'v AttackTest,
    ) -> impl Iterator<Item = (&'v str, Option<(AttackTest<'v>, &'v Context)>)> {
        self.0.iter().map(move |variant| {
            let policy = variant.policy.as_deref().unwrap_or(test.policy());
            let known = variant.unattacked.as_ref().ok();
            let varied = known.map(|(unattacked, ctx)| {
                (test.varied(policy, &variant.scene, variant.seed, unattacked.clone()), ctx)
            });
            (&*variant.name, varied)
        })
    }
}

impl Variant {
    fn new(
        test: &AttackTest,
        name: String,
        policy: Option<Box<dyn EgoPolicy>>,
        scene: Arc<SimScene>,
        seed: u64,
    ) -> Self {
        let driver = policy.as_deref().unwrap_or(test.policy());
        let unattacked = AttackTest::new(driver, &scene, seed);
        let unattacked = unattacked.and_then(|test| Ok((test.unattacked().clone(), test.context()?)));
        Self { name, policy, scene, seed, unattacked }
    }
}

/// The scene with another start of the ego.
fn started_at(scene: &SimScene, ahead: f64, faster: f64) -> Result<Arc<SimScene>, Error> {
    let mut moved = sage_core::scene::Scene::clone(scene.scene());
    let ego = moved.ego;
    let track = &mut moved.tracks[ego];
    let (sin, cos) = track.heading[0].sin_cos();
    for (axis, part) in [cos, sin].into_iter().enumerate() {
        track.position[0][axis] += ahead * part;
        track.velocity[0][axis] += faster * part;
    }
    scene.on_same_map(Arc::new(moved))
}
