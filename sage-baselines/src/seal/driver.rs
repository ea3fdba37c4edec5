//! The learned driver: skills drawn for what the adversary sees, held for a second, and decoded into actions.

use std::sync::Arc;

use sage_core::{
    Error,
    generator::{ReactiveDriver, ReactivePolicy},
    seed::Rng,
};

use crate::seal::networks::{OBSERVATION, SKILL, SealWeights, WINDOW};

/// The policy of skills. Its random numbers depend on seed, scene and frame alone.
pub(super) struct Skills(pub Arc<SealWeights>);

impl ReactivePolicy for Skills {
    fn start(&self, scene: &str, seed: u64) -> Box<dyn ReactiveDriver> {
        let (weights, scene) = (self.0.clone(), scene.to_owned());
        Box::new(SkillDriver { weights, scene, seed, skill: [0.0; SKILL], left: 0 })
    }
}

#[derive(Clone)]
struct SkillDriver {
    weights: Arc<SealWeights>,
    scene: String,
    seed: u64,
    skill: [f32; SKILL],
    /// Steps for which the skill is still held.
    left: usize,
}

impl SkillDriver {
    fn error(&self, frame: usize, problem: impl std::fmt::Display) -> Error {
        Error::Scene {
            scene: self.scene.clone(),
            problem: format!("frame {frame}: the adversary's learned driver: {problem}"),
        }
    }
}

impl ReactiveDriver for SkillDriver {
    fn action(&mut self, frame: usize, observation: &[f32]) -> Result<[f64; 2], Error> {
        let Ok(observation) = <&[f32; OBSERVATION]>::try_from(observation) else {
            let found = observation.len();
            return Err(
                self.error(frame, format!("the observation has {found} numbers, expected {OBSERVATION}"))
            );
        };
        if self.left == 0 {
            let mut rng = Rng::new(self.seed, &self.scene, &format!("skill at frame {frame}"));
            let noise = std::array::from_fn(|_| rng.normal() as f32);
            let skill = self.weights.adversarial.sample(&noise, observation);
            self.skill = skill.map_err(|error| self.error(frame, error))?;
            self.left = WINDOW;
        }
        self.left -= 1;
        self.weights.decoder.action(observation, &self.skill).map_err(|error| self.error(frame, error))
    }

    fn boxed_clone(&self) -> Box<dyn ReactiveDriver> {
        Box::new(self.clone())
    }
}
