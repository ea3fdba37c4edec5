//! What attacks the learner: a plan of the adversary for one scene, against a driven path of the ego.

use std::sync::Arc;

use sage_core::{
    Error,
    generator::{Generator, OperatingPoint},
    objective::{Context, ContextOptions},
};

use crate::{drive::Drive, scene::SimScene, traffic::Plan};

/// Plans attacks in training and evaluation.
pub trait Attacker: Sync {
    /// The adversary's plan at intensity λ against a drive of the ego; without a drive against its recording.
    ///
    /// *Errors*: the scene cannot be attacked.
    fn plan(
        &self,
        scene: &SimScene,
        drive: Option<&Drive>,
        lambda: f64,
        seed: u64,
    ) -> Result<Arc<Plan>, Error>;
}

/// A generator as attacker. It sees the scene in which the ego's recording is the drive, history included.
pub struct GeneratorAttacker<'a> {
    /// The generator.
    pub generator: &'a dyn Generator,
    /// The operating point at an intensity λ.
    pub point: &'a (dyn Fn(f64) -> Result<OperatingPoint, Error> + Sync),
}

impl Attacker for GeneratorAttacker<'_> {
    fn plan(
        &self,
        scene: &SimScene,
        drive: Option<&Drive>,
        lambda: f64,
        seed: u64,
    ) -> Result<Arc<Plan>, Error> {
        let recorded = match drive {
            None => scene.scene().clone(),
            Some(drive) => Arc::new(drive.recorded(scene.scene())),
        };
        let ctx = Context::new(&recorded, scene.index(), &ContextOptions::default())?;
        let attacks = self.generator.attacks(&ctx, &[(self.point)(lambda)?], seed)?;
        let attack = attacks.first().ok_or_else(|| scene.error("the generator gave no attack".to_owned()))?;
        attack.check(&recorded)?;
        Ok(Arc::new(Plan::of_adversary(scene.scene(), attack.trajectory())?))
    }
}
