//! Progress, curves and tables of trained policies.

use std::{
    fmt::Write as _,
    sync::{
        Mutex, OnceLock, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use anyhow::Result;
use sage_bench::{
    chart::line::{Chart, Line},
    csv_text::csv,
};
use sage_core::text::table::Table;
use sage_learn::{Algorithm, Counters, Evaluation, TrainingOptions};
use sage_run::{
    output::Run,
    progress,
    terminal::{escaped_markdown, escaped_markdown_code, escaped_name},
};
use sage_sim::{actor::PolicyCard, evaluation::EpisodeRow};
use serde_json::{Map, Value, json};

use super::columns::{COMPLETION, CONTACT, Columns, OFF_ROAD, text};

/// Newest evaluations that a table averages.
const AVERAGED: usize = 5;

/// A trained seed.
pub(super) struct Trained {
    pub(super) seed: u64,
    pub(super) evaluations: Vec<Evaluation>,
    pub(super) losses: Vec<[f64; 3]>,
    pub(super) counters: Counters,
    pub(super) updates: u64,
}

/// Means of all columns, with the number of episodes.
pub(super) fn means(columns: &Columns, rows: &[EpisodeRow]) -> Value {
    let means = columns.names().into_iter().zip(columns.means(rows));
    let mut all: Map<String, Value> = means.map(|(name, mean)| (name, json!(mean))).collect();
    all.insert("episodes".to_owned(), json!(rows.len()));
    Value::Object(all)
}

/// Curves of some seeds as CSV: a row per evaluation and kind of scenes.
pub(super) fn curve_csv(columns: &Columns, trained: &[Trained]) -> String {
    let heads = ["seed", "step", "updates", "scenes", "episodes"].map(str::to_owned).into_iter();
    let mut all: Vec<Vec<String>> = vec![
        heads.chain(columns.names()).chain(["critic_loss", "mean_abs_value"].map(str::to_owned)).collect(),
    ];
    for run in trained {
        for (evaluation, [_, loss, q]) in run.evaluations.iter().zip(&run.losses) {
            for (kind, rows) in kinds(evaluation) {
                let Evaluation { step, updates, .. } = evaluation;
                let head = [run.seed.to_string(), step.to_string(), updates.to_string(), kind.to_owned()];
                let means = columns.means(rows).into_iter().map(text);
                let tail = [loss.to_string(), q.to_string()];
                all.push(head.into_iter().chain([rows.len().to_string()]).chain(means).chain(tail).collect());
            }
        }
    }
    csv(all)
}

/// Rows of all episodes of the newest evaluations of a seed.
pub(super) fn episodes_csv(columns: &Columns, trained: &Trained, names: &[String]) -> String {
    let heads = ["seed", "step", "scenes", "scene", "steps"].map(str::to_owned).into_iter();
    let mut all: Vec<Vec<String>> = vec![heads.chain(columns.names()).collect()];
    let first = trained.evaluations.len().saturating_sub(AVERAGED);
    for evaluation in &trained.evaluations[first..] {
        for (kind, rows) in kinds(evaluation) {
            for row in rows {
                let scene = names.get(row.scene).map_or("unknown", String::as_str);
                let head = [trained.seed.to_string(), evaluation.step.to_string(), kind.to_owned()];
                let scene = [escaped_name(scene), row.steps.to_string()];
                all.push(head.into_iter().chain(scene).chain(columns.cells(row)).collect());
            }
        }
    }
    csv(all)
}

fn kinds(evaluation: &Evaluation) -> impl Iterator<Item = (&'static str, &[EpisodeRow])> {
    [("unchanged", &evaluation.unchanged[..]), ("attacked", &evaluation.attacked[..])]
        .into_iter()
        .filter(|(_, rows)| !rows.is_empty())
}

/// Writes the curves of all seeds as CSV and SVG.
///
/// *Errors*: a file cannot be written.
pub(super) fn write(run: &Run, columns: &Columns, trained: &[Trained]) -> Result<()> {
    run.folder().write("curves.csv", curve_csv(columns, trained).as_bytes())?;
    let mut lines: Vec<Line> = Vec::new();
    let drawn = [
        ("unchanged", COMPLETION),
        ("attacked", COMPLETION),
        ("unchanged", CONTACT),
        ("attacked", CONTACT),
        ("unchanged", OFF_ROAD),
    ];
    for (kind, column) in drawn {
        let count = trained.iter().map(|run| run.evaluations.len()).min().unwrap_or(0);
        let mut points = Vec::new();
        for k in 0..count {
            let rows =
                trained.iter().flat_map(|run| kinds(&run.evaluations[k]).filter(|(of, _)| *of == kind));
            let values: Vec<f64> = rows.filter_map(|(_, rows)| columns.mean(column, rows)).collect();
            let step = trained.first().map_or(0, |run| run.evaluations[k].step);
            if !values.is_empty() {
                points.push([step as f64 / 1000.0, values.iter().sum::<f64>() / values.len() as f64]);
            }
        }
        if !points.is_empty() {
            lines.push((format!("{column}, {kind} scenes"), points));
        }
    }
    let end = lines.iter().flat_map(|(_, points)| points).map(|[x, _]| *x).fold(0.0, f64::max);
    // The legend has the right of the picture to itself.
    let ranges = Some([0.0..1.6 * end.max(0.001), 0.0..1.0]);
    let axes = ["thousand steps", "share, mean of seeds"];
    let chart = Chart { axes, lines, ranges, ..Chart::default() };
    Ok(run.folder().write("curves.svg", chart.draw()?.as_bytes())?)
}

/// Means over the newest evaluations of a seed, per kind of scenes; `None` without any.
fn newest(trained: &Trained, kind: &str, columns: &Columns) -> Option<Vec<Option<f64>>> {
    let first = trained.evaluations.len().saturating_sub(AVERAGED);
    let rows = trained.evaluations[first..].iter().flat_map(kinds).filter(|(of, _)| *of == kind);
    let all: Vec<Vec<Option<f64>>> = rows.map(|(_, rows)| columns.means(rows)).collect();
    let mean = |k: usize| {
        let values: Vec<f64> = all.iter().filter_map(|means| means[k]).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    all.first().map(|first| (0..first.len()).map(mean).collect())
}

/// A table: a row per seed and kind of scenes, means of the last five evaluations.
pub(super) fn markdown(columns: &Columns, scenes: usize, trained: &[Trained]) -> String {
    let title = format!(
        "Means of the last {AVERAGED} evaluations, {scenes} scenes each. `completion_recorded` ends with the recording."
    );
    let heads = ["seed", "scenes"].map(str::to_owned).into_iter().chain(columns.names()).collect();
    let mut table = Table { title, heads, names: 2, ..Table::default() };
    for run in trained {
        for kind in ["unchanged", "attacked"] {
            if let Some(means) = newest(run, kind, columns) {
                let cells = means.into_iter().map(|mean| format!("{:.2}", mean.unwrap_or(f64::NAN)));
                table.rows.push([run.seed.to_string(), kind.to_owned()].into_iter().chain(cells).collect());
            }
        }
    }
    table.markdown()
}

/// Name of the algorithm of a run.
pub(super) fn algorithm(options: &TrainingOptions) -> &'static str {
    match options.algorithm {
        Algorithm::Td3 => "TD3",
        Algorithm::Ppo => "PPO",
    }
}

/// The card of a policy as a page.
pub(super) fn card_page(columns: &Columns, card: &PolicyCard) -> String {
    let names = columns.names();
    let PolicyCard { observation_hash, training, evaluation, license, .. } = card;
    let mut facts = Table::new("", &["", ""]);
    facts.row("licence", [escaped_markdown(license)]);
    facts.row("observation", [format!("101 numbers (`{observation_hash}`)")]);
    let teacher = Some("teacher").filter(|key| !training[*key].is_null());
    let keys = ["scenes", "generator", "curriculum", "sampler", "updates", "steps", "seed"];
    for key in teacher.into_iter().chain(keys) {
        let value = training[key].as_str().map_or_else(|| training[key].to_string(), str::to_owned);
        facts.row(key, [escaped_markdown(&value)]);
    }
    let words = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let title = format!(
        "{}, unchanged and attacked by `{}` at λ = 1; contacts with a vehicle end an episode.",
        escaped_markdown(&words(&evaluation["scenes"])),
        escaped_markdown_code(&words(&evaluation["attacks"]))
    );
    let heads = std::iter::once(String::new()).chain(names.iter().map(|name| name.replace('_', " ")));
    let mut means = Table { title, heads: heads.collect(), rows: Vec::new(), names: 1 };
    for kind in ["unchanged", "attacked"].into_iter().filter(|kind| evaluation[kind]["episodes"] != 0) {
        let mean = |name: &String| format!("{:.2}", evaluation[kind][name].as_f64().unwrap_or(f64::NAN));
        means.row(kind, names.iter().map(mean));
    }
    let algorithm = training["algorithm"].as_str().unwrap_or("TD3");
    format!(
        "# A driving policy trained by {algorithm}\n\n`policy.safetensors` drives wherever `sage` takes an ego: `--ego {}:policy.safetensors`.\n\n{}\n## Evaluation\n\n{}",
        algorithm.to_lowercase(),
        facts.markdown(),
        means.markdown()
    )
}

/// Results for `run.json`.
pub(super) fn summary(columns: &Columns, trained: &[Trained]) -> Value {
    let of = |run: &Trained| {
        let last = run.evaluations.last();
        let [unchanged, attacked] = [last.map(|e| &e.unchanged), last.map(|e| &e.attacked)];
        json!({
            "seed": run.seed, "updates": run.updates, "counters": run.counters,
            "unchanged": unchanged.map(|rows| means(columns, rows)),
            "attacked": attacked.map(|rows| means(columns, rows)),
        })
    };
    json!({"seeds": trained.iter().map(of).collect::<Vec<_>>()})
}

/// Progress of all seeds together.
pub(super) struct Clock {
    total: u64,
    done: AtomicU64,
    /// When the first step with an update came, and how many steps were done then: random steps are many times faster,
    /// and say nothing about the rest.
    learning: OnceLock<(Instant, u64)>,
    shown: Mutex<Instant>,
}

/// Seconds between two updates of the line on a terminal.
const INTERVAL: f64 = 1.0;

impl Clock {
    pub(super) fn new(total: u64) -> Self {
        Self { total, done: AtomicU64::new(0), learning: OnceLock::new(), shown: Mutex::new(Instant::now()) }
    }

    pub(super) fn resumed(&self, seed: u64, steps: u64) {
        self.done.fetch_add(steps, Ordering::Relaxed);
        progress::say(&format!("seed {seed} resumes at step {steps}"));
    }

    pub(super) fn step(&self, is_learning: bool) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if is_learning {
            self.learning.get_or_init(|| (Instant::now(), done));
        }
        // The clock is read now and then only.
        if !done.is_multiple_of(64) {
            return;
        }
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        if shown.elapsed().as_secs_f64() >= INTERVAL {
            *shown = Instant::now();
            progress::show(&format!("step {done} of {}, {}", self.total, self.left()));
        }
    }

    fn left(&self) -> String {
        let Some((start, before)) = self.learning.get() else { return "random steps first".to_owned() };
        let done = self.done.load(Ordering::Relaxed);
        let rate = (done - before).max(1) as f64 / start.elapsed().as_secs_f64();
        format!(
            "{rate:.0} steps/s, about {:.0} min left",
            (self.total - done.min(self.total)) as f64 / rate / 60.0
        )
    }

    pub(super) fn evaluated(&self, columns: &Columns, seed: u64, evaluation: &Evaluation, total: u64) {
        let mut text = format!("seed {seed}, step {} of {total}:", evaluation.step);
        for (kind, rows) in kinds(evaluation) {
            let [completion, contact, off_road] = [COMPLETION, CONTACT, OFF_ROAD].map(|column| {
                columns.mean(column, rows).map_or("not measured".to_owned(), |mean| format!("{mean:.2}"))
            });
            let _ = write!(text, " {kind}: completion {completion}, contact {contact}, off road {off_road};");
        }
        progress::say(&format!("{text} {}", self.left()));
    }
}
