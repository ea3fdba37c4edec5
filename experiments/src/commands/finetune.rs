//! `sage finetune`: a realistic and an adversarial expert from a prior.

use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};
use rayon::prelude::*;
use sage_backbones::{
    Backbone,
    parameters::Header,
    training::{
        Expectation, FinetuneOptions, FinetuneRow, Kept, SceneData, TunedScene, finetune, other_roles,
    },
};
use sage_merging::ExpertFile;
use serde_json::json;

use crate::{
    Outcome, Registries,
    cli::FinetuneArgs,
    input, networks,
    output::{self, Run, State},
    progress,
    scenes::{self, Scenes},
};

/// Most scenes that are held encoded with all their goals, about 12 GB.
const MOST_PREPARED: usize = 8192;
/// What it leaves.
const RESULTS: [&str; 4] =
    [networks::PRIOR, "realistic.safetensors", "adversarial.safetensors", "finetune.csv"];
/// States of the experts, which are there only while they are tuned.
const STATES: [&str; 2] = ["realistic.state", "adversarial.state"];

/// The experts with their names and tastes, as a config file changes them.
fn experts(args: &FinetuneArgs) -> Result<[(&'static str, FinetuneOptions); 2]> {
    let options = |own: FinetuneOptions| -> Result<FinetuneOptions> {
        let options = match &args.config {
            Some(path) => configured(path, &own)?,
            None => own,
        };
        options.check()?;
        Ok(FinetuneOptions { seed: args.seed, ..options })
    };
    let (realistic, adversarial) = (FinetuneOptions::realistic(), FinetuneOptions::default());
    Ok([("realistic", options(realistic)?), ("adversarial", options(adversarial)?)])
}

pub(crate) fn run(args: &FinetuneArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let experts = experts(args)?;
    let loaded = networks::load(&registries.backbones, &args.prior)?;
    networks::announce(&loaded);
    let prior = &*loaded.network;
    let train = Scenes::of(&args.paths, &args.split, args.made, args.seed)?.hold()?;
    let dev = match &args.dev {
        Some(dev) => Scenes::under(std::slice::from_ref(dev))?.hold()?,
        None => Vec::new(),
    };
    let data = scenes::describe(&train);
    let identity = json!({
        "data": &data, "prior": prior.parameters().hash()?, "seed": args.seed, "roles": args.roles,
        "options": &experts, "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
    });
    // The dial of other experts would be taken for theirs.
    let outdated = [networks::DIAL_FILE];
    let (run, state) =
        Run::start(&args.folder.out, identity.clone(), args.folder.force, &STATES, &outdated, &RESULTS)?;
    if state == State::Done {
        return Ok(Outcome::Done);
    }
    let folder = run.folder();
    let train = with_other_roles(train, args.roles);
    let prepared = 2 * train.len() + dev.len();
    ensure!(
        prepared <= MOST_PREPARED,
        "{} pairs of ego and adversary, each in two mirror images, and {} to report on are {prepared}, and at most {MOST_PREPARED} are held in memory (1.5 MB each): take fewer scenes or a smaller --roles",
        train.len(),
        dev.len()
    );
    let (plain, dev) = (TunedScene::all(prior, &train, false)?, TunedScene::all(prior, &dev, false)?);
    let both = TunedScene::all(prior, &train, true)?;
    drop(train);
    progress::say(&format!(
        "every goal of {} casts (a scene with an ego and an adversary) is decoded and judged ({:.0} s)",
        plain.len(),
        clock.elapsed().as_secs_f64()
    ));
    let count = plain.len();
    let all: Vec<TunedScene> = plain.into_iter().chain(both).collect();
    let mut table = "expert,epoch,loss,margin,accuracy,pairs,pairs_by_feasibility,feasible,best_reward,kl,without_pairs,expected_feasible,expected_attack,expected_reward,expected_penalty,seconds\n".to_owned();
    let mut results = Vec::new();
    for (name, options) in &experts {
        let train = if options.mirror { &all[..] } else { &all[..count] };
        let state = folder.path().join(format!("{name}.state"));
        let identity = json!({"run": &identity, "expert": name});
        let kept = Kept { file: &state, identity };
        let weights = finetune(prior, train, options, Some(&kept), |row| {
            progress::say(&told(name, row));
            table += &csv(name, row);
        })?;
        let mut header = Header {
            backbone: prior.name().to_owned(),
            options: prior.options().clone(),
            seed: args.seed,
            data: data.clone(),
            command: output::command(),
            license: loaded.header.license.clone(),
            ..Header::default()
        };
        header.notes.insert(ExpertFile::EXPERT.to_owned(), (*name).to_owned());
        header.notes.insert(ExpertFile::PRIOR.to_owned(), prior.parameters().hash()?);
        header.notes.insert("options".to_owned(), serde_json::to_string(options)?);
        weights.save(&header, &folder.path().join(format!("{name}.safetensors")))?;
        let tuned = prior.rebuilt(weights)?;
        for (set, scenes) in [("train", &all[..count]), ("dev", &dev[..])] {
            if let Some([before, after]) = expectations(prior, &*tuned, scenes)? {
                progress::say(&format!(
                    "{name} on {set} ({} casts), prior → expert: feasible {:.2} → {:.2}, feasible hits {:.3} → {:.3}, R_adv {:.2} → {:.2}, P_real {:.2} → {:.2}",
                    scenes.len(),
                    before.feasible,
                    after.feasible,
                    before.attack,
                    after.attack,
                    before.reward,
                    after.reward,
                    before.penalty,
                    after.penalty,
                ));
                results.push(json!({"expert": name, "set": set, "casts": scenes.len(), "prior": before, "tuned": after}));
            }
        }
        results.push(json!({"expert": name, "options": options}));
    }
    loaded.network.parameters().save(&loaded.header, &folder.path().join(networks::PRIOR))?;
    folder.write("finetune.csv", table.as_bytes())?;
    run.finish(&json!({"experts": results}), clock.elapsed().as_secs_f64())?;
    progress::say(&format!(
        "prior and experts are in `{}` ({:.0} s)",
        args.folder.out.display(),
        clock.elapsed().as_secs_f64()
    ));
    Ok(Outcome::Done)
}

/// Options from a file over an expert's own: keys left out keep theirs.
fn configured(path: &std::path::Path, own: &FinetuneOptions) -> Result<FinetuneOptions> {
    let text = input::read_config(path)?;
    let fail = || format!("`{}`", path.display());
    let given: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&text).with_context(fail)?;
    if given.contains_key("seed") {
        bail!("`{}`: `seed` is given by --seed", path.display());
    }
    let mut all = serde_json::to_value(own)?;
    if let Some(all) = all.as_object_mut() {
        all.extend(given);
    }
    serde_json::from_value(all).with_context(fail)
}

/// Beside each scene the same with so many other pairs of ego and adversary.
fn with_other_roles(scenes: Vec<SceneData>, most: usize) -> Vec<SceneData> {
    let beside = |data: &SceneData| -> Vec<SceneData> {
        let roles = other_roles(&data.scene, most).into_iter().enumerate();
        roles.map(|(k, scene)| SceneData::new(format!("{} roles {}", data.name, k + 1), scene)).collect()
    };
    let others: Vec<Vec<SceneData>> = scenes.par_iter().map(beside).collect();
    scenes.into_iter().chain(others.into_iter().flatten()).collect()
}

/// Mean expectations of the prior and of an expert.
fn expectations(
    prior: &dyn Backbone,
    tuned: &dyn Backbone,
    scenes: &[TunedScene],
) -> Result<Option<[Expectation; 2]>> {
    if scenes.is_empty() {
        return Ok(None);
    }
    let mean = |policy: &dyn Backbone| -> Result<Expectation> {
        let all: Vec<_> = scenes.par_iter().with_max_len(1).map(|scene| scene.expectation(policy)).collect();
        Expectation::mean(&all.into_iter().collect::<Result<Vec<_>, _>>()?).context("no scene")
    };
    Ok(Some([mean(prior)?, mean(tuned)?]))
}

fn told(name: &str, r: &FinetuneRow) -> String {
    let mut line = format!(
        "{name} epoch {}: loss {:.4}, pairs {:.1} ({:.1} by feasibility), right {:.2}, feasible {:.2}, best R_adv {:.2}, KL {:.2}",
        r.epoch, r.loss, r.pairs, r.pairs_by_feasibility, r.accuracy, r.feasible, r.best_reward, r.kl
    );
    if r.without_pairs > 0.2 {
        line += &format!("; warning: {:.0} % of the scenes gave no pair", 100.0 * r.without_pairs);
    }
    line
}

fn csv(name: &str, r: &FinetuneRow) -> String {
    format!(
        "{name},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{:.2}\n",
        r.epoch,
        r.loss,
        r.margin,
        r.accuracy,
        r.pairs,
        r.pairs_by_feasibility,
        r.feasible,
        r.best_reward,
        r.kl,
        r.without_pairs,
        r.expected_feasible,
        r.expected_attack,
        r.expected_reward,
        r.expected_penalty,
        r.seconds
    )
}
