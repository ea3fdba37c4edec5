//! A generator with all that it needs, and attacks without Python.

use std::sync::Arc;

use advsage::{
    Error,
    generators::Against,
    named_generator::{GeneratorSpec, NamedGenerator},
    prepared::{self, DriverInScene},
};
use anyhow::Result;
use sage_core::{
    generator::Attack,
    objective::{Context, FurtherMeasures},
    scene::SceneData,
};
use sage_sim::{SimScene, attack_test::AttackTest};

use crate::parts::{Driver, registries};

/// A generator with all that it needs, at one operating point.
pub(crate) struct Built {
    pub(crate) spec: GeneratorSpec,
    pub(crate) named: NamedGenerator,
    /// What scores measure besides their own fields.
    pub(crate) further: FurtherMeasures,
}

impl Built {
    /// Builds a generator.
    ///
    /// *Errors*: an option is out of range or names an unknown part; weights cannot be used.
    pub(crate) fn new(spec: GeneratorSpec) -> Result<Self> {
        let registries = registries()?;
        let named = spec.clone().checked(registries)?.build(|_| {})?;
        let objective = Some(named.selection.objective.spec());
        let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, objective)?;
        Ok(Self { spec, named, further })
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
        let (attack, ctx) = if driver.policy.is_recording() {
            let ctx = prepared::recording(&scene.scene, &index)?;
            (self.named.built.attacks(&ctx, Against::Recording, seed)?, ctx)
        } else {
            let simulated = SimScene::new(scene.scene.clone(), index.clone())?;
            let drives = |scene: &_| Ok(AttackTest::new(&*driver.policy, scene, seed)?);
            let DriverInScene { test, ctx } = DriverInScene::new(&simulated, drives)?;
            (self.named.built.attacks(&ctx, Against::Driver(&test), seed)?, ctx)
        };
        let attack = first(attack)?;
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
