//! The table at the end of a run: how often each operating point attacks, and why it does not.

use sage_bench::table::Table;

use super::{found_row::FoundRow, plan::Plan};
use crate::{operating_point::OperatingPointSpec, selection_outcome::SelectionOutcome};

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

    /// Attacks whose answer is yes, of those with one.
    fn answered(&self, answer: impl Fn(&FoundRow) -> Option<bool>) -> String {
        let is = |row: &FoundRow, wanted: bool| row.outcome.is_attack() && answer(row) == Some(wanted);
        let (yes, no) = (self.count(|row| is(row, true)), self.count(|row| is(row, false)));
        if yes + no == 0 { "-".to_owned() } else { format!("{yes} of {}", yes + no) }
    }

    /// The most frequent reason of not having a believable attack.
    fn most_frequent_reason(&self) -> String {
        const REASONS: [(SelectionOutcome, &str); 5] = [
            (SelectionOutcome::NotBelievable, "not believable"),
            (SelectionOutcome::NoFeasiblePlan, "none feasible"),
            (SelectionOutcome::NeverHit, "none touches the ego"),
            (SelectionOutcome::NoFeasibleHit, "hits are infeasible"),
            (SelectionOutcome::NotPreferred, "a miss rates higher"),
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

/// The table of a run's rows at the operating points of a plan.
pub(super) fn table<'r>(plan: &Plan, rows: impl Iterator<Item = &'r FoundRow>) -> Table {
    let rows: Vec<&FoundRow> = rows.collect();
    let (axis, names) = operating_points(plan);
    let heads = [&*axis, "scenes", "attacked", "believable", "avoidable", "by R157", "why not, most often"];
    let mut table = Table { names: 1, ..Table::new("", &heads) };
    for (variant, name) in plan.variants().iter().zip(names) {
        let tally = Tally { rows: rows.iter().copied().filter(|row| row.variant == *variant).collect() };
        table.row(
            name,
            [
                tally.rows.len().to_string(),
                tally.share(|row| row.outcome.is_attack()),
                tally.share(|row| row.outcome == SelectionOutcome::Attack),
                tally.answered(|row| row.scores.avoidable.avoidable),
                tally.answered(|row| row.scores.r157_avoids),
                tally.most_frequent_reason(),
            ],
        );
    }
    table
}

/// What differs between the operating points, and the name of each.
fn operating_points(plan: &Plan) -> (String, Vec<String>) {
    let points = &plan.generator.points;
    let swept: Option<Vec<(&str, f64)>> = points.iter().map(OperatingPointSpec::swept).collect();
    let follows_lambda =
        |point: &OperatingPointSpec| point.aggression.is_some() || point.lambda == Some(point.mu);
    match swept.as_deref() {
        Some([(axis, _), ..])
            if plan.generator.built.facts.uses_operating_point() && points.iter().all(follows_lambda) =>
        {
            (
                axis.replace("lambda", "λ"),
                points.iter().map(|point| point.label().replace("a ", "")).collect(),
            )
        }
        _ => ("attack".to_owned(), plan.variants().to_vec()),
    }
}
