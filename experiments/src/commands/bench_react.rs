//! `sage bench react`: how well the time to react can be chosen among the candidates of generators.

use std::{fmt::Write as _, sync::Arc};

use anyhow::Result;
use sage_core::{
    objective::{Context, ContextOptions},
    scene::SceneData,
    statistics,
};
use sage_merging::Merger;
use sage_sim::avoidable::Avoidance;
use serde_json::json;

use crate::{
    Outcome, Registries,
    cli::ReactArgs,
    generators::{self, BuiltGenerator},
    networks,
    output::{self, Folder},
    part::Parts,
    progress::{self, Progress},
    react::{self, WITHIN},
    scenes::Scenes,
    selection::Selection,
};

/// For each row of the table and each target, the time to react of the choice.
type OfScene = Vec<Vec<Option<f64>>>;

pub(crate) fn run(args: &ReactArgs, registries: &Registries) -> Result<Outcome> {
    let selection = Selection::of(registries, &args.on.selection, args.on.rule.feasibility.as_ref())?;
    let merger: Arc<dyn Merger> = args.points.merging.merger.build(&registries.mergers)?.into();
    args.points.check(merger.range())?;
    let experts = networks::load_experts(&registries.backbones, &args.on.weights)?;
    let merger_name = args.points.merging.merger.to_string();
    let dial = || networks::load_dial(&args.on.weights, &experts, &selection, &merger_name);
    let points = args.points.specs(dial, merger.range(), &[1.0])?;
    let inputs = generators::inputs(Some(&experts), &merger, &selection, args.on.seed);
    let Parts(methods) = &args.methods;
    let built = methods.iter().map(|part| BuiltGenerator::new(part, registries, &inputs, &points));
    let built = built.collect::<Result<Vec<_>>>()?;
    let labels: Vec<String> =
        built.iter().flat_map(|built| built.keys.iter().map(|key| key.label())).collect();
    let options = args.avoidable.options().unwrap_or_default();
    let out = Folder::make(&args.on.folder.out, args.on.folder.force)?;
    let scenes = Scenes::of(&args.on.paths, &args.on.split, 0, args.on.seed)?.attackable()?;
    let one = |data: &SceneData| -> Result<OfScene> {
        let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
        let avoidance = Avoidance::new(&ctx, options)?;
        let mut rows = Vec::with_capacity(labels.len());
        for built in &built {
            let attacks = built.generator.attacks(&ctx, &built.points, args.on.seed)?;
            for (attack, point) in attacks.iter().zip(&built.points) {
                let avoided = react::avoided(attack, &ctx, &selection.objective, point.mu, &avoidance);
                let time = |target: &f64| react::chosen(&avoided, *target).map(|one| one.time);
                rows.push(args.targets.iter().map(time).collect());
            }
        }
        Ok(rows)
    };
    let mut progress = Progress::new("searched", scenes.len());
    let all = scenes.map(one, || progress.step())?;
    progress.finish(&format!("{} on {} scenes", progress::count(labels.len(), "generator"), all.len()));
    let (markdown, csv) = table(&labels, &args.targets, &all)?;
    out.write("table.md", markdown.as_bytes())?;
    out.write("table.csv", csv.as_bytes())?;
    let record = json!({
        "command": output::command(), "weights": args.on.weights, "selection": selection.objective.spec(),
        "seed": args.on.seed, "search": options, "scenes": scenes.describe(), "version": env!("CARGO_PKG_VERSION"),
    });
    out.write("run.json", format!("{record:#}\n").as_bytes())?;
    output::print(&markdown)?;
    progress::say(&format!("table.md, table.csv and run.json are in `{}`", args.on.folder.out.display()));
    Ok(scenes.outcome())
}

fn table(labels: &[String], targets: &[f64], all: &[OfScene]) -> Result<(String, String)> {
    let mut markdown = format!(
        "Time to react, chosen among the candidates of each generator, on {} scenes.\n\n\
         | generator | target s | scenes within {WITHIN} s, % | median of these, s | median of all choices, s | scenes with a choice, % |\n\
         | --- | --- | --- | --- | --- | --- |\n",
        all.len()
    );
    let mut csv = "generator,target,scene,time_to_react\n".to_owned();
    for (row, label) in labels.iter().enumerate() {
        for (k, target) in targets.iter().enumerate() {
            let times: Vec<f64> = all.iter().filter_map(|scene| scene[row][k]).collect();
            let within: Vec<f64> =
                times.iter().copied().filter(|time| (time - target).abs() <= WITHIN + 1e-9).collect();
            let share = |count: usize| {
                let share = statistics::wilson(count, all.len());
                share.map_or("-".to_owned(), |e| {
                    format!("{:.0} [{:.0}, {:.0}]", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high)
                })
            };
            let median =
                |times: &[f64]| statistics::median(times).map_or("-".to_owned(), |time| format!("{time:.2}"));
            writeln!(
                markdown,
                "| {label} | {target} | {} | {} | {} | {} |",
                share(within.len()),
                median(&within),
                median(&times),
                share(times.len()),
            )?;
            for (scene, rows) in all.iter().enumerate() {
                let time = rows[row][k].map_or(String::new(), |time| time.to_string());
                writeln!(csv, "\"{}\",{target},{scene},{time}", label.replace('"', "\"\""))?;
            }
        }
    }
    markdown += "\nBrackets: 95 % intervals (Wilson). A choice is a feasible hit that is avoidable, the best within \
        the tolerance or else the nearest.\n";
    Ok((markdown, csv))
}
