//! The training curve as CSV and as a picture.

use anyhow::Result;
use sage_backbones::training::EpochRow;
use sage_bench::{chart::line, csv_text::of_table};
use sage_core::text::table::Table;
use sage_run::output::Folder;

/// Columns of the table.
const HEADS: [&str; 9] =
    ["epoch", "steps", "goal_loss", "trajectory_loss", "gradient", "rate", "min_fde6_m", "nll", "seconds"];
type Value = fn(&EpochRow) -> f64;
/// Lines of the picture.
const LINES: [(&str, Value); 3] = [
    ("loss over goals (training)", |r| r.goal),
    ("nll (validation)", |r| r.nll),
    ("minFDE6, m (validation)", |r| r.min_fde6),
];

/// Writes `curve.csv` and `curve.svg` into a folder.
///
/// *Errors*: the folder cannot be written to.
pub(super) fn write(folder: &Folder, rows: &[EpochRow]) -> Result<()> {
    let mut table = Table::new("", &HEADS);
    for r in rows {
        let numbers = [r.goal, r.trajectory, r.gradient, r.rate, r.min_fde6, r.nll].map(|x| x.to_string());
        let cells = std::iter::once(r.steps.to_string()).chain(numbers).chain([format!("{:.1}", r.seconds)]);
        table.row(r.epoch.to_string(), cells);
    }
    folder.write("curve.csv", of_table(&table).as_bytes())?;
    let line = |(name, value): (&str, Value)| {
        let points = rows.iter().map(|r| [f64::from(r.epoch), value(r)]).filter(|[_, y]| y.is_finite());
        (name.to_owned(), points.collect())
    };
    let picture = line::draw(["epoch", "value"], LINES.map(line).to_vec())?;
    Ok(folder.write("curve.svg", picture.as_bytes())?)
}
