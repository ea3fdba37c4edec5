//! `sage bench pareto`: mergers compared by their fronts of reward against realism.

use std::{fmt::Write as _, sync::Arc};

use anyhow::{Context as _, Result};
use sage_backbones::{MotionModel, training::Measures};
use sage_core::{
    objective::FurtherMeasures,
    scene::SceneData,
    statistics::{self, Estimate},
};
use sage_merging::Merger;
use serde_json::json;

use crate::{
    Outcome, Registries,
    bench::{
        front::measure,
        line_chart,
        open_loop::{self, MeasuredScene, SceneRow},
        pareto::{Measure, Sweep, hypervolume, monotone, unevenness},
    },
    cli::ParetoArgs,
    generators::{self, BuiltGenerator},
    networks,
    operating_point::OperatingPointSpec,
    output::{self, Folder},
    part::{Part, Parts},
    progress::{self, Progress},
    scenes::Scenes,
    selection::Selection,
};

/// Steps of λ from 0 to 1.
const STEPS: usize = 20;

/// One merger with its models.
struct Compared {
    name: String,
    built: BuiltGenerator,
    /// Models at every λ; `None` if their modes are not the prior's.
    models: Option<Vec<Arc<dyn MotionModel>>>,
}

/// Results of one merger: with selection, without, and seconds per attack.
#[derive(Default)]
struct Sweeps {
    selected: Sweep,
    free: Sweep,
    seconds: Vec<f64>,
}

pub(crate) fn run(args: &ParetoArgs, registries: &Registries) -> Result<Outcome> {
    let selection = Selection::of(registries, &args.on.selection, args.on.rule.feasibility.as_ref())?;
    let experts = networks::load_experts(&registries.backbones, &args.on.weights)?;
    let lambdas: Vec<f64> = (0..=STEPS).map(|k| k as f64 / STEPS as f64).collect();
    let Parts(parts) = &args.mergers;
    let mut compared = Vec::with_capacity(parts.len());
    for part in parts {
        let merger: Arc<dyn Merger> = part.build(&registries.mergers)?.into();
        let inputs = generators::inputs(Some(&experts), &merger, &selection, args.on.seed);
        let points: Vec<OperatingPointSpec> = lambdas
            .iter()
            .map(|lambda| OperatingPointSpec::at(*lambda, args.mu, merger.range()))
            .collect::<Result<_>>()?;
        let sage = Part { name: "sage".to_owned(), options: serde_json::Map::new() };
        let models = merger.keeps_modes().then(|| {
            lambdas
                .iter()
                .map(|lambda| merger.merge(&experts, &experts.between(*lambda)?, args.on.seed))
                .collect()
        });
        compared.push(Compared {
            name: part.to_string(),
            built: BuiltGenerator::new(&sage, registries, &inputs, &points)?,
            models: models.transpose()?,
        });
    }
    let out = Folder::make(&args.on.folder.out, args.on.folder.force)?;
    let scenes = Scenes::of(&args.on.paths, &args.on.split, 0, args.on.seed)?.attackable()?;
    let measures = Measures::of(&[], &registries.rewards, &registries.feasibilities)?;
    let further = FurtherMeasures::default();
    // One evaluation of a scene's goals serves all models.
    let models: Vec<Arc<dyn MotionModel>> =
        compared.iter().filter_map(|compared| compared.models.clone()).flatten().collect();
    let one = |data: &SceneData| -> Result<(Vec<Vec<SceneRow>>, Vec<Measure>)> {
        let prior = &**experts.prior();
        let scene = MeasuredScene::new(data, prior, &further)?;
        let rows = compared.iter().map(|compared| scene.rows(&compared.built, args.on.seed));
        let free = open_loop::expectations(data, prior, &models, &measures)?;
        let free = free.context("the scene was attackable")?.into_iter().map(Measure::from);
        Ok((rows.collect::<Result<_>>()?, free.collect()))
    };
    let mut progress = Progress::new("evaluated", scenes.len());
    let all = scenes.map(one, || progress.step())?;
    progress.finish(&format!("{} mergers at {} values of lambda", compared.len(), lambdas.len()));
    let mut sweeps: Vec<Sweeps> = compared.iter().map(|_| Sweeps::default()).collect();
    for (rows, free) in all {
        let mut free = free.chunks(lambdas.len());
        for ((rows, sweeps), compared) in rows.iter().zip(&mut sweeps).zip(&compared) {
            sweeps.seconds.extend(rows.iter().map(|row| row.seconds));
            sweeps.selected.scenes.push(rows.iter().map(measure).collect());
            if compared.models.is_some() {
                sweeps.free.scenes.extend(free.next().map(<[Measure]>::to_vec));
            }
        }
    }
    let names: Vec<&str> = compared.iter().map(|compared| &*compared.name).collect();
    let markdown = table(&names, &sweeps)?;
    out.write("table.md", markdown.as_bytes())?;
    out.write("pareto.csv", csv(&names, &sweeps, &lambdas)?.as_bytes())?;
    charts(&out, &names, &sweeps, &lambdas)?;
    let record = json!({
        "command": output::command(), "mergers": names, "weights": args.on.weights, "mu": args.mu,
        "selection": selection.objective.spec(), "seed": args.on.seed, "scenes": scenes.describe(),
        "version": env!("CARGO_PKG_VERSION"),
    });
    out.write("run.json", format!("{record:#}\n").as_bytes())?;
    output::print(&markdown)?;
    progress::say(&format!(
        "table.md, pareto.csv, run.json and charts are in `{}`",
        args.on.folder.out.display()
    ));
    Ok(scenes.outcome())
}

fn table(names: &[&str], sweeps: &[Sweeps]) -> Result<String> {
    let mut out = "Mergers over 21 values of lambda. With selection: the best candidate at each lambda. Without: \
        expectations under the policy.\n\n\
        | merger | N | hypervolume | minus the first | reward monotone % | unevenness, points | without selection: hypervolume | minus the first | ms a generation |\n\
        | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n"
        .to_owned();
    let cell = |e: Option<Estimate>| {
        e.map_or("-".to_owned(), |e| format!("{:.3} [{:.3}, {:.3}]", e.value, e.low, e.high))
    };
    for (k, (name, own)) in names.iter().zip(sweeps).enumerate() {
        let front = own.selected.front();
        let minus = |of: fn(&Sweeps) -> &Sweep| {
            if k == 0 { "-".to_owned() } else { cell(of(own).difference(of(&sweeps[0]), hypervolume)) }
        };
        writeln!(
            out,
            "| {name} | {} | {} | {} | {:.0} | {:.1} | {} | {} | {:.1} |",
            own.selected.scenes.len(),
            cell(own.selected.estimate(hypervolume)),
            minus(|sweeps| &sweeps.selected),
            monotone(&front),
            unevenness(&front),
            cell(own.free.estimate(hypervolume)),
            minus(|sweeps| &sweeps.free),
            1e3 * statistics::median(&own.seconds).unwrap_or(0.0),
        )?;
    }
    out += "\n*Hypervolume*: area in the plane of R_adv and P_real that the mean over scenes dominates at any lambda, up \
        to R_adv 0 and P_real 6. *Monotone*: share of the steps of lambda at which R_adv does not fall. *Unevenness*: RMS \
        deviation of the attack rate from a straight line. Intervals: 95 %, bootstrap over scenes; differences are paired.\n";
    Ok(out)
}

fn csv(names: &[&str], sweeps: &[Sweeps], lambdas: &[f64]) -> Result<String> {
    let mut out = "merger,selection,lambda,reward,penalty,attack,believable\n".to_owned();
    for (name, own) in names.iter().zip(sweeps) {
        for (kind, sweep) in [("yes", &own.selected), ("no", &own.free)] {
            for (lambda, m) in lambdas.iter().zip(sweep.front()) {
                let name = format!("\"{}\"", name.replace('"', "\"\""));
                writeln!(
                    out,
                    "{name},{kind},{lambda},{},{},{},{}",
                    m.reward, m.penalty, m.attack, m.believable
                )?;
            }
        }
    }
    Ok(out)
}

fn charts(out: &Folder, names: &[&str], sweeps: &[Sweeps], lambdas: &[f64]) -> Result<()> {
    let lines = |of: fn(&Sweeps) -> &Sweep, point: &dyn Fn(f64, &Measure) -> [f64; 2]| {
        let line = |(name, own): (&&str, &Sweeps)| {
            let front = of(own).front();
            let points = lambdas.iter().zip(&front).map(|(lambda, m)| point(*lambda, m)).collect();
            ((*name).to_owned(), points)
        };
        names.iter().zip(sweeps).map(line).collect::<Vec<(String, Vec<[f64; 2]>)>>()
    };
    let plane: &dyn Fn(f64, &Measure) -> [f64; 2] = &|_, m| [m.penalty, m.reward];
    let control: &dyn Fn(f64, &Measure) -> [f64; 2] = &|lambda, m| [lambda, 100.0 * m.attack];
    let [realism, dial] = [["P_real (smaller is better)", "R_adv"], ["lambda", "feasible hits, %"]];
    for (file, axes, lines) in [
        ("pareto.svg", realism, lines(|sweeps| &sweeps.selected, plane)),
        ("pareto-without-selection.svg", realism, lines(|sweeps| &sweeps.free, plane)),
        ("control.svg", dial, lines(|sweeps| &sweeps.selected, control)),
        ("control-without-selection.svg", dial, lines(|sweeps| &sweeps.free, control)),
    ] {
        out.write(file, line_chart::draw(axes, lines)?.as_bytes())?;
    }
    Ok(())
}
