//! The table at the end of a run: how often each operating point attacks, and why it does not.

use sage_bench::table::Table;

use super::found_row::FoundRow;
use crate::selection_outcome::SelectionOutcome;

/// Attacks of a run at one operating point.
#[derive(Default)]
struct Tally<'r> {
    rows: Vec<&'r FoundRow>,
}

impl Tally<'_> {
    fn count(&self, is: impl Fn(&FoundRow) -> bool) -> usize {
        self.rows.iter().filter(|row| is(row)).count()
    }

    /// A number with its share of the scenes.
    fn share(&self, is: impl Fn(&FoundRow) -> bool) -> String {
        let count = self.count(is);
        format!("{count} ({:.0} %)", 100.0 * count as f64 / self.rows.len().max(1) as f64)
    }

    /// Avoidable attacks, of those in which the question arises.
    fn avoidable(&self) -> String {
        let is_attack = |row: &FoundRow| row.outcome.is_attack();
        let avoidable =
            |row: &FoundRow, is: bool| is_attack(row) && row.scores.avoidable.avoidable == Some(is);
        let (yes, no) = (self.count(|row| avoidable(row, true)), self.count(|row| avoidable(row, false)));
        if yes + no == 0 { "-".to_owned() } else { format!("{yes} of {}", yes + no) }
    }

    /// The most frequent reason of not having a believable attack.
    fn most_frequent_reason(&self) -> String {
        const REASONS: [(SelectionOutcome, &str); 5] = [
            (SelectionOutcome::NotBelievable, "not believable"),
            (SelectionOutcome::NoFeasiblePlan, "no candidate is feasible"),
            (SelectionOutcome::NeverHit, "none touches the ego"),
            (SelectionOutcome::NoFeasibleHit, "those that hit are infeasible"),
            (SelectionOutcome::NotPreferred, "a miss is preferred"),
        ];
        let counted = REASONS.map(|(reason, words)| (self.count(|row| row.outcome == reason), words));
        // Of equal counts the first is taken.
        let most = counted.into_iter().rev().max_by_key(|(count, _)| *count);
        match most.filter(|(count, _)| *count > 0) {
            Some((count, words)) => format!("{words} ({count})"),
            None => "-".to_owned(),
        }
    }
}

/// The table of a run's rows; `variants` are its operating points.
pub(super) fn table<'r>(variants: &[String], rows: impl Iterator<Item = &'r FoundRow>) -> Table {
    let rows: Vec<&FoundRow> = rows.collect();
    let heads = ["attack", "scenes", "attacked", "believable", "avoidable", "why not, most often"];
    let mut table = Table { names: 1, ..Table::new("", &heads) };
    for variant in variants {
        let tally = Tally { rows: rows.iter().copied().filter(|row| row.variant == *variant).collect() };
        table.row(
            variant,
            [
                tally.rows.len().to_string(),
                tally.share(|row| row.outcome.is_attack()),
                tally.share(|row| row.outcome == SelectionOutcome::Attack),
                tally.avoidable(),
                tally.most_frequent_reason(),
            ],
        );
    }
    table
}
