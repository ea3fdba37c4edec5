//! The run of one seed: resumes from its checkpoint, trains, saves, writes its results.

use std::path::Path;

use anyhow::{Context as _, Result, anyhow};
use sage_learn::{
    Algorithm, CHECKPOINT, Evaluation, KEPT_ACTORS, Setting, Training, TrainingOptions, TrainingState,
};
use sage_run::{output::Run, progress};
use sage_sim::actor::{PolicyCard, write_policy};
use serde_json::json;

use super::{
    Shared,
    report::{self, Trained},
};

/// Name of a seed's folder.
pub(super) fn folder(seed: u64) -> String {
    format!("seed-{seed}")
}

/// Trains one seed to its end.
///
/// *Errors*: the run breaks off ([`sage_learn::Stop`]), or a file cannot be written.
pub(super) fn train(shared: &Shared, run: &Run, seed: u64, clock: &report::Clock) -> Result<Trained> {
    let options = TrainingOptions { seed, ..shared.chosen.options.clone() };
    let scenes = &shared.scenes;
    let path = run.folder().inner(folder(seed).as_ref())?;
    let identity = format!("{} seed {seed}", shared.identity()?);
    let loaded = TrainingState::load(&path, &identity, &options, scenes.training.len());
    let loaded = loaded?;
    let resumed = loaded.is_some();
    let state = match loaded {
        Some(loaded) => loaded,
        None => TrainingState::new(&options, scenes.training.len())?,
    };
    let curriculum = shared.args.curriculum.build(&shared.registries.parts.curricula)?;
    let sampler = shared.args.sampler.build(&shared.registries.parts.scene_samplers)?;
    let setting = Setting {
        scenes: &scenes.training,
        evaluation: &scenes.evaluation,
        attacker: shared.attacks.attacker.as_deref(),
        examiner: shared.attacks.examiner.as_ref().map(|adversary| adversary as _),
        curriculum: &*curriculum,
        sampler: &*sampler,
        teacher: shared.teacher.as_deref(),
        second_kind: scenes.second_kind,
    };
    let total = options.steps();
    let random = if options.algorithm == Algorithm::Td3 { options.td3.random_steps } else { 0 };
    let mut training = Training::new(options, setting, state);
    if resumed {
        clock.resumed(seed, training.state().counters().steps);
    }
    while !training.is_done() {
        let until = training.state().counters().steps + shared.checkpoint_every;
        let before = training.state().evaluations().len();
        training.advance(until.min(total), |done| clock.step(done > random)).map_err(|stop| {
            let remedy = "the same command goes on from it, other options need another --out";
            anyhow!("{stop}{}", last_good(&path).map_or(String::new(), |last| format!("{last}: {remedy}")))
        })?;
        let state = training.state();
        if let Some(tensor) = state.learner().not_finite() {
            return Err(anyhow!(
                "step {}: tensor `{tensor}` is not finite{}",
                state.counters().steps,
                last_good(&path).unwrap_or_default()
            ));
        }
        training.save(&path, &identity).with_context(|| format!("cannot write to `{}`", path.display()))?;
        for evaluation in &training.state().evaluations()[before..] {
            clock.evaluated(&shared.columns, seed, evaluation, total);
        }
    }
    let state = training.state();
    let trained = Trained {
        seed,
        evaluations: state.evaluations().to_vec(),
        losses: state.loss_curve().to_vec(),
        counters: state.counters().clone(),
        updates: state.learner().updates(),
    };
    write_policies(shared, run, &trained)?;
    if let Some(first) = trained.counters.skipped_because.first() {
        let skipped = trained.counters.skipped;
        progress::say(&format!(
            "warning: seed {seed}: {skipped} episodes could not start or go on (`skipped_because` in run.json); one of them: {first}"
        ));
    }
    Ok(trained)
}

/// Where the last checkpoint is, if there is one, as the rest of a sentence.
fn last_good(folder: &Path) -> Option<String> {
    let checkpoint = folder.join(CHECKPOINT);
    checkpoint.exists().then(|| format!("; the last good checkpoint is `{}`", checkpoint.display()))
}

/// Writes the final policy, those of the last evaluations, and the tables of the seed.
fn write_policies(shared: &Shared, run: &Run, trained: &Trained) -> Result<()> {
    let name = folder(trained.seed);
    let write = |file: &str, evaluation: &Evaluation| -> Result<()> {
        let Some(actor) = &evaluation.actor else { return Ok(()) };
        let card = card(shared, trained, evaluation);
        let path = run.folder().inner(name.as_ref())?.join(file);
        write_policy(&path, actor, &card).with_context(|| format!("cannot write `{}`", path.display()))
    };
    for evaluation in trained.evaluations.iter().rev().take(KEPT_ACTORS) {
        write(&format!("policy-{}.safetensors", evaluation.step), evaluation)?;
    }
    if let Some(last) = trained.evaluations.last() {
        write("policy.safetensors", last)?;
        let card = report::card_page(&shared.columns, &card(shared, trained, last));
        run.folder().write(&format!("{name}/README.md"), card.as_bytes())?;
    }
    run.folder().write(
        &format!("{name}/evaluations.csv"),
        report::curve_csv(&shared.columns, std::slice::from_ref(trained)).as_bytes(),
    )?;
    Ok(run.folder().write(
        &format!("{name}/episodes.csv"),
        report::episodes_csv(&shared.columns, trained, &shared.scenes.names).as_bytes(),
    )?)
}

fn card(shared: &Shared, trained: &Trained, evaluation: &Evaluation) -> PolicyCard {
    let Shared { args, scenes, .. } = shared;
    let options = TrainingOptions { seed: trained.seed, ..shared.chosen.options.clone() };
    let mut training = json!({
        "algorithm": report::algorithm(&options), "generator": args.method.to_string(), "curriculum": args.curriculum.to_string(),
        "sampler": args.sampler.to_string(), "weights": shared.attacks.weights_of_attacker(),
        "seed": trained.seed, "updates": evaluation.updates, "steps": evaluation.step,
        "scenes": scenes.described[0], "egos": shared.chosen.egos.name(),
        "procedural_scenes": scenes.second_kind.map(|(_, share)| json!({"scenes": args.procedural, "share": share})),
        "reward": options.reward.to_string(), "options": options,
    });
    if let Some(teacher) = shared.taught_by() {
        training["teacher"] = teacher.into();
    }
    if let Some(drives) = args.search {
        training["search"] = drives.into();
    }
    let measured = json!({
        "scenes": scenes.described[1], "attacks": args.eval_method.to_string(),
        "unchanged": report::means(&shared.columns, &evaluation.unchanged),
        "attacked": report::means(&shared.columns, &evaluation.attacked),
    });
    let card = PolicyCard::new(options.observation(), training, measured, shared.license());
    PolicyCard { kept: options.kept_share(), ..card }
}
