//! The published evaluation of driving policies: an episode per scene, unchanged and under attack at λ = 1.

use std::path::{Path, PathBuf};

use advsage::{ego::Ego, generators::BuiltGenerator, operating_point::OperatingPointSpec};
use sage_core::{
    files,
    metric::{Metric, MetricInfo},
    scene::SceneData,
    seed::Rng,
};
use sage_learn::Td3Options;
use sage_sim::{
    SimScene,
    actor::{ActorPolicy, Network, Shape, read_policy},
    environment::EnvironmentOptions,
    evaluation::{EpisodeRow, attack_episode, drive_scene, evaluation_rules},
    observation::LENGTH,
    policy::EgoPolicy,
};
use serde_json::{Value, json};

use super::{Group, Measurement, SceneResult, cell, infos};
use crate::{
    Error, Registries, Result,
    context::{Context as _, require},
    rows::{Cell, Key, Subject},
    study::Study,
};

/// Arm of policies with initial weights.
const UNTRAINED: &str = "untrained";
/// Largest file of a policy that is read, bytes.
const MAX_POLICY: u64 = 64 << 20;

/// A policy to be evaluated.
struct Candidate {
    arm: String,
    training_seed: Option<u64>,
    checkpoint: Option<u64>,
    policy: Box<dyn EgoPolicy>,
    /// Changes with its weights.
    identity: Value,
}

/// Policies and generators of a study.
pub struct Episodes {
    candidates: Vec<Candidate>,
    generators: Vec<BuiltGenerator>,
    keys: Vec<Key>,
    metrics: Vec<Metric<EpisodeRow>>,
}

impl Episodes {
    /// The policies of the runs, then those by name, then untrained ones, under all generators.
    ///
    /// *Errors*: a folder without policies; several groups, or other operating points than λ = 1; a metric that is not
    /// registered.
    pub fn new(study: &Study, registries: &Registries, egos: Vec<Ego>, groups: Vec<Group>) -> Result<Self> {
        let mut candidates = Vec::new();
        for entry in &study.runs {
            let (name, folder) =
                entry.split_once('=').with_context(|| format!("run `{entry}` is not NAME=FOLDER"))?;
            require(candidates.iter().all(|c: &Candidate| c.arm != name), || {
                format!("the run `{name}` is given twice")
            })?;
            candidates.extend(of_run(name, folder.as_ref())?);
        }
        for ego in egos {
            let identity = json!(ego.label);
            let (arm, policy) = (ego.label, ego.policy);
            candidates.push(Candidate { arm, training_seed: None, checkpoint: None, policy, identity });
        }
        for seed in 0..study.untrained {
            let shape = Shape { inputs: LENGTH, hidden: Td3Options::default().hidden, outputs: 2 };
            let network = Network::random(shape, &mut Rng::new(seed, "", "actor"));
            candidates.push(Candidate {
                arm: UNTRAINED.to_owned(),
                training_seed: Some(seed),
                checkpoint: None,
                policy: Box::new(ActorPolicy::new(network)),
                identity: json!([UNTRAINED, seed]),
            });
        }
        require(!candidates.is_empty(), || "no policies; `runs` and `ego` name none")?;
        let Ok([group]) = <[Group; 1]>::try_from(groups) else {
            return Err(Error::Value(
                "episodes are attacked with one merger and one set of weights".to_owned(),
            ));
        };
        let is_whole = |point: &OperatingPointSpec| point.lambda == Some(1.0) && point.mu == 1.0;
        require(
            group.points.iter().all(is_whole),
            || "episodes are attacked at lambda 1; leave other points out",
        )?;
        let generators = group.built;
        let listed = study.metrics.get(&Subject::Episode).cloned().unwrap_or_default();
        let mut keys = Vec::new();
        for candidate in &candidates {
            let names = generators.iter().map(|built| built.keys[0].part().to_string());
            keys.extend(std::iter::once(String::new()).chain(names).map(|attack| Key {
                training_seed: candidate.training_seed,
                checkpoint: candidate.checkpoint,
                attack,
                ..Key::new(Subject::Episode, &*candidate.arm, study.seed)
            }));
        }
        let metrics = registries.metrics.episode.by_names(&listed)?;
        Ok(Self { candidates, generators, keys, metrics })
    }

    /// What identifies the policies.
    pub fn identity(&self) -> Value {
        self.candidates.iter().map(|candidate| candidate.identity.clone()).collect()
    }
}

/// The policies of the last evaluations of all seeds of a run.
fn of_run(name: &str, folder: &Path) -> Result<Vec<Candidate>> {
    let listed = |path: &Path| -> Result<Vec<PathBuf>> {
        let entries = std::fs::read_dir(path).with_context(|| format!("cannot read `{}`", path.display()))?;
        entries.map(|entry| Ok(entry?.path())).collect()
    };
    let number = |path: &Path, prefix: &str, suffix: &str| -> Option<u64> {
        path.file_name()?.to_str()?.strip_prefix(prefix)?.strip_suffix(suffix)?.parse().ok()
    };
    let mut seeds: Vec<(u64, PathBuf)> =
        listed(folder)?.into_iter().filter_map(|path| Some((number(&path, "seed-", "")?, path))).collect();
    seeds.sort();
    let mut all = Vec::new();
    for (seed, path) in seeds {
        let policies = listed(&path)?.into_iter();
        let mut policies: Vec<(u64, PathBuf)> =
            policies.filter_map(|file| Some((number(&file, "policy-", ".safetensors")?, file))).collect();
        policies.sort();
        for (step, file) in policies {
            let (network, card) = read_policy(&file)?;
            let bytes = files::read(&file, MAX_POLICY)?;
            all.push(Candidate {
                arm: name.to_owned(),
                training_seed: Some(seed),
                checkpoint: Some(step),
                policy: Box::new(card.policy(network)),
                identity: json!([name, seed, step, blake3::hash(&bytes).to_hex()[..16]]),
            });
        }
    }
    if all.is_empty() {
        return Err(Error::Value(format!(
            "`{}` holds no policies of finished seeds; expected `seed-0/policy-….safetensors`",
            folder.display()
        )));
    }
    Ok(all)
}

impl Measurement for Episodes {
    fn write_logs_to(&self, folder: &Path) {
        self.candidates.iter().for_each(|candidate| candidate.policy.write_logs_to(folder));
    }

    fn keys(&self) -> &[Key] {
        &self.keys
    }

    fn metrics(&self) -> Vec<(Subject, Vec<MetricInfo>)> {
        vec![(Subject::Episode, infos(&self.metrics))]
    }

    fn measure(&self, data: &SceneData) -> SceneResult {
        let scene = match SimScene::new(data.scene.clone(), data.index.clone()) {
            Ok(scene) => scene,
            Err(error) => {
                let cells = (0..self.keys.len()).map(|key| Cell::failed(key, &error)).collect();
                return SceneResult { cells, left_out: Vec::new() };
            }
        };
        let rules = evaluation_rules(&EnvironmentOptions::training());
        let mut result = SceneResult::default();
        for candidate in &self.candidates {
            let mut push = |row: &EpisodeRow| {
                let number = result.cells.len();
                if let Some(reason) = row.failed.as_ref().filter(|_| row.is_without_result) {
                    return result.cells.push(Cell::failed(number, reason));
                }
                let mut found = cell(number, &self.metrics, row);
                // A failed episode counts, as a failure.
                found.notes.extend(row.failed.iter().map(|reason| (0, reason.clone())));
                result.cells.push(found);
            };
            let (row, drive) = drive_scene(&*candidate.policy, &scene, 0, &rules, 0);
            push(&row);
            for generator in &self.generators {
                push(&attack_episode(&*candidate.policy, &scene, 0, drive.as_ref(), generator, &rules, 0));
            }
        }
        result
    }
}
