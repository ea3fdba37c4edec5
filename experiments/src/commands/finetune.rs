//! `sage finetune`: tunes experts from a prior: a realistic, an adversarial and a lawful one, unless a config
//! names others.

mod curves;
mod options;

use std::{sync::Arc, time::Instant};

use advsage::{Registries, weights::NamedNetwork};
use anyhow::{Context as _, Result, ensure};
use rayon::prelude::*;
use sage_backbones::{
    Backbone, MotionModel,
    features::EdgeKinds,
    parameters::Header,
    training::{CheckpointFile, Expectation, FinetuneRow, Measures, PreparedScene, Tunes, finetune},
    weights::PRIOR_FILE,
};
use sage_bench::csv_text::of_table;
use sage_core::{objective::Objective, scene::SceneData, text::table::Table};
use sage_generators::DIAL_FILE;
use sage_merging::{ExpertFile, ExpertSet};
use sage_run::{
    Outcome, networks,
    output::{self, Run, RunState},
    progress,
    scenes::{self, Scenes},
};
use serde_json::{Map, Value, json};

use crate::cli::FinetuneArgs;
use options::{EDGES, Expert, RunOptions};

/// Maximum number of prepared scenes in memory, about 12 GB.
const MOST_PREPARED: usize = 8192;

/// The prior with some edges in its features. A network without this option keeps its features, also with the shipped
/// variants; other edges that are asked for are an error.
fn with_edges(
    loaded: NamedNetwork,
    run_options: &RunOptions,
    registries: &Registries,
) -> Result<NamedNetwork> {
    let NamedNetwork { network, mut header, name, note } = loaded;
    let mut options = network.options().clone();
    let Some(edges) = options.get_mut(EDGES) else {
        ensure!(
            run_options.edges.is_none() || run_options.edges_are_shipped,
            "the network `{}` has no option `edges`; omit --edges and `edges`",
            network.name()
        );
        return Ok(NamedNetwork { network, header, name, note });
    };
    *edges = serde_json::to_value(run_options.edges.unwrap_or(EdgeKinds::All))?;
    let changed = registries.backbones.build(network.name(), &options)?;
    let network = changed.with_parameters(network.parameters().clone())?;
    header.options = options;
    Ok(NamedNetwork { network, header, name, note })
}

pub(crate) fn run(args: &FinetuneArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let run_options = RunOptions::of(args, registries)?;
    let RunOptions { experts, roles, .. } = &run_options;
    let objectives: Vec<&Objective> = experts.iter().map(|expert| &expert.objective).collect();
    let measures = Measures::of(&objectives, &registries.rewards, &registries.feasibilities);
    let measures = measures.context("the experts of one run")?;
    let states: Vec<String> = experts.iter().map(|expert| format!("{}.state", expert.name)).collect();
    let mut results: Vec<String> =
        experts.iter().map(|expert| format!("{}.safetensors", expert.name)).collect();
    results.extend([PRIOR_FILE.to_owned(), "finetune.csv".to_owned()]);
    let loaded = with_edges(networks::load(&registries.backbones, &args.prior)?, &run_options, registries)?;
    networks::announce(&loaded);
    let shared: Arc<dyn Backbone> = loaded.network.into();
    let prior = &*shared;
    let training = Scenes::of(&args.paths, &args.split.filter(), args.procedural, args.seed)?;
    let validation = args.dev.as_ref().map(|dev| Scenes::under(std::slice::from_ref(dev))).transpose()?;
    let train = training.read_all()?;
    let dev = validation.as_ref().map(Scenes::read_all).transpose()?.unwrap_or_default();
    let failed = training.failed() + validation.as_ref().map_or(0, Scenes::failed);
    let data = scenes::describe(&train);
    let options: Map<String, Value> = experts
        .iter()
        .map(|expert| Ok((expert.name.clone(), serde_json::to_value(&expert.options)?)))
        .collect::<Result<_>>()?;
    let mut identity = json!({
        "data": &data, "prior": prior.parameters().hash()?, "network": prior.options(), "seed": args.seed, "roles": roles,
        "options": options, "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
    });
    let contents: Vec<String> = objectives.iter().flat_map(|objective| objective.contents()).collect();
    if !contents.is_empty() {
        identity["contents"] = json!(contents);
    }
    // A dial of other experts must not be used for these.
    let outdated = [DIAL_FILE];
    let (run, state) = Run::start(
        &args.folder.out,
        identity.clone(),
        args.folder.force,
        &states.iter().map(String::as_str).collect::<Vec<_>>(),
        &outdated,
        &results.iter().map(String::as_str).collect::<Vec<_>>(),
    )?;
    if state == RunState::Done {
        return Ok(Outcome::Done);
    }
    let folder = run.folder();
    let train = scenes::with_other_roles(train, *roles);
    let is_mirrored = experts.iter().any(|expert| expert.options.mirror);
    let images = if is_mirrored { 2 } else { 1 };
    let prepared = images * train.len() + dev.len();
    ensure!(
        prepared <= MOST_PREPARED,
        "{} role assignments ({images} mirror images of each) and {} scenes of --dev make {prepared} prepared scenes; at most {MOST_PREPARED} are held in memory (1.5 MB each): use fewer scenes or a smaller --roles",
        train.len(),
        dev.len()
    );
    let all = |scenes: &[SceneData], mirrored: bool| {
        PreparedScene::all(prior, scenes, mirrored, &measures, |data, defect| {
            training.fail(&data.name, &defect.into());
        })
    };
    let (plain, dev) = (all(&train, false)?, all(&dev, false)?);
    let mirrored = if is_mirrored { all(&train, true)? } else { Vec::new() };
    drop(train);
    progress::say(&format!(
        "decoded and evaluated every goal of {} role assignments (a scene with an ego and an adversary) ({:.0} s)",
        plain.len(),
        clock.elapsed().as_secs_f64()
    ));
    let count = plain.len();
    let all: Vec<PreparedScene> = plain.into_iter().chain(mirrored).collect();
    let mut table = Table::new("", &HEADS);
    let mut reports = Vec::new();
    for Expert { name, options, objective } in experts {
        let train = if options.mirror { &all[..] } else { &all[..count] };
        let state = folder.path().join(format!("{name}.state"));
        let identity = json!({"run": &identity, "expert": name});
        let checkpoint = CheckpointFile { file: &state, identity, header: Header::default() };
        let weights = finetune(prior, train, &measures, objective, options, Some(&checkpoint), |row| {
            progress::say(&epoch_message(name, row));
            table.row(name, cells(row));
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
        header.notes.insert(ExpertFile::EXPERT.to_owned(), name.clone());
        header.notes.insert(ExpertFile::PRIOR.to_owned(), prior.parameters().hash()?);
        header.notes.insert("options".to_owned(), serde_json::to_string(options)?);
        if options.tunes == Tunes::All {
            header.notes.insert(ExpertFile::TUNES.to_owned(), "all".to_owned());
        }
        let content = ExpertFile::content(prior, &weights, options.tunes);
        content.save(&header, &folder.path().join(format!("{name}.safetensors")))?;
        let set = ExpertSet::tuned(shared.clone(), vec![(name.clone(), weights.clone())], options.tunes)?;
        let tuned = set.model(weights)?;
        for (set, scenes) in [("train", &all[..count]), ("dev", &dev[..])] {
            if let Some([before, after]) = expectations(prior, &*tuned, scenes)? {
                progress::say(&format!(
                    "{name} on {set} ({} role assignments), prior → expert: feasible {:.2} → {:.2}, feasible hits {:.3} → {:.3}, believable {:.3} → {:.3}, R_adv {:.2} → {:.2}, P_real {:.2} → {:.2}",
                    scenes.len(),
                    before.feasible,
                    after.feasible,
                    before.attack,
                    after.attack,
                    before.believable,
                    after.believable,
                    before.reward,
                    after.reward,
                    before.penalty,
                    after.penalty,
                ));
                reports.push(json!({"expert": name, "set": set, "role_assignments": scenes.len(), "prior": before, "tuned": after}));
            }
        }
        reports.push(json!({"expert": name, "options": options}));
    }
    prior.parameters().save(&loaded.header, &folder.path().join(PRIOR_FILE))?;
    folder.write("finetune.csv", of_table(&table).as_bytes())?;
    if args.variants.is_some() {
        for (file, svg) in curves::draw(&table)? {
            folder.write(file, svg.as_bytes())?;
        }
    }
    run.finish(&json!({"experts": reports}), clock.elapsed().as_secs_f64())?;
    progress::say(&format!(
        "prior and experts are in `{}` ({:.0} s)",
        args.folder.out.display(),
        clock.elapsed().as_secs_f64()
    ));
    Ok(scenes::outcome_without(failed))
}

/// Mean expectations of the prior and of an expert.
fn expectations(
    prior: &dyn Backbone,
    tuned: &dyn MotionModel,
    scenes: &[PreparedScene],
) -> Result<Option<[Expectation; 2]>> {
    if scenes.is_empty() {
        return Ok(None);
    }
    let mean = |policy: &dyn MotionModel| -> Result<Expectation> {
        let all: Vec<_> = scenes.par_iter().with_max_len(1).map(|scene| scene.expectation(policy)).collect();
        Expectation::mean(&all.into_iter().collect::<Result<Vec<_>, _>>()?).context("no scene")
    };
    Ok(Some([mean(prior)?, mean(tuned)?]))
}

fn epoch_message(name: &str, r: &FinetuneRow) -> String {
    let mut line = format!(
        "{name} epoch {}: loss {:.4}, pairs {:.1} ({:.1} by feasibility), accuracy {:.2}, feasible {:.2}, best R_adv {:.2}, KL {:.2}",
        r.epoch, r.loss, r.pairs, r.pairs_by_feasibility, r.accuracy, r.feasible, r.best_reward, r.kl
    );
    if r.without_pairs > 0.2 {
        line += &format!("; warning: {:.0} % of the scenes gave no pair", 100.0 * r.without_pairs);
    }
    line
}

/// Columns of `finetune.csv`.
const HEADS: [&str; 17] = [
    "expert",
    "epoch",
    "loss",
    "margin",
    "accuracy",
    "pairs",
    "pairs_by_feasibility",
    "feasible",
    "best_reward",
    "kl",
    "without_pairs",
    "expected_feasible",
    "expected_attack",
    "expected_believable",
    "expected_reward",
    "expected_penalty",
    "seconds",
];

fn cells(r: &FinetuneRow) -> impl Iterator<Item = String> {
    let numbers = [
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
        r.expected_believable,
        r.expected_reward,
        r.expected_penalty,
    ];
    let numbers = numbers.map(|x| x.to_string());
    std::iter::once(r.epoch.to_string()).chain(numbers).chain([format!("{:.2}", r.seconds)])
}
