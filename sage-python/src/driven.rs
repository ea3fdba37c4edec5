//! A drive and what attacks it.

use std::sync::Arc;

use advsage::prepared::DriverInScene;
use pyo3::prelude::*;
use sage_core::{
    generator::Extension,
    motion::{NOW, Trajectory, check_path},
    objective::{Context, Scorer},
    scene::SceneData,
};
use sage_run::Result;
use sage_sim::{
    SimScene,
    attack_test::{AttackPath, AttackTest},
    drive::Drive,
    episode::{Episode, Verdict},
};

use crate::{
    attack::PyAttack,
    built::Built,
    errors::{OptionError, detached},
    generator::PyGenerator,
    parts::Driver,
    values,
};

/// What attacks a driver.
#[derive(Clone)]
pub(crate) enum Attacker {
    /// Nothing: the scene as it is.
    Nobody,
    /// One plan of the adversary, made before, with the id of the scene that it was made for, if it is known.
    Plan(Trajectory, Option<String>),
    /// A generator, which plans against the drive without attack.
    Generator(Arc<Built>),
}

impl Attacker {
    /// The attacker of a value of Python.
    ///
    /// *Errors*: neither an attack, nor a generator, nor positions.
    pub(crate) fn of(attack: Option<&Bound<'_, PyAny>>, seed: u64) -> PyResult<Self> {
        let Some(attack) = attack else { return Ok(Self::Nobody) };
        if let Ok(attack) = attack.cast::<PyAttack>() {
            let attack = attack.get();
            let scene = attack.original.get().data.scene.id.clone();
            return Ok(Self::Plan(attack.attack.trajectory().clone(), Some(scene)));
        }
        if let Ok(generator) = attack.cast::<PyGenerator>() {
            let generator = generator.get();
            return Ok(Self::Generator(detached(attack.py(), || generator.of_seed(seed))?));
        }
        let mut plans = values::trajectories("attack", attack)?;
        match (plans.len(), plans.pop()) {
            (1, Some(plan)) => Ok(Self::Plan(plan, None)),
            (count, _) => Err(OptionError::new_err(format!(
                "attack holds {count} plans; expected an Attack, a Generator, or positions of shape (80, 2)"
            ))),
        }
    }
}

/// A drive with all that is shown of it.
pub(crate) struct Driven {
    pub(crate) episode: Episode,
    pub(crate) attacked: Option<Attacked>,
}

/// The attack of a drive.
pub(crate) struct Attacked {
    pub(crate) ctx: Context,
    pub(crate) before: Drive,
    pub(crate) plan: Trajectory,
    pub(crate) verdict: Verdict,
    /// What the generator adds to the attack.
    pub(crate) extension: Option<Extension>,
}

impl Driven {
    /// Drives a scene.
    ///
    /// *Errors*: a scene that cannot be driven or attacked; a planner that fails.
    pub(crate) fn new(scene: &SceneData, driver: &Driver, attacker: &Attacker, seed: u64) -> Result<Self> {
        let simulated = SimScene::new(scene.scene.clone(), scene.index.clone())?;
        if matches!(attacker, Attacker::Nobody) {
            let episode = Episode::run(&simulated, None, &*driver.policy, seed)?;
            return Ok(Self { episode, attacked: None });
        }
        let drives = |scene: &_| AttackTest::new(&*driver.policy, scene, seed);
        let DriverInScene { test, ctx } = DriverInScene::new(&simulated, drives)?;
        let mut extension = None;
        let path = match attacker {
            Attacker::Generator(built) => {
                let attack = built.attack_on_driver(&ctx, &test, seed)?;
                extension.clone_from(&attack.extension);
                test.path_of(&attack)?
            }
            Attacker::Plan(plan, made_for) => {
                check_plan(&ctx, plan, made_for.as_deref())?;
                AttackPath::of(plan.clone())
            }
            Attacker::Nobody => return Err(advsage::Error::Value("there is no attack".to_owned()).into()),
        };
        let plan = path.trajectory.clone();
        let is_feasible = Scorer::new(&ctx).scores(&ctx.candidate(plan.clone())).feasible;
        let outcome = test.attack_along(path, is_feasible)?;
        let (episode, verdict) = (outcome.episode, outcome.verdict);
        let attacked = Some(Attacked { ctx, before: test.unattacked().clone(), plan, verdict, extension });
        Ok(Self { episode, attacked })
    }
}

/// Refuses a plan that the adversary of a scene cannot begin.
///
/// *Errors*: it was made for another scene, or begins far from the adversary.
fn check_plan(ctx: &Context, plan: &Trajectory, made_for: Option<&str>) -> Result<()> {
    let scene = &ctx.scene().id;
    if let Some(other) = made_for.filter(|other| other != scene) {
        let problem = format!("the attack was made for the scene `{other}`, and this is `{scene}`");
        return Err(advsage::Error::Value(problem).into());
    }
    let candidate = ctx.candidate(plan.clone());
    check_path([(0, candidate.start().position), (1, candidate.points()[0])]).map_err(|problem| {
        advsage::Error::Value(format!("attack: point 0 {problem}, the adversary's at frame {NOW}"))
    })?;
    Ok(())
}
