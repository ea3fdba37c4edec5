//! A generator with all that it needs, and attacks without Python.

use std::sync::Arc;

use advsage::{
    Error,
    generators::Against,
    named_generator::{GeneratorSpec, NamedGenerator},
    prepared::Prepared,
};
use sage_core::{generator::Attack, objective::Context, scene::SceneData};
use sage_run::Result;
use sage_sim::attack_test::AttackTest;

use crate::parts::{Driver, registries};

/// A generator with all that it needs, at one operating point.
pub(crate) struct Built {
    pub(crate) named: NamedGenerator,
}

impl Built {
    /// Builds a generator.
    ///
    /// *Errors*: an option is out of range or names an unknown part; weights cannot be used.
    pub(crate) fn new(spec: GeneratorSpec) -> Result<Self> {
        Ok(Self { named: spec.build(registries()?)? })
    }

    /// Attacks a scene. Returns the scene as the generator saw it, with the driver's unattacked drive in place of the ego's
    /// recording, and the attack.
    ///
    /// *Errors*: a scene that cannot be attacked or driven; those of the generator.
    pub(crate) fn attack(
        &self,
        scene: &SceneData,
        driver: &Driver,
        seed: u64,
    ) -> Result<(Arc<SceneData>, Attack)> {
        let index = scene.index.clone();
        index.build_all();
        let drives = |scene: &_| AttackTest::new(&*driver.policy, scene, seed);
        let prepared = Prepared::new(scene.scene.clone(), &index, &*driver.policy, drives)?;
        let ctx = &prepared.ctx;
        let attack = first(self.named.built.attacks(ctx, prepared.against(), seed)?)?;
        attack.check(ctx.scene())?;
        Ok((Arc::new(SceneData { name: scene.name.clone(), scene: ctx.scene().clone(), index }), attack))
    }

    /// An attack on a driver; an adversary that reacts does so when it is driven.
    ///
    /// *Errors*: those of the generator.
    pub(crate) fn attack_on_driver(&self, ctx: &Context, test: &AttackTest, seed: u64) -> Result<Attack> {
        let attack = first(self.named.built.planned(ctx, Against::Driver(test), seed)?)?;
        attack.check(ctx.scene())?;
        Ok(attack)
    }
}

/// The attack at the only operating point.
fn first(attacks: Vec<Attack>) -> Result<Attack> {
    let attack = attacks.into_iter().next();
    Ok(attack.ok_or_else(|| Error::Value("the generator gave no attack".to_owned()))?)
}
