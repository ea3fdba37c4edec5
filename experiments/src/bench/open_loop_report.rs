//! Reports of an open-loop run as Markdown and CSV.

use std::{collections::BTreeMap, fmt::Write as _};

use anyhow::Result;
use sage_backbones::training::Expectation;
use sage_core::{
    generator::{Knowledge, Note},
    objective::CollisionType,
    statistics::{self, Estimate},
};

use super::{
    open_loop::{self, Column, SceneRow, is_attack},
    pairs,
};
use crate::{operating_point::RowKey, terminal};

/// Content of a table: columns, and for each generator and operating point its knowledge and its rows.
pub(crate) struct Table {
    /// The driver whose drive was attacked; `None` for the recorded ego without drivers.
    pub ego: Option<String>,
    pub columns: Vec<Column>,
    pub rows: Vec<(RowKey, Knowledge, Vec<SceneRow>)>,
}

/// Policies by name with their expectations, one per scene.
pub type Policies = Vec<(String, Vec<Expectation>)>;

type Expected = fn(&Expectation) -> f64;

/// Values of an [`Expectation`] by name.
const EXPECTATIONS: [(&str, Expected); 5] = [
    ("feasible", |e| e.feasible),
    ("feasible hit", |e| e.attack),
    ("believable attack", |e| e.believable),
    ("R_adv", |e| e.reward),
    ("P_real", |e| e.penalty),
];

/// `table.md`.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn markdown(table: &Table, policies: &Policies) -> Result<String> {
    let mut out = String::new();
    let columns: Vec<&str> = table.columns.iter().map(|c| c.name).collect();
    writeln!(out, "| generator | N | {} | knows beyond now |", columns.join(" | "))?;
    writeln!(out, "| --- | --- | --- |{}", " --- |".repeat(columns.len()))?;
    for (key, knows, rows) in &table.rows {
        let cells: Vec<String> = table.columns.iter().map(|c| cell(open_loop::estimate(c, rows))).collect();
        let knows = if *knows == Knowledge::NOW { "-".to_owned() } else { knows.to_string() };
        writeln!(out, "| {} | {} | {} | {knows} |", key.label(), rows.len(), cells.join(" | "))?;
    }
    writeln!(out, "\nCollision types of feasible attacks, scenes:\n")?;
    writeln!(out, "| generator | {} | none |", CollisionType::ALL.map(CollisionType::name).join(" | "))?;
    writeln!(out, "| --- |{}", " --- |".repeat(CollisionType::ALL.len() + 1))?;
    for (key, _, rows) in &table.rows {
        let mut types: BTreeMap<CollisionType, usize> = BTreeMap::new();
        rows.iter()
            .filter(|r| is_attack(r))
            .filter_map(|r| r.collision_type)
            .for_each(|k| *types.entry(k).or_default() += 1);
        let counts = CollisionType::ALL.map(|t| types.get(&t).copied().unwrap_or(0));
        let none = rows.len() - counts.iter().sum::<usize>();
        let counts = counts.map(|n| n.to_string()).join(" | ");
        writeln!(out, "| {} | {counts} | {none} |", key.label())?;
    }
    if !policies.is_empty() {
        writeln!(out, "\nWithout selection, expectations under the policy:\n")?;
        writeln!(out, "| policy | N | {} |", EXPECTATIONS.map(|e| e.0).join(" | "))?;
        writeln!(out, "| --- | --- |{}", " --- |".repeat(EXPECTATIONS.len()))?;
        for (policy, all) in policies {
            let cells = EXPECTATIONS.map(|(_, value)| cell(open_loop::mean(all, value)));
            writeln!(out, "| {policy} | {} | {} |", all.len(), cells.join(" | "))?;
        }
    }
    pairs::write(&mut out, table)?;
    Ok(out)
}

/// `table.csv`: one row per generator and measure, and per driver if there are drivers.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn csv(tables: &[Table], policies: &Policies) -> Result<String> {
    let mut out = format!("{}generator,measure,value,low,high,n\n", ego_head(tables));
    let mut row = |ego: &str, method: &str, measure: &str, e: Option<Estimate>| -> Result<()> {
        let Some(e) = e else { return Ok(()) };
        let [method, measure] = [method, measure].map(field);
        Ok(writeln!(out, "{ego}{method},{measure},{},{},{},{}", e.value, e.low, e.high, e.n)?)
    };
    for table in tables {
        for (key, _, rows) in &table.rows {
            for column in &table.columns {
                row(&table.ego_cell(), &key.label(), column.name, open_loop::estimate(column, rows))?;
            }
        }
    }
    for (policy, all) in policies {
        for (name, value) in EXPECTATIONS {
            row("", policy, &format!("without selection: {name}"), open_loop::mean(all, value))?;
        }
    }
    Ok(out)
}

/// The head of the first column if there are drivers.
fn ego_head(tables: &[Table]) -> &'static str {
    if tables.iter().any(|table| table.ego.is_some()) { "ego," } else { "" }
}

impl Table {
    /// The first cell of a row if there are drivers.
    fn ego_cell(&self) -> String {
        self.ego.as_ref().map_or(String::new(), |ego| format!("{},", field(ego)))
    }
}

/// `scenes.csv`: one row per scene and generator, and per driver if there are drivers.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn scenes_csv(tables: &[Table]) -> Result<String> {
    let Some(Table { columns, .. }) = tables.first() else { return Ok(String::new()) };
    let names: Vec<String> = columns.iter().map(|c| field(c.name)).collect();
    let head = ego_head(tables);
    let mut out = format!(
        "{head}scene,generator,horizon,collision_type,collision_step,{},seconds,note\n",
        names.join(",")
    );
    let rows =
        tables.iter().flat_map(|table| table.rows.iter().map(move |(key, _, rows)| (table, key, rows)));
    for (table, key, rows) in rows {
        let ego = table.ego_cell();
        let method = key.label();
        for r in rows {
            let values = columns.iter().map(|c| c.of(r).map_or(String::new(), |v| v.to_string()));
            writeln!(
                out,
                "{ego}{},{},{},{},{},{},{:.6},{}",
                field(&terminal::escaped_name(&r.scene)),
                field(&method),
                r.paper.horizon,
                r.collision_type.map_or("", CollisionType::name),
                r.paper.collision_step.map_or(String::new(), |step| step.to_string()),
                values.collect::<Vec<_>>().join(","),
                r.seconds,
                field(&r.note.as_ref().map(Note::to_string).unwrap_or_default()),
            )?;
        }
    }
    Ok(out)
}

/// Median seconds of a generation.
pub fn seconds(rows: &[SceneRow]) -> f64 {
    statistics::median(&rows.iter().map(|r| r.seconds).collect::<Vec<_>>()).unwrap_or(0.0)
}

/// A text as a CSV field, quoted if necessary.
pub(super) fn field(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

fn cell(estimate: Option<Estimate>) -> String {
    estimate.map_or("-".to_owned(), |e| format!("{:.3} [{:.3}, {:.3}]", e.value, e.low, e.high))
}
