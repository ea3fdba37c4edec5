//! What the policy is worth, on scenes that it was not trained on.

use anyhow::Result;
use rayon::prelude::*;
use sage_baselines::goose::{
    TRIALS, Trial, TrialScene, action,
    networks::{ACTION, GooseWeights},
    tried,
};
use sage_bench::estimate;
use sage_core::{scene::SceneData, seed::Rng, statistics::Estimate};
use sage_run::{outcome::caught, scenes::Scenes};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    policy::{EgoPolicy, Replay},
    queried::QueriedDriver,
};
use serde::Serialize;

/// What was measured against the driver of the training, and against the ego's recording.
#[derive(Default, Serialize)]
pub(super) struct Measured {
    pub(super) driver: Option<Outcomes>,
    pub(super) recording: Option<Outcomes>,
}

/// Shares of scenes with 95 % intervals, of the last trial of each.
#[derive(Serialize)]
pub(super) struct Outcomes {
    pub(super) policy: Shares,
    /// Random actions in as many trials.
    pub(super) random: Shares,
    /// The curve through the recording.
    pub(super) unchanged: Shares,
    /// Contacts of the policy less those of random actions.
    pub(super) hits_over_random: Option<Estimate>,
}

#[derive(Serialize)]
pub(super) struct Shares {
    /// Whether the goal is reached: a contact, smoothly.
    pub(super) goal: Option<Estimate>,
    /// Whether the ego has a contact with the adversary.
    pub(super) hit: Option<Estimate>,
}

/// Goal reached and contact, for the policy, random actions and the unchanged curve.
type InScene = [[f64; 2]; 3];

/// Measures in all scenes; nothing without scenes.
pub(super) fn measure(
    list: &Scenes,
    dev: &[SceneData],
    weights: &GooseWeights,
    policy: &dyn EgoPolicy,
    seed: u64,
) -> Measured {
    let against = |driver: &dyn EgoPolicy, name: &str| {
        let one = |data: &SceneData| caught(|| in_scene(data, weights, driver, seed));
        let all: Vec<Result<Option<InScene>>> = dev.par_iter().with_max_len(1).map(one).collect();
        let mut scenes = Vec::new();
        for (found, data) in all.into_iter().zip(dev) {
            match found {
                Ok(found) => scenes.extend(found),
                Err(error) => list.fail(&data.name, error.as_ref()),
            }
        }
        outcomes(&scenes, name)
    };
    if dev.is_empty() {
        return Measured::default();
    }
    Measured { driver: Some(against(policy, "driver")), recording: Some(against(&Replay, "recording")) }
}

fn outcomes(scenes: &[InScene], name: &str) -> Outcomes {
    let mean = |what: &str, of: &(dyn Fn(&InScene) -> f64 + Sync)| {
        estimate::of_scenes(scenes.len(), &format!("{name}: {what}"), |drawn| {
            drawn.iter().map(|k| of(&scenes[*k])).sum::<f64>() / drawn.len().max(1) as f64
        })
    };
    let shares = |what: &str, of: usize| Shares {
        goal: mean(&format!("goal of {what}"), &|scene| scene[of][0]),
        hit: mean(&format!("hit of {what}"), &|scene| scene[of][1]),
    };
    Outcomes {
        policy: shares("policy", 0),
        random: shares("random", 1),
        unchanged: shares("unchanged", 2),
        hits_over_random: mean("hits over random", &|scene| scene[0][1] - scene[1][1]),
    }
}

/// `None` where ego and adversary overlap *now*: no attack counts there.
fn in_scene(
    data: &SceneData,
    weights: &GooseWeights,
    policy: &dyn EgoPolicy,
    seed: u64,
) -> Result<Option<InScene>> {
    let scene = SimScene::new(data.scene.clone(), data.index.clone())?;
    let test = AttackTest::new(policy, &scene, seed)?;
    let (ctx, driver) = (test.context()?, QueriedDriver::new(&test));
    if ctx.is_in_contact_now() {
        return Ok(None);
    }
    let trials = TrialScene::new(&ctx, weights.options())?;
    let by_policy = tried(&trials, &driver, TRIALS, |trial| action(weights, &ctx, trial))?;
    let mut rng = Rng::new(seed, &data.scene.id, "random actions");
    let random = |_: &Trial| Ok::<[f64; ACTION], _>(std::array::from_fn(|_| rng.uniform(-1.0, 1.0)));
    let by_chance = tried(&trials, &driver, TRIALS, random)?;
    let outcome = |trial: Option<&Trial>| {
        trial.map_or([0.0; 2], |trial| [trial.outcome.is_done, trial.is_hit].map(|x| f64::from(u8::from(x))))
    };
    Ok(Some([outcome(by_policy.last()), outcome(by_chance.last()), outcome(by_policy.first())]))
}
