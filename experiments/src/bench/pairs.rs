//! Comparison of generators with two baselines, paired by scene: the prior and random goals under the same
//! selection.

use std::{collections::HashMap, fmt::Write as _};

use anyhow::Result;
use sage_core::{
    seed::Rng,
    statistics::{self, Estimate},
};

use super::{
    open_loop::{SceneRow, is_attack, is_believable},
    open_loop_report::Table,
};
use crate::operating_point::RowKey;

/// Generators with which the others are compared.
pub(super) const BASELINES: [&str; 2] = ["prior", "random"];
/// Resamples of an interval.
const RESAMPLES: usize = 2000;

type Holds = fn(&SceneRow) -> bool;

/// What is counted.
const MEASURES: [(&str, Holds); 2] = [("attack", is_attack), ("believable", is_believable)];

/// Wins and losses of a generator against another one.
#[derive(Debug, PartialEq)]
pub(super) struct Pairing {
    won: usize,
    lost: usize,
    /// Mean difference over the common scenes with its 95 % interval.
    difference: Option<Estimate>,
}

/// Appends the comparison with each baseline in the table. A baseline has the same operating point and
/// options, or the same operating point, or the largest μ.
pub(super) fn write(out: &mut String, table: &Table) -> Result<()> {
    for baseline in BASELINES {
        let others: Vec<(&RowKey, &Vec<SceneRow>)> = table
            .rows
            .iter()
            .filter(|(key, ..)| key.method == baseline && key.point.is_some())
            .map(|(key, _, rows)| (key, rows))
            .collect();
        let mu = |key: &RowKey| key.point.as_ref().map_or(0.0, |point| point.mu);
        let Some(largest_mu) = others.iter().max_by(|a, b| mu(a.0).total_cmp(&mu(b.0))) else { continue };
        writeln!(out, "\nPaired by scene with `{baseline}` under the same selection:\n")?;
        let heads = MEASURES.map(|(name, _)| format!("{name}: only this | only the other | difference"));
        writeln!(out, "| generator | against | {} |", heads.join(" | "))?;
        writeln!(out, "| --- | --- |{}", " --- | --- | --- |".repeat(MEASURES.len()))?;
        for (key, _, rows) in table.rows.iter().filter(|(key, ..)| key.method != baseline) {
            let same_point = || others.iter().filter(|(other, _)| other.point == key.point);
            let same = same_point().find(|(other, _)| other.options == key.options);
            let (against, other) = same.or_else(|| same_point().next()).unwrap_or(largest_mu);
            let cells = MEASURES.map(|(name, holds)| cell(&pairing(rows, other, name, holds)));
            writeln!(out, "| {} | {} | {} |", key.label(), against.label(), cells.join(" | "))?;
        }
    }
    Ok(())
}

fn pairing(rows: &[SceneRow], other: &[SceneRow], name: &str, holds: Holds) -> Pairing {
    let other: HashMap<&str, bool> = other.iter().map(|row| (&row.scene[..], holds(row))).collect();
    let pairs = rows.iter().filter_map(|row| Some((holds(row), *other.get(&row.scene[..])?)));
    let differences: Vec<f64> = pairs.map(|(a, b)| f64::from(i8::from(a) - i8::from(b))).collect();
    compare(&differences, name)
}

/// Wins, losses and the mean of differences of −1, 0 or 1.
pub(super) fn compare(differences: &[f64], name: &str) -> Pairing {
    let count = |value: f64| differences.iter().filter(|d| **d == value).count();
    let mut rng = Rng::new(0, name, "pairs");
    let difference = statistics::bootstrap_mean(differences, RESAMPLES, &mut rng);
    Pairing { won: count(1.0), lost: count(-1.0), difference }
}

pub(super) fn cell(pairing: &Pairing) -> String {
    let Pairing { won, lost, difference } = pairing;
    let difference = difference.map_or("-".to_owned(), |e| {
        format!("{:+.1} [{:+.1}, {:+.1}] points", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high)
    });
    format!("{won} | {lost} | {difference}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wins_and_losses_give_the_difference_and_its_interval() {
        let differences = [1.0, 1.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let found = compare(&differences, "attack");
        let difference = found.difference.unwrap();
        assert_eq!((found.won, found.lost, difference.value), (3, 1, 0.2));
        assert!(difference.low < 0.0 && difference.high > 0.3);
        assert!(cell(&found).starts_with("3 | 1 | +20.0 ["));
        assert_eq!(compare(&[], "attack").difference, None);
    }
}
