//! `sage bench open-loop`: compares generators against a replayed ego, or against drivers.

use std::{sync::Arc, time::Instant};

use anyhow::{Result, anyhow, bail};
use sage_backbones::{
    MotionModel,
    training::{Expectation, Measures},
};
use sage_core::{files, generator::Knowledge, objective::FurtherMeasures, scene::SceneData};
use sage_generators::GeneratorInputs;
use sage_merging::{ExpertSet, Merger};
use sage_sim::{SimScene, attack_test::AttackTest};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::{
    Outcome, Registries,
    bench::{
        closed_loop_report::{self, AttackedDriver},
        gallery,
        open_loop::{self, MeasuredScene, SceneRow},
        open_loop_report::{self as report, Policies, Table},
    },
    cli::OpenLoopArgs,
    ego::{self, Ego},
    generators::{self, BuiltGenerator},
    networks,
    operating_point::{OperatingPointSpec, RowKey},
    output::{self, Run, State},
    part::{Part, PolicyParts},
    progress::{self, Progress},
    scene_windows::{self, RESULTS, SceneOutcome},
    scenes::Scenes,
    selection::Selection,
};

/// Size limit of a table that an earlier run wrote, bytes.
const TABLE_LIMIT: u64 = 64 << 20;
/// The table as Markdown.
const TABLE: &str = "table.md";
/// Output files of a run, without the pictures. The last one is there only with drivers.
const FILES: [&str; 5] = [TABLE, "table.csv", "scenes.csv", "index.html", "drivers.csv"];

/// For each generator, one row per operating point, or its error.
type GeneratorRows = Vec<Result<Vec<SceneRow>, String>>;

/// Results of one scene.
#[derive(Serialize, Deserialize)]
struct SceneResult {
    scene: String,
    /// Rows against each driver; against the recorded ego without drivers.
    egos: Vec<GeneratorRows>,
    /// Expectations under each policy, without selection.
    expectations: Option<Vec<Expectation>>,
}

impl SceneOutcome for SceneResult {
    fn scene(&self) -> &str {
        &self.scene
    }
}

pub(crate) fn run(args: &OpenLoopArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let selection = Selection::of(registries, &args.selection, args.rule.feasibility.as_ref())?;
    let merger: Arc<dyn Merger> = args.points.merging.merger.build(&registries.mergers)?.into();
    args.points.check(merger.range())?;
    let spec = Some(selection.objective.spec());
    let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, spec)?;
    let measures = Measures::of(&[], &registries.rewards, &registries.feasibilities)?;
    let experts = networks::load_experts(&registries.backbones, &args.weights)?;
    let merger_name = args.points.merging.merger.to_string();
    let dial = || networks::load_dial(&args.weights, &experts, &selection, &merger_name);
    let points = args.points.specs(dial, merger.range(), &[0.0, 0.5, 1.0])?;
    let inputs = generators::inputs(Some(&experts), &merger, &selection, args.seed);
    let generators = generators(args, registries, &inputs, &points)?;
    // The policies are reported only if a generator uses them.
    let has_network = generators.iter().any(|built| built.facts.needs_experts);
    let policy_points = if has_network && merger.keeps_modes() { &points[..] } else { &[] };
    let policies = policies(policy_points, &experts, &*merger, args.seed)?;
    let paths = [&args.paths[..], &args.data].concat();
    let scenes = Scenes::of(&paths, &args.split, 0, args.seed)?.attackable()?;
    let egos = match &args.ego {
        Some(PolicyParts(parts)) => Ego::all(parts, registries)?,
        None => Vec::new(),
    };
    let identity = identity(args, &experts, &selection, &scenes, &points)?;
    let outputs = if egos.is_empty() { &FILES[..4] } else { &FILES[..] };
    let (run, state) = Run::start(&args.folder.out, identity, args.folder.force, &[RESULTS], &[], outputs)?;
    if state == State::Done {
        output::print(&files::read_text(&run.folder().path().join(TABLE), TABLE_LIMIT)?)?;
        return Ok(Outcome::Done);
    }
    let models: Vec<Arc<dyn MotionModel>> = policies.iter().map(|(_, model)| model.clone()).collect();
    let prior = &**experts.prior();
    let measure = |data: &SceneData, test: Option<&AttackTest>| -> Result<GeneratorRows> {
        let scene = MeasuredScene::new(data, prior, &further)?.with_avoidance(args.avoidable.options())?;
        let rows = |built: &BuiltGenerator| -> Result<Vec<SceneRow>> {
            let mut rows = scene.rows(built, args.seed)?;
            test.map_or(Ok(()), |test| scene.drive(&mut rows, test))?;
            Ok(rows)
        };
        Ok(generators.iter().map(|built| rows(built).map_err(|error| format!("{error:#}"))).collect())
    };
    // A driver that cannot drive in a scene fails there for every generator.
    let failed = |error: &anyhow::Error| generators.iter().map(|_| Err(format!("{error:#}"))).collect();
    let one = |data: &SceneData| -> Result<SceneResult> {
        let simulated = SimScene::new(data.scene.clone(), data.index.clone());
        let under_test = |ego: &Ego| -> Result<GeneratorRows> {
            let simulated = simulated.as_ref().map_err(|error| anyhow!("{error}"))?;
            let test = AttackTest::new(&*ego.policy, simulated, args.seed)?;
            let (name, index) = (data.name.clone(), data.index.clone());
            measure(&SceneData { name, scene: test.recorded(), index }, Some(&test))
        };
        Ok(SceneResult {
            scene: data.name.clone(),
            egos: match &egos[..] {
                [] => vec![measure(data, None)?],
                egos => {
                    egos.iter().map(|ego| under_test(ego).unwrap_or_else(|error| failed(&error))).collect()
                }
            },
            expectations: match &models[..] {
                [] => None,
                models => open_loop::expectations(data, prior, models, &measures)?,
            },
        })
    };
    let count: usize = generators.iter().map(|built| built.keys.len()).sum();
    let mut progress = Progress::new("evaluated", scenes.len());
    let is_whole = |result: &SceneResult| {
        result.egos.len() == egos.len().max(1)
            && result.egos.iter().all(|rows| rows.len() == generators.len())
    };
    let all = scene_windows::results(&run, &scenes, is_whole, one, || progress.step())?;
    let drivers = match egos.len() {
        0 => String::new(),
        n => format!(" against {}", progress::count(n, "driver")),
    };
    progress.finish(&format!("{count} rows{drivers} on {} scenes", scenes.len()));
    let failures = report_errors(&all, &generators, &egos);
    let tables: Vec<Table> = (0..egos.len().max(1))
        .map(|ego| Table {
            ego: egos.get(ego).map(|ego| ego.label.clone()),
            columns: open_loop::columns(&further, args.avoidable.options().is_some()),
            rows: table_rows(&all, &generators, ego),
        })
        .collect();
    if tables.iter().all(|table| table.rows.iter().all(|(.., rows)| rows.is_empty())) {
        bail!("every generator failed in every scene");
    }
    let expectations = by_policy(&all, &policies);
    let attacked = attacked_drivers(&all, &generators, &egos);
    let markdown = match &egos[..] {
        [] => report::markdown(&tables[0], &expectations)?,
        _ => drivers_markdown(&attacked, &tables, &expectations)?,
    } + &scenes.warnings_as_markdown();
    let folder = run.folder();
    folder.write("table.csv", report::csv(&tables, &expectations)?.as_bytes())?;
    folder.write("scenes.csv", report::scenes_csv(&tables)?.as_bytes())?;
    if !egos.is_empty() {
        folder.write("drivers.csv", closed_loop_report::csv(&attacked)?.as_bytes())?;
    }
    let of_recording = (0..tables.len()).find(|&k| egos.get(k).is_none_or(|ego| ego.policy.is_recording()));
    gallery::write(folder, &scenes, of_recording.map(|k| &tables[k]), &markdown)?;
    folder.write(TABLE, markdown.as_bytes())?;
    run.finish(&Value::Null, clock.elapsed().as_secs_f64())?;
    output::print(&markdown)?;
    let drivers = if egos.is_empty() { "" } else { "drivers.csv, " };
    progress::say(&format!(
        "table.md, table.csv, scenes.csv, {drivers}run.json and index.html with pictures are in `{}`",
        args.folder.out.display()
    ));
    Ok(if failures == 0 { scenes.outcome() } else { Outcome::Partial })
}

/// The tables of attacks on drivers, then for each driver the table against its drive before the attack.
fn drivers_markdown(attacked: &[AttackedDriver], tables: &[Table], policies: &Policies) -> Result<String> {
    let mut out = closed_loop_report::markdown(attacked)?;
    for (k, table) in tables.iter().enumerate() {
        let ego = table.ego.as_deref().unwrap_or_default();
        out += &format!("\nThe same attacks against the drive of `{ego}` before the attack:\n\n");
        // Expectations are of the recorded ego, whatever the drivers.
        let is_last = k + 1 == tables.len();
        out += &report::markdown(table, if is_last { policies } else { const { &Vec::new() } })?;
    }
    Ok(out)
}

/// The generators in the order of the table. An upper bound gets only the operating point with the largest μ.
fn generators(
    args: &OpenLoopArgs,
    registries: &Registries,
    inputs: &GeneratorInputs,
    points: &[OperatingPointSpec],
) -> Result<Vec<BuiltGenerator>> {
    let largest_mu = points.iter().max_by(|a, b| a.mu.total_cmp(&b.mu));
    let largest_mu: Vec<OperatingPointSpec> = largest_mu.into_iter().cloned().collect();
    let build = |part: &Part| {
        let is_upper_bound = part.build(&registries.generators)?.facts().is_upper_bound;
        BuiltGenerator::new(part, registries, inputs, if is_upper_bound { &largest_mu } else { points })
    };
    let built = args.methods.0.iter().map(build).collect::<Result<Vec<_>>>()?;
    let keys: Vec<RowKey> = built.iter().flat_map(|built| built.keys.clone()).collect();
    generators::refuse_duplicates(&keys)?;
    Ok(built)
}

/// The prior and the mixtures at all operating points, by name.
fn policies(
    points: &[OperatingPointSpec],
    experts: &ExpertSet,
    merger: &dyn Merger,
    seed: u64,
) -> Result<Vec<(String, Arc<dyn MotionModel>)>> {
    let prior: Arc<dyn MotionModel> = experts.prior().clone();
    if points.is_empty() {
        return Ok(Vec::new());
    }
    let mut policies = vec![("prior".to_owned(), prior)];
    for point in points {
        let model = merger.merge(experts, &point.point(Some(experts))?.mixture, seed)?;
        policies.push((format!("sage, {}", point.mixture_label()), model));
    }
    Ok(policies)
}

/// Inputs by which a run is recognised when it resumes.
fn identity(
    args: &OpenLoopArgs,
    experts: &ExpertSet,
    selection: &Selection,
    scenes: &Scenes,
    points: &[OperatingPointSpec],
) -> Result<Value> {
    let hashes = experts.experts().iter().map(|(name, weights)| Ok((name.clone(), weights.hash()?.into())));
    let mut identity = json!({
        "methods": args.methods.0.iter().map(Part::to_string).collect::<Vec<_>>(),
        "merger": args.points.merging.merger.to_string(), "selection": selection.objective.spec(), "seed": args.seed,
        "scenes": scenes.describe(), "names": scenes.names(), "prior": experts.prior().parameters().hash()?,
        "experts": hashes.collect::<Result<Map<String, Value>>>()?,
        "points": points, "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
    });
    if let Some(PolicyParts(parts)) = &args.ego {
        identity["ego"] = parts.iter().map(ego::identity).collect::<Result<Vec<_>>>()?.into();
    }
    if let Some(options) = &args.avoidable.options() {
        identity["avoidable"] = serde_json::to_value(options)?;
    }
    Ok(identity)
}

/// Prints which generator failed in which scene; returns the number of failures.
fn report_errors(all: &[SceneResult], generators: &[BuiltGenerator], egos: &[Ego]) -> usize {
    let mut failures = 0;
    for result in all {
        for (k, rows) in result.egos.iter().enumerate() {
            let ego = egos.get(k).map_or(String::new(), |ego| format!(" against {}", ego.label));
            for (rows, built) in rows.iter().zip(generators) {
                if let Err(error) = rows {
                    let method = &built.keys[0].method;
                    progress::say(&format!("error: {method}{ego}: `{}`: {error}", result.scene));
                    failures += 1;
                }
            }
        }
    }
    failures
}

/// Rows by generator and operating point, against one ego.
fn table_rows(
    all: &[SceneResult],
    generators: &[BuiltGenerator],
    ego: usize,
) -> Vec<(RowKey, Knowledge, Vec<SceneRow>)> {
    let mut table = Vec::new();
    for (k, built) in generators.iter().enumerate() {
        for (point, key) in built.keys.iter().enumerate() {
            let row = |result: &SceneResult| result.egos.get(ego)?.get(k)?.as_ref().ok()?.get(point).cloned();
            table.push((key.clone(), built.facts.knows, all.iter().filter_map(row).collect()));
        }
    }
    table
}

/// Results by driver, generator and operating point.
fn attacked_drivers<'a>(
    all: &'a [SceneResult],
    generators: &'a [BuiltGenerator],
    egos: &'a [Ego],
) -> Vec<AttackedDriver<'a>> {
    let mut drivers = Vec::new();
    for (e, ego) in egos.iter().enumerate() {
        for (k, built) in generators.iter().enumerate() {
            for (point, key) in built.keys.iter().enumerate() {
                let scene = |result: &'a SceneResult| {
                    let rows = result.egos[e][k].as_ref();
                    (&*result.scene, rows.map(|rows| &rows[point]).map_err(|error| &**error))
                };
                let (scenes, knows) = (all.iter().map(scene).collect(), ego.policy.privilege());
                drivers.push(AttackedDriver { ego: &ego.label, knows, key, scenes });
            }
        }
    }
    drivers
}

/// Expectations by policy.
fn by_policy(all: &[SceneResult], policies: &[(String, Arc<dyn MotionModel>)]) -> Policies {
    let of = |k: usize| all.iter().filter_map(move |result| result.expectations.as_ref()?.get(k).copied());
    policies.iter().enumerate().map(|(k, (name, _))| (name.clone(), of(k).collect())).collect()
}
