//! A scene made ready to be attacked: where commands refuse it, let a driver drive without an attack, and turn it into what generators see.

use std::sync::Arc;

use sage_core::{
    Error as CoreError,
    generator::Attack,
    objective::{Context, ContextOptions, Scorer, Scores},
    scene::{Scene, SceneIndex},
};
use sage_sim::{
    SimScene,
    attack_test::{AttackOutcome, AttackTest},
    policy::EgoPolicy,
};

use crate::{Error, Result, ego::Ego, generators::Against};

/// The recording of a scene, ready to be attacked.
///
/// *Errors*: it is too short or has no adversary; [`CoreError::ContactNow`] if the two cars touch *now*.
pub fn recording(scene: &Arc<Scene>, index: &Arc<SceneIndex>) -> Result<Context, CoreError> {
    scene.attackable_horizon()?;
    scene.check_apart_now()?;
    Context::new(scene, index, &ContextOptions::default())
}

/// What generators see of a driver that has driven, in a recording that can be attacked.
///
/// *Errors*: as [`recording`], for the recording and for the drive.
pub fn drive(test: &AttackTest) -> Result<Context> {
    test.scene().attackable_horizon()?;
    test.scene().check_apart_now()?;
    let ctx = test.context()?;
    ctx.check_apart_now()?;
    Ok(ctx)
}

/// A scene ready to be attacked: its recording, or a driver in it.
///
/// ```
/// use std::{path::Path, sync::Arc};
///
/// use advsage::{Against, GeneratorSpec, Prepared, Recording, Registries};
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let scene = Arc::new(Recording::read(file)?.scene);
/// let prepared = Prepared::recorded(&scene)?;
/// let rule = GeneratorSpec::named("rule")?.build(&Registries::of_attacks()?)?;
/// let attack = rule.attacks(&prepared.ctx, Against::Recording)?.remove(0);
/// // The rule cuts in onto the ego's path, one frame ahead of it.
/// assert_eq!(prepared.scores(&attack).collision, Some(true));
/// # Ok::<(), advsage::Error>(())
/// ```
pub struct Prepared<'d> {
    /// The driver with its drive without an attack; `None` for the recording.
    pub test: Option<AttackTest<'d>>,
    /// What generators see.
    pub ctx: Context,
}

impl<'d> Prepared<'d> {
    /// The recording, or a driver after its drive without an attack; `test` lets it drive.
    ///
    /// *Errors*: as [`recording`] and [`DriverInScene::new`].
    pub fn new<E>(
        scene: Arc<Scene>,
        index: &Arc<SceneIndex>,
        driver: &dyn EgoPolicy,
        test: impl FnOnce(&Arc<SimScene>) -> Result<AttackTest<'d>, E>,
    ) -> Result<Self>
    where
        Error: From<E>,
    {
        if driver.is_recording() {
            return Ok(Self { test: None, ctx: recording(&scene, index)? });
        }
        let DriverInScene { test, ctx } = DriverInScene::new(&SimScene::new(scene, index.clone())?, test)?;
        Ok(Self { test: Some(test), ctx })
    }

    /// The recorded ego of a scene.
    ///
    /// *Errors*: as [`recording`].
    pub fn recorded(scene: &Arc<Scene>) -> Result<Self> {
        Ok(Self { test: None, ctx: recording(scene, &SceneIndex::new(scene.map.clone()))? })
    }

    /// All measures of an attack's plan against the ego's path without it: when it touches the ego, whether it is feasible and believable.
    pub fn scores(&self, attack: &Attack) -> Scores {
        Scorer::new(&self.ctx).scores(&self.ctx.candidate(attack.trajectory().clone()))
    }

    /// Whom an attack on it is against.
    pub fn against(&self) -> Against<'_> {
        self.test.as_ref().map_or(Against::Recording, Against::Driver)
    }
}

/// A driver in a scene, after its drive without an attack.
///
/// An attack that is planned against what a driver does, and its drive against it:
///
/// ```
/// use std::{path::Path, sync::Arc};
///
/// use advsage::{Against, DriverInScene, Ego, GeneratorSpec, Recording, Registries};
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let registries = Registries::of_attacks()?;
/// let scene = Arc::new(Recording::read(file)?.scene);
/// let (driver, rule) = (Ego::named("constant-speed", &registries)?, GeneratorSpec::named("rule")?);
/// let driven = DriverInScene::of(&scene, &driver, 0)?;
/// let rule = rule.build(&registries)?;
/// let attack = rule.attacks(&driven.ctx, Against::Driver(&driven.test))?.remove(0);
/// let outcome = driven.drive(&attack)?;
/// // It reacts to nothing; the drive ends at the contact.
/// assert!(outcome.meets_adversary() && outcome.episode.steps() < 90);
/// # Ok::<(), advsage::Error>(())
/// ```
pub struct DriverInScene<'d> {
    /// The driver with that drive.
    pub test: AttackTest<'d>,
    /// What generators see: with that drive in place of the ego's recording.
    pub ctx: Context,
}

impl<'d> DriverInScene<'d> {
    /// Lets a driver drive without an attack.
    ///
    /// *Errors*: as [`recording`], for the recording and for that drive; the driver cannot drive here.
    pub fn new<E>(
        scene: &Arc<SimScene>,
        test: impl FnOnce(&Arc<SimScene>) -> Result<AttackTest<'d>, E>,
    ) -> Result<Self>
    where
        Error: From<E>,
    {
        scene.scene().attackable_horizon()?;
        scene.scene().check_apart_now()?;
        Self::of_test(test(scene)?)
    }

    /// Lets a driver drive a scene without an attack.
    ///
    /// *Errors*: as [`DriverInScene::new`].
    pub fn of(scene: &Arc<Scene>, driver: &'d Ego, seed: u64) -> Result<Self> {
        let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
        Self::new(&simulated, |scene| driver.test(scene, seed))
    }

    /// Lets it drive again, against an attack.
    ///
    /// *Errors*: an attack that the adversary cannot begin; the driver cannot go on.
    pub fn drive(&self, attack: &Attack) -> Result<AttackOutcome> {
        let path = self.test.path_of(attack)?;
        let candidate = self.ctx.candidate(path.trajectory.clone());
        let is_feasible = Scorer::new(&self.ctx).scores(&candidate).feasible;
        Ok(self.test.attack_along(path, is_feasible)?)
    }

    /// The same of a driver that has driven, in any recording.
    ///
    /// *Errors*: as [`recording`], for its drive.
    pub fn of_test(test: AttackTest<'d>) -> Result<Self> {
        let ctx = test.context()?;
        ctx.check_apart_now()?;
        Ok(Self { test, ctx })
    }
}
