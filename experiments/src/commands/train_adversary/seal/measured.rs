//! What the trained parts are worth, on scenes that they were not trained on.

use std::sync::Arc;

use advsage::generators::BuiltGenerator;
use anyhow::{Context as _, Result};
use rayon::prelude::*;
use sage_baselines::{
    learned_scores,
    rollout::{Rollout, RolloutEnd, rules},
    seal::networks::{SKILL, SealWeights, SkillEncoder, SkillWindows, WINDOW},
    seal_reaction,
};
use sage_bench::estimate;
use sage_core::{
    geometry::{Point, distance},
    motion::Trajectory,
    objective::{Context, Situation},
    scene::SceneData,
    statistics::{Estimate, median, rank_correlation},
};
use sage_generators::selector::cat_select;
use sage_run::{outcome::caught, scenes::Scenes};
use sage_sim::{
    environment::Environment, observation::LENGTH, policy::Replay, traffic::Plan, vehicle::Action,
};
use serde::Serialize;

use super::collected::RolloutScene;

/// What was measured; every estimate is a mean over scenes with its 95 % interval.
#[derive(Default, Serialize)]
pub(super) struct Measured {
    rank: Option<Ranks>,
    /// Median over the windows of a scene of the farthest distance between a decoded skill and the drive, metres.
    decoded_distance: Option<Estimate>,
    /// Against the car-following driver of the roll-outs.
    contacts: Option<Contacts>,
    /// Against the ego's recording.
    contacts_replay: Option<Contacts>,
}

/// Rank correlations with the measured collision score among the candidates of a scene.
#[derive(Serialize)]
struct Ranks {
    learned: Option<Estimate>,
    cat: Option<Estimate>,
    r_adv: Option<Estimate>,
    learned_less_cat: Option<Estimate>,
    learned_less_r_adv: Option<Estimate>,
}

/// Shares of candidates with a contact with the adversary, if a learned driver takes over.
#[derive(Serialize)]
struct Contacts {
    adversarial: Option<Estimate>,
    benign: Option<Estimate>,
    difference: Option<Estimate>,
    /// Without a learned driver.
    plan: Option<Estimate>,
}

/// What was measured in one scene.
struct InScene {
    /// Rank correlation of the learned score, CAT's and R_adv; `None` where all candidates are equally critical.
    ranks: Option<[f64; 3]>,
    decoded_distance: Option<f64>,
    /// Shares of contacts: skills before contacts, ordinary ones, the plan alone.
    contacts: [f64; 3],
    contacts_replay: [f64; 3],
}

/// Measures the parts in all scenes; nothing without scenes.
///
/// *Errors*: a network's output is not finite.
pub(super) fn measure(
    list: &Scenes,
    dev: &[SceneData],
    candidates: &BuiltGenerator,
    weights: [SealWeights; 2],
    encoder: &SkillEncoder,
    seed: u64,
) -> Result<Measured> {
    let weights = weights.map(Arc::new);
    let one = |data: &SceneData| {
        in_scene(data, candidates, &weights, encoder, seed).with_context(|| format!("`{}`", data.name))
    };
    let all: Vec<Result<InScene>> = dev.par_iter().with_max_len(1).map(|data| caught(|| one(data))).collect();
    let mut scenes = Vec::new();
    for (measured, data) in all.into_iter().zip(dev) {
        match measured {
            Ok(measured) => scenes.push(measured),
            Err(error) => list.fail(&data.name, error.as_ref()),
        }
    }
    let mean_of = |name: &str, values: Vec<f64>| {
        estimate::of_scenes(values.len(), name, |drawn| {
            drawn.iter().map(|k| values[*k]).sum::<f64>() / drawn.len().max(1) as f64
        })
    };
    let ranks: Vec<[f64; 3]> = scenes.iter().filter_map(|scene| scene.ranks).collect();
    let of_ranks = |name: &str, of: fn(&[f64; 3]) -> f64| mean_of(name, ranks.iter().map(of).collect());
    let contacts = |all: Vec<[f64; 3]>| {
        let of = |name: &str, of: fn(&[f64; 3]) -> f64| mean_of(name, all.iter().map(of).collect());
        Contacts {
            adversarial: of("adversarial", |c| c[0]),
            benign: of("benign", |c| c[1]),
            difference: of("difference", |c| c[0] - c[1]),
            plan: of("plan", |c| c[2]),
        }
    };
    Ok(Measured {
        rank: Some(Ranks {
            learned: of_ranks("learned", |r| r[0]),
            cat: of_ranks("cat", |r| r[1]),
            r_adv: of_ranks("r_adv", |r| r[2]),
            learned_less_cat: of_ranks("learned less cat", |r| r[0] - r[1]),
            learned_less_r_adv: of_ranks("learned less r_adv", |r| r[0] - r[2]),
        }),
        decoded_distance: mean_of("decoded", scenes.iter().filter_map(|s| s.decoded_distance).collect()),
        contacts: Some(contacts(scenes.iter().map(|scene| scene.contacts).collect())),
        contacts_replay: Some(contacts(scenes.iter().map(|scene| scene.contacts_replay).collect())),
    })
}

fn in_scene(
    data: &SceneData,
    candidates: &BuiltGenerator,
    weights: &[Arc<SealWeights>; 2],
    encoder: &SkillEncoder,
    seed: u64,
) -> Result<InScene> {
    let rollouts = RolloutScene::new(data, candidates, seed)?;
    let ctx = &rollouts.undisturbed;
    let all = &rollouts.attack.candidates;
    let plans: Vec<_> = all.iter().map(|candidate| &candidate.trajectory).collect();
    let learned = learned_scores(&weights[0].criticality, &plans, ctx, &ctx.egos()[..1])?;
    let log_probs: Vec<f64> = all.iter().map(|candidate| candidate.log_prob.unwrap_or(0.0)).collect();
    let points: Vec<&[Point]> = plans.iter().map(|plan| plan.points()).collect();
    let ego = [(ctx.ego().positions(), 1.0)];
    let cat = cat_select(&points, &log_probs, &ego, ctx.size(), ctx.ego_size()).scores;
    let reward = |plan: &Trajectory| {
        let candidate = ctx.candidate(plan.clone());
        Situation::new(&candidate, ctx.ego(), ctx).encounter.reward(ctx.convention())
    };
    let r_adv: Vec<f64> = plans.iter().map(|plan| reward(plan)).collect();
    let (mut collisions, mut contacts, mut contacts_replay) = (Vec::new(), [0.0; 3], [0.0; 3]);
    for candidate in all {
        let plan = rollouts.plan(candidate)?;
        let adversary = plan.track;
        let (rollout, found) = rollouts.against(plan.clone())?;
        collisions.push(found.collision);
        let is_hit = |rollout: &Rollout| {
            f64::from(rollout.end == RolloutEnd::Contact && rollout.touched.contains(&adversary))
        };
        contacts[2] += is_hit(&rollout);
        contacts_replay[2] += is_hit(&rollouts.driven(&Replay, plan.clone())?);
        for (k, weights) in weights.iter().enumerate() {
            let reacting = |ctx: &Context| {
                let reaction = seal_reaction(weights.clone(), &candidate.trajectory, ctx, seed);
                Plan { reaction: Some(reaction), ..plan.clone() }
            };
            contacts[k] += is_hit(&rollouts.driven(&*rollouts.driver, reacting(ctx))?);
            contacts_replay[k] += is_hit(&rollouts.driven(&Replay, reacting(&rollouts.recorded))?);
        }
    }
    let differs = collisions.iter().any(|x| *x != collisions[0]);
    let ranks = differs.then(|| [&learned, &cat, &r_adv].map(|scores| rank_correlation(scores, &collisions)));
    let decoded_distance = decoded_distance(&rollouts, &weights[0], encoder, seed)?;
    let [contacts, contacts_replay] =
        [contacts, contacts_replay].map(|sums| sums.map(|sum| sum / all.len() as f64));
    Ok(InScene { ranks, decoded_distance, contacts, contacts_replay })
}

/// Median over the windows of the unattacked drive, one a second, of the farthest distance in 10 steps between the drive and
/// one from the same state by the decoder with the window's encoded skill; `None` without a window.
fn decoded_distance(
    rollouts: &RolloutScene,
    weights: &SealWeights,
    encoder: &SkillEncoder,
    seed: u64,
) -> Result<Option<f64>> {
    let rollout = &rollouts.unattacked;
    let starts = (0..(rollout.actions.len() + 1).saturating_sub(WINDOW)).step_by(WINDOW);
    let ego: Vec<Option<Point>> = rollout.path(rollouts.scene.scene().ego).collect();
    let mut environment = Environment::reset(rollouts.scene.clone(), rules(), None, seed)?;
    let mut farthest = Vec::new();
    for start in starts {
        let mut window = SkillWindows { groups: vec![0], ..SkillWindows::default() };
        for step in start..start + WINDOW {
            let action = rollout.actions[step];
            window.observations.extend(rollout.observations[step].iter());
            window.actions.extend([action.steer as f32, action.throttle as f32]);
        }
        let mu = encoder.encode(&window)?.mu;
        let skill: [f32; SKILL] = mu.try_into().ok().context("a window has one skill")?;
        let mut decoded = environment.clone();
        let mut gaps = Vec::new();
        for step in start..start + WINDOW {
            if decoded.is_over() {
                break;
            }
            let mut seen = [0.0; LENGTH];
            decoded.observe(&mut seen);
            let [steer, throttle] = weights.decoder.action(&seen, &skill)?;
            decoded.step(Action { steer, throttle })?;
            let at = ego.get(step + 1).copied().flatten();
            gaps.extend(at.map(|at| distance(at, decoded.world().motion().position)));
        }
        farthest.extend(gaps.into_iter().max_by(f64::total_cmp));
        for step in start..start + WINDOW {
            if !environment.is_over() {
                environment.step(rollout.actions[step])?;
            }
        }
    }
    Ok(median(&farthest))
}
