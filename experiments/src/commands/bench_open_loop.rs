//! `sage bench open-loop`.

use std::{fmt::Write as _, path::Path, time::Instant};

use anyhow::{Result, bail};
use rayon::prelude::*;
use sage_backbones::{
    Backbone,
    training::{Expectation, TunedScene},
};
use sage_core::statistics::Estimate;
use sage_merging::mergers;
use serde_json::json;

use crate::{
    Outcome, Registries,
    bench::open_loop::{self, COLUMNS, SceneRow},
    cli::OpenLoopArgs,
    methods, networks, output,
    progress::{self, Progress},
    scenes,
};

pub(crate) fn run(args: &OpenLoopArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    output::make_folder(&args.out, args.force)?;
    let experts = networks::load_experts(&registries.backbones, &args.weights)?;
    let merger = mergers()?.build_default("linear")?;
    let scenes = scenes::read_split(&args.paths, args.split.splits.as_deref(), args.split.split.as_deref())?;
    let mut runs = Vec::new();
    for method in &args.methods {
        let lambdas = if methods::is_steered(method) { &args.lambda.0[..] } else { &[1.0][..] };
        for lambda in lambdas {
            // A ceiling is a ceiling at one lambda.
            if method != "oracle" || lambda == lambdas.last().unwrap_or(&1.0) {
                runs.push(methods::build(
                    method,
                    *lambda,
                    args.choosing.with(args.choice),
                    &experts,
                    &*merger,
                )?);
            }
        }
    }
    let mut progress = Progress::new("ran", runs.len());
    let mut table = Vec::new();
    let mut failures = 0;
    for generator in &runs {
        let mut rows = Vec::new();
        for (data, row) in
            scenes.iter().zip(open_loop::run(&scenes, &**generator, experts.prior(), args.seed))
        {
            match row {
                Ok(row) => rows.push(row),
                Err(error) => {
                    progress.say(&format!("error: {}: `{}`: {error:#}", generator.name(), data.name));
                    failures += 1;
                }
            }
        }
        table.push((generator.name(), rows));
        progress.step();
    }
    progress.finish(&format!("{} rows on {} scenes", runs.len(), scenes.len()));
    if table.iter().all(|(_, rows)| rows.is_empty()) {
        bail!("no scene came out");
    }
    let policies = policies(args, &experts, &*merger, &scenes)?;
    write(args, &table, &policies, scenes.len(), clock.elapsed().as_secs_f64())?;
    Ok(if failures == 0 { Outcome::Done } else { Outcome::Partial })
}

type Policies = Vec<(String, Vec<Expectation>)>;

/// Expectations of the prior and of the mixtures.
fn policies(
    args: &OpenLoopArgs,
    experts: &sage_merging::Experts,
    merger: &dyn sage_merging::Merger,
    scenes: &[sage_backbones::training::SceneData],
) -> Result<Policies> {
    let prior = experts.prior();
    let prepare = |data| TunedScene::new(prior, data, false);
    let prepared: Vec<_> = scenes.par_iter().with_max_len(1).map(prepare).collect();
    let prepared: Vec<TunedScene> =
        prepared.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect();
    let mut policies = vec![("prior".to_owned(), open_loop::expectations(&prepared, prior)?)];
    for lambda in &args.lambda.0 {
        let network: Box<dyn Backbone> = prior.rebuilt(merger.merge(experts, *lambda)?)?;
        policies.push((format!("sage {lambda:.2}"), open_loop::expectations(&prepared, &*network)?));
    }
    Ok(policies)
}

fn write(
    args: &OpenLoopArgs,
    table: &[(String, Vec<SceneRow>)],
    policies: &Policies,
    scenes: usize,
    seconds: f64,
) -> Result<()> {
    let interval = |e: Option<Estimate>| {
        e.map_or("-".to_owned(), |e| format!("{:.3} [{:.3}, {:.3}]", e.value, e.low, e.high))
    };
    let mut markdown = String::new();
    let mut csv = "method,measure,value,low,high,n\n".to_owned();
    writeln!(markdown, "| method | N | {} |", COLUMNS.map(|c| c.name).join(" | "))?;
    writeln!(markdown, "| --- | --- |{}", " --- |".repeat(COLUMNS.len()))?;
    for (method, rows) in table {
        write!(markdown, "| {method} | {} |", rows.len())?;
        for column in &COLUMNS {
            let estimate = open_loop::estimate(column, rows);
            write!(markdown, " {} |", interval(estimate))?;
            if let Some(e) = estimate {
                writeln!(
                    csv,
                    "{method},{},{},{},{},{}",
                    column.name.replace(',', ";"),
                    e.value,
                    e.low,
                    e.high,
                    e.n
                )?;
            }
        }
        writeln!(markdown)?;
    }
    writeln!(markdown, "\nWithout choice, expectations under the policy:\n")?;
    writeln!(
        markdown,
        "| policy | N | feasible | feasible hit | R_adv | P_real |\n| --- | --- | --- | --- | --- | --- |"
    )?;
    for (policy, all) in policies {
        let columns: [fn(&Expectation) -> f64; 4] =
            [|e| e.feasible, |e| e.attack, |e| e.reward, |e| e.penalty];
        let cells: Vec<String> = columns.map(|value| interval(open_loop::mean(all, value))).to_vec();
        writeln!(markdown, "| {policy} | {} | {} |", all.len(), cells.join(" | "))?;
    }
    let rows: Result<Vec<String>, _> =
        table.iter().flat_map(|(_, rows)| rows).map(serde_json::to_string).collect();
    let record = json!({
        "command": output::command(), "scenes": scenes, "seed": args.seed, "seconds": seconds,
        "version": env!("CARGO_PKG_VERSION"),
    });
    let file =
        |name: &str, text: &str| output::write_file(&args.out.join(Path::new(name)), text.as_bytes(), true);
    file("table.md", &markdown)?;
    file("table.csv", &csv)?;
    file("scenes.jsonl", &(rows?.join("\n") + "\n"))?;
    file("run.json", &format!("{record:#}\n"))?;
    print(&markdown)?;
    progress::say(&format!("table.md, table.csv, scenes.jsonl and run.json are in `{}`", args.out.display()));
    Ok(())
}

fn print(text: &str) -> Result<()> {
    use std::io::Write;
    Ok(std::io::stdout().lock().write_all(text.as_bytes())?)
}
