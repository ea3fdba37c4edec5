//! The training curves of several variants as charts: a line for each expert.

use anyhow::{Context as _, Result};
use sage_bench::chart::line::{self, Line};
use sage_core::text::table::Table;

/// File, column of `finetune.csv`, and name of the axis.
const CHARTS: [(&str, &str, &str); 4] = [
    ("loss.svg", "loss", "loss"),
    ("reward.svg", "best_reward", "best R_adv among the feasible candidates"),
    ("feasible.svg", "feasible", "feasible share of the candidates"),
    ("pairs.svg", "pairs", "pairs a scene"),
];

/// All charts as file names and contents, from the table of `finetune.csv`.
///
/// *Errors*: a table without a column of the charts, or the drawing library's.
pub(super) fn draw(table: &Table) -> Result<Vec<(&'static str, String)>> {
    let column = |name: &str| {
        let place = table.heads.iter().position(|head| head == name);
        place.with_context(|| format!("finetune.csv has no column `{name}`"))
    };
    let (expert, epoch) = (column("expert")?, column("epoch")?);
    let chart = |(file, name, axis): (&'static str, &str, &str)| {
        let value = column(name)?;
        let mut drawn: Vec<Line> = Vec::new();
        for row in &table.rows {
            let number = |k: usize| row.get(k).and_then(|text| text.parse::<f64>().ok());
            let (Some(name), Some(x), Some(y)) = (row.get(expert), number(epoch), number(value)) else {
                continue;
            };
            match drawn.iter_mut().find(|(known, _)| known == name) {
                Some((_, points)) => points.push([x, y]),
                None => drawn.push((name.clone(), vec![[x, y]])),
            }
        }
        Ok((file, line::draw(["epoch", axis], drawn)?))
    };
    CHARTS.into_iter().map(chart).collect()
}
