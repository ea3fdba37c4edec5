//! The report of a study, from its rows alone: tables, estimates, differences, curves and charts.

mod charts;
mod curves;
mod limits;
mod pairs;
mod record;
mod sweeps;
mod tests;
mod thresholds;
mod transfers;
mod verdicts;

use std::collections::{BTreeSet, HashMap};

use rayon::prelude::*;
use sage_core::{metric::Aggregate, statistics::Estimate, text::table::Table, text::wrap::wrapped};

use crate::{Result, csv_text::csv};

pub use limits::{OwnWorld, verdict_of};
pub(crate) use pairs::KINDS;
pub use record::{StudyRecord, join, read, rows_csv};

use crate::{
    estimate::Samples,
    published::published,
    rows::{MetricRecord, Results, Subject},
    study::Study,
};

/// The report as Markdown.
pub const PAGE: &str = "table.md";
/// All values.
pub const ROWS: &str = "rows.csv";
/// Estimates of all metrics.
pub const ESTIMATES: &str = "estimates.csv";
/// Study, methods, metrics and scenes, from which a report is made again.
pub const RECORD: &str = "study.json";

/// A rendered report.
pub struct Report {
    /// Tables in their order.
    pub tables: Vec<Table>,
    /// What the columns mean: head and words.
    pub words: Vec<(String, String)>,
    /// Explanation below them.
    pub notes: String,
    /// Files: names and contents.
    pub files: Vec<(String, String)>,
}

impl Report {
    /// Renders results.
    ///
    /// *Errors*: a chart or a comparison of the study names a metric that was not measured.
    pub fn new(study: &Study, results: &Results) -> Result<Self> {
        let all = Estimates::of(results);
        let mut tables: Vec<Table> = (Subject::ALL.into_iter())
            .filter(|subject| !results.methods(*subject).is_empty())
            .map(|subject| table(study, results, subject, &all))
            .collect::<Result<Vec<_>>>()?
            .into_iter()
            .flatten()
            .collect();
        tables.extend(types(results));
        let limits = limits::tables(study, results, &all)?;
        tables.extend(limits.as_ref().map(|(table, _)| table.clone()));
        tables.extend(curves::tables(study, results)?);
        if study.report.sweeps {
            tables.extend(sweeps::tables(results)?);
        }
        tables.extend(thresholds::tables(results));
        tables.extend(transfers::tables(results));
        tables.extend(verdicts::tables(study, results, &all)?);
        tables.extend(pairs::tables(study, results)?);
        tables.extend(tests::tables(study, results)?);
        let notes = tests::braking(results) + &study.report.notes;
        let mut files =
            vec![(ESTIMATES.to_owned(), estimates(results, &all)), (ROWS.to_owned(), rows_csv(results))];
        files.extend(limits.map(|(_, file)| (limits::VERDICTS.to_owned(), file)));
        files.extend(charts::draw(study, results)?);
        let report = Self { tables, words: words(study, results), notes: notes + intervals(results), files };
        let page = report.markdown();
        Ok(Self { files: [vec![(PAGE.to_owned(), page)], report.files].concat(), ..report })
    }

    /// The whole report as Markdown.
    pub fn markdown(&self) -> String {
        self.page(&self.tables, Table::markdown)
    }

    /// What fits a terminal, with the words on its columns alone.
    pub fn terminal(&self) -> String {
        let tables: Vec<Table> = self.tables.iter().map(Table::narrow).collect();
        // Tables fit already, and their lines must stay whole.
        let text = self.page(&tables, Table::aligned);
        let fitted = |line: &str| if line.starts_with('|') { line.to_owned() } else { wrapped(line, 0) };
        text.split('\n').map(fitted).collect::<Vec<_>>().join("\n")
    }

    fn page(&self, tables: &[Table], text: impl Fn(&Table) -> String) -> String {
        let is_shown = |head: &String| tables.iter().any(|table| table.heads.contains(head));
        let words = self.words.iter().filter(|(head, _)| is_shown(head));
        let words: String = words.map(|(_, words)| &**words).collect();
        let tables: Vec<String> = tables.iter().map(text).collect();
        format!("{}\n{words}{}", tables.join("\n"), self.notes)
    }
}

/// A value with its interval, as its metric is shown.
fn cell(metric: &MetricRecord, estimate: Option<Estimate>, deviation: Option<f64>) -> String {
    let Some(e) = estimate else { return "-".to_owned() };
    let [value, low, high] = [e.value, e.low, e.high];
    let spread = |scale: f64| deviation.map_or(String::new(), |d| format!(" ± {:.2}", scale * d));
    match (metric.aggregate, &*metric.unit) {
        (Aggregate::Share, "") => {
            format!("{:.1}{} [{:.1}, {:.1}]", 100.0 * value, spread(100.0), 100.0 * low, 100.0 * high)
        }
        (Aggregate::Median, "ms") => format!("{value:.1} [{low:.1}, {high:.1}]"),
        (Aggregate::Median, _) => format!("{value:.2} [{low:.2}, {high:.2}]"),
        _ => format!("{value:.3}{} [{low:.3}, {high:.3}]", spread(1.0)),
    }
}

/// Names of a method in the columns that distinguish it: arm, attack.
fn named(results: &Results, method: usize, has: NameColumns) -> Vec<String> {
    let key = &results.keys[method];
    has.of(key.arm.clone(), key.attack_label())
}

/// Columns that name a method.
#[derive(Clone, Copy)]
struct NameColumns {
    arm: bool,
    attack: bool,
}

impl NameColumns {
    /// The cells of a row that there are columns for.
    fn of<T>(self, arm: T, attack: T) -> Vec<T> {
        self.arm.then_some(arm).into_iter().chain(self.attack.then_some(attack)).collect()
    }
}

/// The columns that tell some methods apart.
fn name_columns(results: &Results, methods: &[usize]) -> NameColumns {
    let arms = methods.iter().any(|k| results.keys[*k].arm != results.keys[methods[0]].arm);
    let attacks = methods.iter().any(|k| !results.keys[*k].attack_label().is_empty());
    NameColumns { arm: arms || !attacks, attack: attacks }
}

/// Estimates of all metrics of all methods, made once.
struct Estimates(HashMap<(usize, usize), (Samples, Option<Estimate>)>);

impl Estimates {
    fn of(results: &Results) -> Self {
        let all = Subject::ALL.into_iter().flat_map(|subject| {
            let metrics = results.metrics_of(subject).len();
            results
                .methods(subject)
                .into_iter()
                .flat_map(move |method| (0..metrics).map(move |k| (method, k)))
        });
        let all: Vec<(usize, usize)> = all.collect();
        let one = |&(method, k): &(usize, usize)| {
            let key = &results.keys[method];
            let metric = &results.metrics_of(key.subject)[k];
            let samples = results.samples(method, k);
            let stream = format!("{} {}", key.stream(), metric.name);
            let estimate = samples.estimate(metric.aggregate, &stream);
            ((method, k), (samples, estimate))
        };
        Self(all.par_iter().map(one).collect())
    }

    fn get(&self, method: usize, metric: usize) -> (&Samples, Option<Estimate>) {
        let (samples, estimate) = &self.0[&(method, metric)];
        (samples, *estimate)
    }
}

/// The table of a subject; `None` if the study shows no column of it.
fn table(study: &Study, results: &Results, subject: Subject, all: &Estimates) -> Result<Option<Table>> {
    let methods = results.methods(subject);
    let has = name_columns(results, &methods);
    let metrics = results.metrics_of(subject);
    let columns: Vec<usize> = match study.report.columns.get(&subject) {
        Some(names) => names.iter().filter_map(|name| results.metric(subject, name)).collect(),
        // Types of collisions have a table of their own.
        None => (0..metrics.len()).filter(|k| !metrics[*k].name.starts_with(TYPE)).collect(),
    };
    if columns.is_empty() {
        return Ok(None);
    }
    let knows = methods.iter().any(|k| !results.keys[*k].knows.is_empty());
    let fails = methods.iter().any(|k| results.failure_count(*k) > 0);
    let seeds = methods.iter().any(|k| results.keys[*k].training_seed.is_some());
    let attack = if subject == Subject::Policy { "point" } else { "generator" };
    let mut heads = has.of("arm".to_owned(), attack.to_owned());
    let names = heads.len();
    heads.extend(seeds.then(|| "seeds".to_owned()));
    heads.push("N".to_owned());
    heads.extend(fails.then(|| "failed".to_owned()));
    heads.extend(columns.iter().map(|k| metrics[*k].head()));
    heads.extend(knows.then(|| "knows beyond now".to_owned()));
    let row = |method: &usize| {
        let found: Vec<_> = columns.iter().map(|k| all.get(*method, *k)).collect();
        let mut row = named(results, *method, has);
        row.extend(seeds.then(|| found[0].0.seeds.len().to_string()));
        let most = found.iter().map(|(samples, _)| samples.n()).max().unwrap_or(0);
        row.push(most.to_string());
        row.extend(fails.then(|| results.failure_count(*method).to_string()));
        for ((samples, estimate), k) in found.iter().zip(&columns) {
            let text = cell(&metrics[*k], *estimate, samples.deviation());
            // Where less was measured than in another column, the number says so.
            let of = if samples.n() < most { format!(" ({})", samples.n()) } else { String::new() };
            row.push(text + &of);
        }
        let known = &results.keys[*method].knows;
        row.extend(knows.then(|| if known.is_empty() { "-".to_owned() } else { known.clone() }));
        row
    };
    let mut title = study.report.titles.get(&subject).cloned().unwrap_or_else(|| subject.title().to_owned());
    if [Subject::Trajectory, Subject::AttackedDrive].contains(&subject) && !study.selection.is_empty() {
        title = format!("{}. Selection: `{}`.", title.trim_end_matches([':', '.']), study.selection);
    }
    let published = match &study.report.published {
        Some(name) => published(name)?,
        None => Vec::new(),
    };
    let mut rows = Vec::with_capacity(methods.len());
    for method in &methods {
        rows.push(row(method));
        let key = &results.keys[*method];
        if let Some(theirs) = published.iter().find(|row| row.is_of(key)) {
            let mut cells = vec![String::new(); heads.len()];
            cells[0] = "*paper*".to_owned();
            let first = heads.len() - columns.len() - usize::from(knows);
            for (place, k) in columns.iter().enumerate() {
                let scale = if metrics[*k].head().ends_with('%') { 100.0 } else { 1.0 };
                cells[first + place] = theirs.cell(&metrics[*k].name, scale);
            }
            rows.push(cells);
        }
    }
    Ok(Some(Table { title, heads, rows, names }))
}

/// Prefix of the metrics that count types of collisions.
const TYPE: &str = "type: ";

/// Numbers of scenes with each type of collision.
fn types(results: &Results) -> Option<Table> {
    let subject = Subject::Trajectory;
    let metrics = results.metrics_of(subject);
    let types: Vec<usize> = (0..metrics.len()).filter(|k| metrics[*k].name.starts_with(TYPE)).collect();
    if types.is_empty() {
        return None;
    }
    let methods = results.methods(subject);
    let has = name_columns(results, &methods);
    let mut heads = has.of("arm".to_owned(), "generator".to_owned());
    let names = heads.len();
    heads.extend(types.iter().map(|k| metrics[*k].name[TYPE.len()..].to_owned()));
    heads.push("none".to_owned());
    let row = |method: &usize| {
        let samples: Vec<_> = types.iter().map(|k| results.samples(*method, *k)).collect();
        let count = |of: &Samples| of.seeds.iter().flatten().filter(|[sum, _]| *sum > 0.0).count();
        let counts: Vec<usize> = samples.iter().map(count).collect();
        let none = samples[0].n().saturating_sub(counts.iter().sum());
        let counts = counts.into_iter().chain([none]).map(|n| n.to_string());
        named(results, *method, has).into_iter().chain(counts).collect()
    };
    let title = "Collision types of feasible attacks, scenes:".to_owned();
    Some(Table { title, heads, rows: methods.iter().map(row).collect(), names })
}

/// What the columns mean, each once: head and words.
fn words(study: &Study, results: &Results) -> Vec<(String, String)> {
    let mut told: Vec<(String, String)> = Vec::new();
    for subject in Subject::ALL {
        let shown = study.report.columns.get(&subject);
        for metric in results.metrics_of(subject) {
            let is_shown = shown.is_none_or(|names| names.contains(&metric.name));
            let words = format!("*{}*: {}. ", metric.name, metric.summary);
            let is_told = told.iter().any(|(_, known)| *known == words);
            if is_shown && !metric.summary.is_empty() && !is_told {
                told.push((metric.head(), words));
            }
        }
    }
    told
}

/// How the intervals were made.
fn intervals(results: &Results) -> &'static str {
    let seeds: BTreeSet<Option<u64>> = results.keys.iter().map(|key| key.training_seed).collect();
    if seeds.len() > 1 { INTERVALS_OF_SEEDS } else { INTERVALS }
}

const INTERVALS_OF_SEEDS: &str = "Brackets: 95 % intervals: for means and shares over several training seeds from the components of variance of seeds and scenes, for shares with one seed Wilson's, for all other values bootstrapped. Differences are paired by scene, and by seed where both methods have the same seeds. N: scenes or vehicles in which something was measured; in parentheses, where it is less for a column.\n";
const INTERVALS: &str = "Brackets: 95 % intervals, Wilson's for shares of scenes, bootstrap over scenes for other values; differences are paired by scene. N: scenes or vehicles in which something was measured; in parentheses, where it is less for a column.\n";

/// `estimates.csv`: one row per method and metric.
fn estimates(results: &Results, all: &Estimates) -> String {
    let heads =
        ["subject", "arm", "attack", "metric", "unit", "value", "low", "high", "n", "deviation over seeds"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    for subject in Subject::ALL {
        for method in results.methods(subject) {
            let key = &results.keys[method];
            for (k, metric) in results.metrics_of(subject).iter().enumerate() {
                let (samples, Some(e)) = all.get(method, k) else { continue };
                let deviation = samples.deviation().map_or(String::new(), |d| d.to_string());
                rows.push(vec![
                    subject.name().to_owned(),
                    key.arm.clone(),
                    key.attack_label(),
                    metric.name.clone(),
                    metric.unit.clone(),
                    e.value.to_string(),
                    e.low.to_string(),
                    e.high.to_string(),
                    e.n.to_string(),
                    deviation,
                ]);
            }
        }
    }
    csv(rows)
}
