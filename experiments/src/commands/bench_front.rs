//! `sage bench front`: generators compared by attack rate against realism.

use std::sync::Arc;

use anyhow::Result;
use sage_core::{objective::FurtherMeasures, scene::SceneData};
use sage_merging::Merger;
use serde_json::json;

use crate::{
    Outcome, Registries,
    bench::{
        front,
        open_loop::{MeasuredScene, SceneRow},
    },
    cli::FrontArgs,
    generators::{self, BuiltGenerator},
    networks,
    operating_point::RowKey,
    output::{self, Folder},
    part::Parts,
    progress::{self, Progress},
    scenes::Scenes,
    selection::Selection,
};

/// Steps of λ from 0 to 1 by default.
const STEPS: usize = 10;

pub(crate) fn run(args: &FrontArgs, registries: &Registries) -> Result<Outcome> {
    let selection = Selection::of(registries, &args.on.selection, args.on.rule.feasibility.as_ref())?;
    let merger: Arc<dyn Merger> = args.points.merging.merger.build(&registries.mergers)?.into();
    args.points.check(merger.range())?;
    let experts = networks::load_experts(&registries.backbones, &args.on.weights)?;
    let merger_name = args.points.merging.merger.to_string();
    let dial = || networks::load_dial(&args.on.weights, &experts, &selection, &merger_name);
    let lambdas: Vec<f64> = (0..=STEPS).map(|k| k as f64 / STEPS as f64).collect();
    let points = args.points.specs(dial, merger.range(), &lambdas)?;
    let inputs = generators::inputs(Some(&experts), &merger, &selection, args.on.seed);
    let Parts(methods) = &args.methods;
    let built = methods.iter().map(|part| BuiltGenerator::new(part, registries, &inputs, &points));
    let built = built.collect::<Result<Vec<_>>>()?;
    let keys: Vec<RowKey> = built.iter().flat_map(|built| built.keys.clone()).collect();
    generators::refuse_duplicates(&keys)?;
    let out = Folder::make(&args.on.folder.out, args.on.folder.force)?;
    let scenes = Scenes::of(&args.on.paths, &args.on.split, 0, args.on.seed)?.attackable()?;
    let further = FurtherMeasures::default();
    let one = |data: &SceneData| -> Result<Vec<SceneRow>> {
        let scene = MeasuredScene::new(data, &**experts.prior(), &further)?;
        let rows = built.iter().map(|built| scene.rows(built, args.on.seed)).collect::<Result<Vec<_>>>()?;
        Ok(rows.concat())
    };
    let mut progress = Progress::new("attacked", scenes.len());
    let rows = scenes.map(one, || progress.step())?;
    progress.finish(&format!(
        "{} on {}",
        progress::count(keys.len(), "point"),
        progress::count(rows.len(), "scene")
    ));
    let fronts = front::fronts(&rows);
    let markdown = front::markdown(&fronts)?;
    out.write("table.md", markdown.as_bytes())?;
    out.write("points.csv", front::csv(&fronts)?.as_bytes())?;
    front::charts(&out, &fronts)?;
    let record = json!({
        "command": output::command(), "points": keys.iter().map(RowKey::label).collect::<Vec<_>>(),
        "weights": args.on.weights, "selection": selection.objective.spec(), "seed": args.on.seed,
        "scenes": scenes.describe(), "failed": scenes.failed(), "version": env!("CARGO_PKG_VERSION"),
    });
    out.write("run.json", format!("{record:#}\n").as_bytes())?;
    output::print(&markdown)?;
    progress::say(&format!(
        "table.md, points.csv, run.json and charts are in `{}`",
        args.on.folder.out.display()
    ));
    Ok(scenes.outcome())
}
