//! What attacks the learner: a plan of the adversary for one scene, against a driven path of the ego.

use std::sync::Arc;

use sage_core::{
    generator::{Generator, OperatingPoint},
    motion::Trajectory,
    objective::{Context, ContextOptions},
};

use crate::{
    Error, attack_test::scene_as_driven, drive::Drive, policy::EgoPolicy, scene::SimScene, traffic::Plan,
};

/// Plans attacks in training and evaluation.
pub trait Attacker: Send + Sync {
    /// The adversary's plan at an operating point between the realistic and the adversarial expert, against a drive of the
    /// ego; without a drive against its recording.
    ///
    /// *Errors*: the scene cannot be attacked.
    fn plan(
        &self,
        scene: &SimScene,
        drive: Option<&Drive>,
        at: &OperatingPoint,
        seed: u64,
    ) -> Result<Arc<Plan>, Error>;

    /// Whether it has several plans for the same scene, drive and point, of which the seed draws one.
    fn draws(&self) -> bool {
        false
    }

    /// The plan that it finds by driving the policy against several plans; `None` for an attacker that looks at a drive alone.
    ///
    /// *Errors*: the scene cannot be attacked or driven.
    fn searched(
        &self,
        policy: &dyn EgoPolicy,
        scene: &Arc<SimScene>,
        at: &OperatingPoint,
        seed: u64,
    ) -> Option<Result<Trajectory, Error>> {
        let _ = (policy, scene, at, seed);
        None
    }
}

/// The plan of a generator at an operating point. The generator sees the scene in which the ego's recording is the drive,
/// history included.
///
/// *Errors*: as [`Attacker::plan`].
pub fn plan_of_generator(
    generator: &dyn Generator,
    point: &OperatingPoint,
    scene: &SimScene,
    drive: Option<&Drive>,
    seed: u64,
) -> Result<Arc<Plan>, Error> {
    let recorded = scene_as_driven(scene, drive);
    let ctx = Context::new(&recorded, scene.index(), &ContextOptions::default())?;
    let attacks = generator.attacks(&ctx, std::slice::from_ref(point), seed)?;
    let attack = attacks.first().ok_or_else(|| Error::Plan {
        scene: recorded.id.clone(),
        problem: "the generator gave no attack".to_owned(),
    })?;
    attack.check(&recorded)?;
    Ok(Arc::new(Plan::of_attack(scene.scene(), attack)?))
}
