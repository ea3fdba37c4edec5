//! What the environments of a batch share: scenes, rules, and the adversary.

use std::sync::{Arc, Mutex, PoisonError};

use sage_core::generator::OperatingPoint;

use super::{Experience, Recent};
use crate::{
    Error, attacker::Attacker, curriculum::Curriculum, drive::Drive, environment::EnvironmentOptions,
    scene::SimScene, traffic::Plan,
};

/// Plans against recordings that are kept.
const PLANS: usize = 512;

/// The scenes that episodes take place in.
pub trait SceneSource: Send + Sync {
    /// Number of scenes.
    fn count(&self) -> usize;

    /// A scene by its number below [`SceneSource::count`].
    ///
    /// *Errors*: it cannot be read or simulated.
    fn scene(&self, number: usize) -> Result<Arc<SimScene>, Error>;
}

impl SceneSource for Vec<Arc<SimScene>> {
    fn count(&self) -> usize {
        self.len()
    }

    fn scene(&self, number: usize) -> Result<Arc<SimScene>, Error> {
        Ok(self[number].clone())
    }
}

/// How the scenes of an environment follow one another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SceneOrder {
    /// Each is drawn.
    #[default]
    Random,
    /// Environment *k* of *n* workers takes scene `first + k`, then every `workers`-th one, and begins again at the end.
    Sequential {
        /// Number of the first environment among all workers.
        first: usize,
        /// Number of environments among which the scenes are divided.
        workers: usize,
    },
}

/// Who attacks, when, and against what.
pub struct Adversary {
    /// Plans the attacks.
    pub attacker: Arc<dyn Attacker>,
    /// When it attacks, and how strongly.
    pub curriculum: Arc<dyn Curriculum>,
    /// Whether it plans against the newest drive in the scene, once there is one, in place of the recording.
    pub against_drives: bool,
    /// Steps of all environments in the whole training: where the curriculum ends.
    pub total_steps: u64,
    plans: Mutex<Recent<(usize, u64), Arc<Plan>>>,
}

impl Adversary {
    /// An adversary.
    pub fn new(
        attacker: Arc<dyn Attacker>,
        curriculum: Arc<dyn Curriculum>,
        against_drives: bool,
        total_steps: u64,
    ) -> Self {
        Self { attacker, curriculum, against_drives, total_steps, plans: Mutex::new(Recent::new(PLANS)) }
    }

    /// The plan of an attack of intensity λ in a scene. One against the recording is computed once, with seed 0, unless the attacker
    /// draws.
    ///
    /// *Errors*: the scene cannot be attacked.
    pub(super) fn plan(
        &self,
        number: usize,
        scene: &SimScene,
        experience: &Experience,
        lambda: f64,
        seed: u64,
    ) -> Result<Arc<Plan>, Error> {
        let at = OperatingPoint::at(lambda, lambda);
        let drive = experience.drives.get(&number).filter(|_| self.against_drives);
        if let Some(motions) = drive {
            let drive = Drive::of_motions(motions.to_vec());
            return self.attacker.plan(scene, Some(&drive), &at, seed);
        }
        if self.attacker.draws() {
            return self.attacker.plan(scene, None, &at, seed);
        }
        let key = (number, lambda.to_bits());
        let known = self.plans.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(plan) = known {
            return Ok(plan);
        }
        let plan = self.attacker.plan(scene, None, &at, 0)?;
        self.plans.lock().unwrap_or_else(PoisonError::into_inner).put(key, plan.clone());
        Ok(plan)
    }
}

/// What the environments of a batch share.
pub struct Setting {
    /// The scenes.
    pub scenes: Arc<dyn SceneSource>,
    /// How they follow one another.
    pub order: SceneOrder,
    /// The rules.
    pub rules: Arc<EnvironmentOptions>,
    /// `None` for scenes as they were recorded.
    pub adversary: Option<Adversary>,
}
