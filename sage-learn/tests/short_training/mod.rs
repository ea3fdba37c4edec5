//! A training run of a second, on procedural scenes.

use std::sync::Arc;

use sage_core::scene::SceneIndex;
use sage_data::procedural::{Kind, generate};
use sage_learn::{
    SceneSampler, Setting, Td3Options, TrainingOptions, curricula::curricula, scene_sampler::scene_samplers,
};
use sage_sim::{
    SimScene,
    curriculum::Curriculum,
    policy::{EgoPolicy, policies},
};

/// Procedural scenes with an adversary.
pub fn scenes(count: u64, seed: u64) -> Vec<Arc<SimScene>> {
    let made = (0..count).filter_map(|number| {
        let scene = generate(Kind::ALL[number as usize % Kind::ALL.len()], seed, number)?;
        SimScene::new(Arc::new(scene.clone()), SceneIndex::new(scene.map.clone())).ok()
    });
    made.filter(|scene| scene.scene().adversary.is_some()).collect()
}

/// Options of a short run.
pub fn small() -> TrainingOptions {
    TrainingOptions {
        td3: Td3Options {
            hidden: [16, 16],
            batch: 32,
            random_steps: 200,
            buffer: 500,
            ..Td3Options::default()
        },
        updates: 600,
        ratio: 0.5,
        evaluations: 3,
        drives: 2,
        refresh_after: Some(200),
        seed: 7,
        ..TrainingOptions::default()
    }
}

/// Registered parts of a training. Only a learner that is taught asks the teacher.
pub struct Parts {
    curriculum: Box<dyn Curriculum>,
    sampler: Box<dyn SceneSampler>,
    teacher: Box<dyn EgoPolicy>,
}

impl Parts {
    pub fn of(curriculum: &str, sampler: &str) -> Self {
        let curricula = curricula().expect("names differ");
        Self {
            curriculum: curricula.build_default(curriculum).expect("registered"),
            sampler: scene_samplers().expect("names differ").build_default(sampler).expect("registered"),
            teacher: policies().expect("names differ").build_default("expert").expect("registered"),
        }
    }

    /// A training without attacks.
    pub fn setting<'a>(
        &'a self,
        scenes: &'a [Arc<SimScene>],
        evaluation: &'a [Arc<SimScene>],
    ) -> Setting<'a> {
        Setting {
            scenes,
            evaluation,
            attacker: None,
            examiner: None,
            curriculum: &*self.curriculum,
            sampler: &*self.sampler,
            teacher: Some(&*self.teacher),
            second_kind: None,
        }
    }
}
