//! The scenes of a training and of its evaluation.

use std::{
    collections::{BTreeSet, HashMap},
    path::PathBuf,
    sync::Arc,
};

use anyhow::{Context as _, Result, bail};
use sage_core::scene::{SceneData, SceneIndex};
use sage_run::{
    progress,
    scenes::{Scenes, describe, with_other_egos},
};
use sage_sim::SimScene;

use super::{attacks::Attacks, chosen::Chosen};
use crate::cli::{EgosName, SplitArgs, TrainEgoArgs};

/// Procedural scenes of the evaluation have this seed, those of the training have 0.
const EVALUATION_SEED: u64 = 1;

pub(super) struct DrivenScenes {
    pub(super) training: Vec<Arc<SimScene>>,
    pub(super) evaluation: Vec<Arc<SimScene>>,
    /// Names of the scenes of the evaluation.
    pub(super) names: Vec<String>,
    /// Where the procedural scenes begin beside others, and their share.
    pub(super) second_kind: Option<(usize, f64)>,
    /// Descriptions of the scenes of the training and of the evaluation.
    pub(super) described: [String; 2],
    /// Number of scenes that could not be used.
    pub(super) failed: usize,
}

impl DrivenScenes {
    /// *Errors*: no scene is left; a scene of the evaluation is among those of the training.
    pub(super) fn of(args: &TrainEgoArgs, chosen: &Chosen, attacks: &Attacks) -> Result<Self> {
        let needs_adversary = attacks.need_adversary();
        let (mut training, mut failed) =
            driveable(&args.paths, &args.split, args.procedural, 0, needs_adversary)?;
        if chosen.egos == EgosName::All {
            training = with_other_egos(training, attacks.attacker.is_some());
        }
        let every = SplitArgs { reading: args.split.reading.clone(), ..SplitArgs::default() };
        let mut second_kind = None;
        if let Some(share) = chosen.procedural_share {
            second_kind = Some((training.len(), share));
            let (procedural, without) = driveable(&[], &every, args.procedural, 0, needs_adversary)?;
            training.extend(procedural);
            failed += without;
        }
        if chosen.egos == EgosName::All || second_kind.is_some() {
            progress::say(&format!("training in {} scenes, each with one ego", training.len()));
        }
        let (evaluation, without) =
            driveable(&args.eval, &every, args.procedural.div_ceil(3), EVALUATION_SEED, needs_adversary)?;
        refuse_overlap(args, &training, &evaluation)?;
        Ok(Self {
            described: [describe(&training), describe(&evaluation)],
            names: evaluation.iter().map(|data| data.name.clone()).collect(),
            training: simulated(&training)?,
            evaluation: simulated(&evaluation)?,
            second_kind,
            failed: failed + without,
        })
    }
}

/// Scenes that can be driven, and how many failed.
fn driveable(
    paths: &[PathBuf],
    split: &SplitArgs,
    procedural: u64,
    seed: u64,
    needs_adversary: bool,
) -> Result<(Vec<SceneData>, usize)> {
    let all = Scenes::of(paths, &split.filter(), procedural, seed)?;
    let all = if needs_adversary { all.attackable()? } else { all.only_readable()? };
    let mut loaded = all.read_all()?;
    loaded.retain(|data| match SimScene::new(data.scene.clone(), data.index.clone()) {
        Ok(_) => true,
        Err(error) => {
            all.fail(&data.name, &error);
            false
        }
    });
    if loaded.is_empty() {
        bail!("no scenes are left; give more paths or other filters");
    }
    Ok((loaded, all.failure_count()))
}

fn refuse_overlap(args: &TrainEgoArgs, training: &[SceneData], evaluation: &[SceneData]) -> Result<()> {
    let seen: BTreeSet<[u8; 16]> = training.iter().map(|data| data.scene.content_hash()).collect();
    let both: Vec<&str> = evaluation
        .iter()
        .filter(|data| seen.contains(&data.scene.content_hash()))
        .map(|data| &*data.name)
        .collect();
    if let Some(first) = both.first()
        && !args.allow_overlap
    {
        bail!(
            "{} of {} scenes of the evaluation are among those of the training, such as `{first}`; give others with --eval, or --allow-overlap",
            both.len(),
            evaluation.len()
        );
    }
    Ok(())
}

fn simulated(data: &[SceneData]) -> Result<Vec<Arc<SimScene>>> {
    let mut on_map: HashMap<*const SceneIndex, Arc<SimScene>> = HashMap::new();
    data.iter()
        .map(|data| {
            let known = on_map.get(&Arc::as_ptr(&data.index));
            let made = match known {
                Some(known) => known.on_same_map(data.scene.clone()),
                None => SimScene::new(data.scene.clone(), data.index.clone()),
            };
            let scene = made.with_context(|| format!("`{}`", data.name))?;
            on_map.entry(Arc::as_ptr(&data.index)).or_insert_with(|| scene.clone());
            Ok(scene)
        })
        .collect()
}
