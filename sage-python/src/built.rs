//! A generator with all that it needs, and attacks without Python.

use std::sync::Arc;

use anyhow::Result;
use sage_bench::{
    Error,
    named_generator::{GeneratorSpec, NamedGenerator},
};
use sage_core::{
    generator::Attack,
    objective::{Context, ContextOptions, FurtherMeasures},
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
        let (index, mut seen) = (scene.index.clone(), scene.scene.clone());
        seen.check_apart_now()?;
        if !driver.policy.is_recording() {
            let simulated = SimScene::new(seen, index.clone())?;
            seen = AttackTest::new(&*driver.policy, &simulated, seed)?.recorded();
        }
        index.build_all();
        let ctx = Context::new(&seen, &index, &ContextOptions::default())?;
        let attack = self.attack_in(&ctx, seed)?;
        Ok((Arc::new(SceneData { name: scene.name.clone(), scene: seen, index }), attack))
    }

    /// Attacks in a context.
    ///
    /// *Errors*: those of the generator.
    pub(crate) fn attack_in(&self, ctx: &Context, seed: u64) -> Result<Attack> {
        let attack = self.named.built.attack(ctx, 0, seed)?;
        let attack = attack.ok_or_else(|| Error::Value("the generator gave no attack".to_owned()))?;
        attack.check(ctx.scene())?;
        Ok(attack)
    }
}
