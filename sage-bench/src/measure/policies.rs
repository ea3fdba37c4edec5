//! Policies without selection: expectations over all their candidates.

use std::{collections::BTreeMap, sync::Arc};

use sage_backbones::{
    MotionModel,
    backbone::Shared,
    metrics::{PolicyMeasures, with_rewards},
    training::{Measures, PreparedScene},
};
use sage_core::{
    metric::{Metric, MetricInfo},
    objective::{Objective, ObjectiveSpec},
    scene::SceneData,
};
use serde_json::json;

use super::{ByPrior, Group, Measurement, SceneResult, cell, infos};
use crate::{
    Error, Registries, Result,
    context::Context as _,
    in_one_line,
    rows::{Cell, Key, Subject},
    study::Study,
};

/// Arm of the prior, without any expert.
const PRIOR: &str = "prior";

/// The mixtures of a group, which share their prior.
struct Models {
    group: Group,
    models: Vec<Arc<dyn MotionModel>>,
    /// Number of the first key.
    first: usize,
}

/// All mixtures of a study, without selection.
pub struct Policies {
    groups: Vec<Models>,
    keys: Vec<Key>,
    metrics: Vec<Metric<PolicyMeasures>>,
    measures: Measures,
    /// Rewards whose expectation is measured, each as an objective of its own.
    rewards: Vec<(String, Objective)>,
}

impl Policies {
    /// The prior and all mixtures of all groups whose merger keeps the modes of the prior.
    ///
    /// *Errors*: a metric that is not registered, or an operating point that a merger refuses.
    pub fn new(study: &Study, registries: &Registries, groups: Vec<Group>) -> Result<Self> {
        let listed = study.metrics.get(&Subject::Policy).cloned().unwrap_or_default();
        let rewards = rewards(&listed, registries)?;
        let names = rewards.iter().map(|(name, _)| &name[..]);
        let metrics = with_rewards(registries.metrics.policy.clone(), names)?.by_names(&listed)?;
        let objectives: Vec<&Objective> = rewards.iter().map(|(_, objective)| objective).collect();
        let measures = Measures::of(&objectives, &registries.parts.rewards, &registries.parts.feasibilities)?;
        let (mut keys, mut all) = (Vec::new(), Vec::new());
        // Expectations are over the prior's modes.
        let keeps_modes = |group: &Group| {
            group.merger.keeps_modes() && group.experts.prior().shared() == Shared::Trajectories
        };
        for group in groups.into_iter().filter(keeps_modes) {
            let first = keys.len();
            let mut models: Vec<Arc<dyn MotionModel>> = Vec::new();
            let key = |arm: &str| Key {
                training_seed: group.training_seed,
                ..Key::new(Subject::Policy, if arm.is_empty() { "sage" } else { arm }, study.seed)
            };
            // One prior is enough, and a triangle of mixtures has no place for it.
            if all.is_empty() && study.triangle.is_none() && group.arm.is_empty() {
                models.push(group.experts.prior().clone());
                keys.push(key(PRIOR));
            }
            for spec in &group.points {
                let mixture = spec.point(Some(&group.experts))?.mixture;
                models.push(group.merger.merge(&group.experts, &mixture, study.seed)?);
                keys.push(Key { point: Some(spec.clone()), ..key(&group.arm) });
            }
            all.push(Models { group, models, first });
        }
        Ok(Self { groups: all, keys, metrics, measures, rewards })
    }

    fn of_group(&self, prepared: &PreparedScene, of: &Models) -> Result<Vec<Cell>> {
        let one = |(k, model): (usize, &Arc<dyn MotionModel>)| -> Result<Cell> {
            let mut rewards = BTreeMap::new();
            for (name, objective) in &self.rewards {
                let expected = prepared.expected_value(&**model, &self.measures.expert(objective)?)?;
                rewards.insert(name.clone(), expected);
            }
            let measured = PolicyMeasures { expectation: prepared.expectation(&**model)?, rewards };
            Ok(cell(of.first + k, &self.metrics, &measured))
        };
        of.models.iter().enumerate().map(one).collect()
    }
}

/// The rewards that a list of metrics names; for `*` all that are cheap.
fn rewards(listed: &[String], registries: &Registries) -> Result<Vec<(String, Objective)>> {
    let all = listed.iter().any(|name| name == "*");
    let is_built_in = |name: &str| registries.metrics.policy.all().iter().any(|m| m.info.name == name);
    let mut found = Vec::new();
    for entry in registries.parts.rewards.entries() {
        let is_named = listed.iter().any(|name| name == entry.name);
        if is_built_in(entry.name) || !(all || is_named) {
            continue;
        }
        let reward = registries.parts.rewards.build_default(entry.name)?;
        if !is_named && (reward.is_costly() || reward.needs_prior()) {
            continue;
        }
        // The paper's measure of lanes is of the whole trajectory.
        let options = if entry.name == "lane-distance" { json!({"phase": "whole"}) } else { json!({}) };
        let term = json!({"terms": [{"name": entry.name, "weight": 1.0, "options": options}]});
        let spec: ObjectiveSpec = serde_json::from_value(term)?;
        let objective = Objective::new(&spec, &registries.parts.rewards, &registries.parts.feasibilities)?;
        found.push((entry.name.to_owned(), objective));
    }
    Ok(found)
}

impl Measurement for Policies {
    fn keys(&self) -> &[Key] {
        &self.keys
    }

    fn metrics(&self) -> Vec<(Subject, Vec<MetricInfo>)> {
        vec![(Subject::Policy, infos(&self.metrics))]
    }

    fn measure(&self, data: &SceneData) -> SceneResult {
        let (mut result, mut all) = (SceneResult::default(), ByPrior(Vec::new()));
        for of in &self.groups {
            let prepared = all.get(&of.group, |prior| -> Result<PreparedScene> {
                let prepared = PreparedScene::new(prior, data, false, &self.measures)?;
                prepared.with_context(|| "the scene cannot be attacked")
            });
            let prepared = prepared.as_ref().map_err(|error| Error::Value(in_one_line(error)));
            match prepared.and_then(|prepared| self.of_group(prepared, of)) {
                Ok(cells) => result.cells.extend(cells),
                Err(error) => {
                    let failed = |k| Cell::failed(of.first + k, in_one_line(&error));
                    result.cells.extend((0..of.models.len()).map(failed));
                }
            }
        }
        result
    }
}
