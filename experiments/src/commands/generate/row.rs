//! The row of one attack: its JSON file and its printed line.

use std::{
    collections::{HashMap, hash_map::Entry},
    path::Path,
};

use anyhow::{Context as _, Result};
use sage_core::{
    files,
    generator::{Attack, Proposal},
    motion::Trajectory,
    objective::{Context, Reason, Scorer, Scores, Violation, verdict},
};
use sage_sim::avoidable::{Avoidable, Avoidance};
use serde::{Deserialize, Serialize};
use serde_json::{
    Map, Value,
    value::{RawValue, to_raw_value},
};

use crate::{scene_queue::ROW_LIMIT, terminal};

/// Name of a row's file.
pub(super) fn row_file(scene: &str, variant: &str) -> String {
    format!("{scene}-{variant}.json")
}

/// One attack, as its file records it.
#[derive(Serialize)]
pub(super) struct VariantRow<'r> {
    /// Hash of the run's identity. The first field, so that it can be checked without reading the row.
    pub(super) run_hash: &'r str,
    /// Name of the input file without its ending.
    pub(super) scene: &'r str,
    /// Name of the operating point, as in file names.
    pub(super) variant: &'r str,
    /// Hash of the input file.
    pub(super) source_hash: &'r str,
    /// The scene files of this attack.
    pub(super) files: Vec<String>,
    pub(super) seed: u64,
    /// Track of the adversary.
    pub(super) adversary: &'r str,
    #[serde(flatten)]
    pub(super) described: Map<String, Value>,
    pub(super) trajectory: &'r Trajectory,
    pub(super) chosen: usize,
    /// Feasibility by the rule of the selection, like `violations`.
    pub(super) feasible: bool,
    pub(super) violations: Vec<Violation>,
    pub(super) note: Option<String>,
    pub(super) scores: ChosenScores<'r>,
    pub(super) candidates: Vec<CandidateRow<'r>>,
}

/// The row of a scene in which no attack can be measured.
#[derive(Serialize)]
pub(super) struct LeftOutRow<'r> {
    pub(super) run_hash: &'r str,
    pub(super) scene: &'r str,
    pub(super) variant: &'r str,
    pub(super) source_hash: &'r str,
    /// None.
    pub(super) files: [String; 0],
    /// Why.
    pub(super) left_out: &'r str,
}

impl LeftOutRow<'_> {
    /// The printed line.
    pub(super) fn line(&self) -> String {
        let [scene, variant] = [self.scene, self.variant].map(terminal::escaped_name);
        format!("{scene} {variant}: left out, contact now")
    }
}

/// Scores of the chosen candidate, and whether a driver could have avoided it.
#[derive(Serialize)]
pub(super) struct ChosenScores<'r> {
    #[serde(flatten)]
    pub(super) scores: &'r Scores,
    #[serde(flatten)]
    pub(super) avoidable: Avoidable,
    /// Whether the driver `r157`, in the ego's place from frame 0 on, has no contact with the adversary; `None` if the
    /// attack has none, or if this driver meets another road user first.
    pub(super) r157_avoids: Option<bool>,
}

/// One candidate of an attack.
#[derive(Serialize)]
pub(super) struct CandidateRow<'r> {
    log_prob: Option<f64>,
    goal: Option<[f64; 2]>,
    trajectory: &'r RawValue,
    scores: &'r RawValue,
}

/// A trajectory with its scores, also as JSON.
pub(super) struct Scored {
    pub(super) scores: Scores,
    json: Box<RawValue>,
    trajectory: Box<RawValue>,
}

/// Scores of the candidates of one scene. Attacks at several operating points share many candidates, so each
/// candidate is scored and written as JSON only once.
pub(super) struct ScoredCandidates<'s> {
    ctx: &'s Context,
    scorer: Scorer<'s>,
    avoidance: &'s Avoidance,
    /// Whether a driver could have avoided a chosen candidate, by its index in `all`.
    avoidable: HashMap<usize, Avoidable>,
    all: Vec<Scored>,
    /// Index of each trajectory in `all`, by the bits of its coordinates.
    indices: HashMap<Vec<u64>, usize>,
}

impl<'s> ScoredCandidates<'s> {
    pub(super) fn new(ctx: &'s Context, scorer: Scorer<'s>, avoidance: &'s Avoidance) -> Self {
        let (all, indices, avoidable) = (Vec::new(), HashMap::new(), HashMap::new());
        Self { ctx, scorer, avoidance, avoidable, all, indices }
    }

    /// Scores the trajectories of an attack.
    pub(super) fn score(&mut self, attack: &Attack) -> Result<()> {
        for proposal in &attack.candidates {
            if let Entry::Vacant(entry) = self.indices.entry(bits(&proposal.trajectory)) {
                entry.insert(self.all.len());
                let scores = self.scorer.scores(&self.ctx.candidate(proposal.trajectory.clone()));
                let (json, trajectory) = (to_raw_value(&scores)?, to_raw_value(&proposal.trajectory)?);
                self.all.push(Scored { scores, json, trajectory });
            }
        }
        Ok(())
    }

    /// Whether a driver could have avoided a scored trajectory.
    pub(super) fn avoidable(&mut self, trajectory: &Trajectory) -> Result<Avoidable> {
        let index = self.index(trajectory)?;
        let (ctx, avoidance) = (self.ctx, self.avoidance);
        let search = || avoidance.of(&ctx.candidate(trajectory.clone()));
        Ok(self.avoidable.entry(index).or_insert_with(search).clone())
    }

    fn index(&self, trajectory: &Trajectory) -> Result<usize> {
        self.indices.get(&bits(trajectory)).copied().context("the trajectory is among the candidates")
    }

    /// Scores of a trajectory that [`ScoredCandidates::score`] has scored.
    pub(super) fn get(&self, trajectory: &Trajectory) -> Result<&Scored> {
        Ok(&self.all[self.index(trajectory)?])
    }

    /// The candidates of a scored attack.
    pub(super) fn rows(&self, attack: &Attack) -> Result<Vec<CandidateRow<'_>>> {
        let row = |proposal: &Proposal| {
            let Scored { json, trajectory, .. } = self.get(&proposal.trajectory)?;
            Ok(CandidateRow { log_prob: proposal.log_prob, goal: proposal.goal, trajectory, scores: json })
        };
        attack.candidates.iter().map(row).collect()
    }
}

fn bits(trajectory: &Trajectory) -> Vec<u64> {
    trajectory.points().as_flattened().iter().map(|x| x.to_bits()).collect()
}

/// The part of a row that is read back, to check whether it is complete and to print it again.
#[derive(Debug, Deserialize)]
pub(super) struct FoundRow {
    pub(super) run_hash: String,
    scene: String,
    variant: String,
    pub(super) source_hash: String,
    pub(super) files: Vec<String>,
    feasible: bool,
    note: Option<String>,
    scores: FoundScores,
}

#[derive(Debug, Deserialize)]
struct FoundScores {
    collision_step: Option<usize>,
    adversarial_reward: f64,
    kinematic_penalty: f64,
    behavior_penalty: f64,
    #[serde(default)]
    believable: Option<bool>,
    #[serde(default)]
    unbelievable: Vec<Reason>,
}

impl FoundRow {
    /// Reads a row; `None` if the file is missing or incomplete.
    pub(super) fn read(path: &Path) -> Option<Self> {
        serde_json::from_slice(&files::read(path, ROW_LIMIT).ok()?).ok()
    }

    /// The printed line.
    pub(super) fn line(&self) -> String {
        let Self { scene, variant, feasible, note, scores, .. } = self;
        line(
            [scene, variant],
            scores.collision_step,
            [scores.adversarial_reward, scores.kinematic_penalty, scores.behavior_penalty],
            [feasibility(*feasible), verdict(scores.believable, &scores.unbelievable), note.clone()],
            None,
        )
    }
}

impl VariantRow<'_> {
    /// The printed line; `seconds` is the time of the attack.
    pub(super) fn line(&self, seconds: f64) -> String {
        let Self { scene, variant, feasible, note, scores: ChosenScores { scores, .. }, .. } = self;
        line(
            [scene, variant],
            scores.collision_step,
            [scores.adversarial_reward, scores.kinematic_penalty, scores.behavior_penalty],
            [feasibility(*feasible), verdict(scores.believable, &scores.unbelievable), note.clone()],
            Some(seconds),
        )
    }
}

fn feasibility(is_feasible: bool) -> Option<String> {
    Some(if is_feasible { "feasible" } else { "not feasible" }.to_owned())
}

fn line(
    [scene, variant]: [&str; 2],
    collision_step: Option<usize>,
    [reward, kinematic, behavior]: [f64; 3],
    remarks: [Option<String>; 3],
    seconds: Option<f64>,
) -> String {
    let hit = collision_step
        .map_or("no contact".to_owned(), |step| format!("contact after {:.1} s", step as f64 / 10.0));
    format!(
        "{} {}: {hit}, R_adv {reward:.2}, P_kin {kinematic:.2}, P_beh {behavior:.2}, {} ({})",
        terminal::escaped_name(scene),
        terminal::escaped_name(variant),
        remarks.into_iter().flatten().collect::<Vec<_>>().join("; "),
        seconds.map_or("finished before".to_owned(), |s| format!("{:.0} ms", 1e3 * s)),
    )
}
