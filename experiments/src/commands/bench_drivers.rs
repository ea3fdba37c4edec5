//! `sage bench drivers`: drivers in unchanged scenes and under attack, paired by scene.

use std::sync::Arc;

use anyhow::{Result, anyhow, bail};
use sage_core::scene::SceneData;
use sage_merging::Merger;
use sage_sim::SimScene;
use serde_json::json;

use crate::{
    Outcome, Registries,
    bench::{
        tested_drivers::{Attackers, TestedDriver, test},
        tested_drivers_report::{self as report, DriverRows},
    },
    cli::DriversArgs,
    ego::Ego,
    generators::{self, BuiltGenerator},
    networks,
    operating_point::RowKey,
    output::{self, Folder},
    part::{Parts, PolicyParts},
    progress::{self, Progress},
    scenes::Scenes,
    selection::Selection,
};

pub(crate) fn run(args: &DriversArgs, registries: &Registries) -> Result<Outcome> {
    let PolicyParts(parts) = &args.policies;
    let egos = Ego::all(parts, registries)?;
    let selection = Selection::of(registries, &args.selection, args.rule.feasibility.as_ref())?;
    let generators = if args.unattacked { Vec::new() } else { generators(args, registries, &selection)? };
    let keys: Vec<RowKey> = generators.iter().flat_map(|built| built.keys.clone()).collect();
    generators::refuse_duplicates(&keys)?;
    let attackers = Attackers {
        generators: &generators,
        objective: &selection.objective,
        search: args.avoidable.options().unwrap_or_default(),
        seed: args.seed,
    };
    let attackers = (!generators.is_empty()).then_some(&attackers);
    let out = Folder::make(&args.folder.out, args.folder.force)?;
    let scenes = Scenes::of(&args.paths, &args.split, args.procedural, args.seed)?.known()?;
    let one = |data: &SceneData| -> Result<Vec<Result<TestedDriver>>> {
        let scene = SimScene::new(data.scene.clone(), data.index.clone())?;
        Ok(egos.iter().map(|ego| test(data, &scene, ego, attackers, args.seed)).collect())
    };
    let mut progress = Progress::new("driven", scenes.len());
    let tested = scenes.map(|data| Ok((data.name.clone(), one(data)?)), || progress.step())?;
    progress.finish(&format!(
        "{} in {}",
        progress::count(egos.len(), "driver"),
        progress::count(tested.len(), "scene")
    ));
    let mut drivers: Vec<DriverRows> = egos
        .iter()
        .map(|ego| {
            let (name, stream) = (ego.label.clone(), ego.stream.clone());
            DriverRows { name, stream, knows: ego.policy.privilege(), scenes: Vec::new() }
        })
        .collect();
    let mut failed = scenes.failed();
    for (name, tested) in tested {
        let mut fail = |who: &str, error: &anyhow::Error| {
            failed += 1;
            progress::say(&format!("error: {who}: `{name}`: {error:#}"));
        };
        for (driver, row) in drivers.iter_mut().zip(tested) {
            match row {
                Ok(row) => {
                    match &row.failed {
                        Some((true, reason)) => {
                            progress::say(&format!(
                                "left out: attacks on {}: `{name}`: {reason}",
                                driver.name
                            ));
                        }
                        Some((false, problem)) => {
                            fail(&format!("attacks on {}", driver.name), &anyhow!("{problem}"));
                        }
                        None => {}
                    }
                    driver.scenes.push(row);
                }
                Err(error) => fail(&driver.name, &error),
            }
        }
    }
    if drivers.iter().all(|driver| driver.scenes.is_empty()) {
        bail!("no scene could be driven");
    }
    let markdown = report::markdown(&drivers, &keys, args.seed)? + &scenes.warnings_as_markdown();
    out.write("drivers.md", markdown.as_bytes())?;
    out.write("scenes.csv", report::unattacked_csv(&drivers)?.as_bytes())?;
    out.write("attacks.csv", report::attacks_csv(&drivers, &keys)?.as_bytes())?;
    let record = json!({
        "command": output::command(), "policies": egos.iter().map(|ego| &ego.label).collect::<Vec<_>>(),
        "generators": keys.iter().map(RowKey::label).collect::<Vec<_>>(), "scenes": scenes.describe(),
        "failed": failed, "seed": args.seed, "version": env!("CARGO_PKG_VERSION"),
    });
    out.write("run.json", format!("{record:#}\n").as_bytes())?;
    output::print(&markdown)?;
    progress::say(&format!(
        "drivers.md, scenes.csv, attacks.csv and run.json are in `{}`",
        args.folder.out.display()
    ));
    Ok(if failed > 0 { Outcome::Partial } else { Outcome::Done })
}

fn generators(
    args: &DriversArgs,
    registries: &Registries,
    selection: &Selection,
) -> Result<Vec<BuiltGenerator>> {
    let merger: Arc<dyn Merger> = args.points.merging.merger.build(&registries.mergers)?.into();
    args.points.check(merger.range())?;
    let experts = networks::load_experts(&registries.backbones, &args.weights)?;
    let merger_name = args.points.merging.merger.to_string();
    let dial = || networks::load_dial(&args.weights, &experts, selection, &merger_name);
    let points = args.points.specs(dial, merger.range(), &[1.0])?;
    let inputs = generators::inputs(Some(&experts), &merger, selection, args.seed);
    let Parts(methods) = &args.methods;
    methods.iter().map(|part| BuiltGenerator::new(part, registries, &inputs, &points)).collect()
}
