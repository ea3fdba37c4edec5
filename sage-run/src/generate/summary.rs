//! The table at the end of a run: how often each operating point attacks, and why it does not.

use advsage::{
    operating_point::OperatingPointSpec,
    rows::attack::{AttackRow, is_prevented},
};
use sage_core::{selection_outcome::SelectionOutcome, text::table::Table};

use super::job::Job;

/// Outcomes with the reason that the table gives for them, the first where two are as frequent.
const REASONS: [(SelectionOutcome, &str); 5] = [
    (SelectionOutcome::NotBelievable, "not believable"),
    (SelectionOutcome::NoFeasiblePlan, "none feasible"),
    (SelectionOutcome::NeverHit, "none touches the ego"),
    (SelectionOutcome::NoFeasibleHit, "hits are infeasible"),
    (SelectionOutcome::NotPreferred, "a miss rates higher"),
];

/// Numbers of scenes at one operating point.
#[derive(Clone, Default)]
pub(super) struct Tally {
    scenes: usize,
    believable: usize,
    /// By reason, in the order of [`REASONS`].
    without: [usize; REASONS.len()],
    /// Attacks whose answer is yes, and those with an answer.
    avoidable: [usize; 2],
    prevented_by_r157: [usize; 2],
}

impl Tally {
    pub(super) fn add(&mut self, row: &AttackRow) {
        self.scenes += 1;
        match REASONS.iter().position(|(outcome, _)| *outcome == row.outcome) {
            Some(reason) => self.without[reason] += 1,
            None => self.believable += 1,
        }
        if row.outcome.is_attack() {
            count(&mut self.avoidable, row.scores.avoidable.avoidable);
            count(&mut self.prevented_by_r157, is_prevented(&row.scores.references));
        }
    }

    /// The numbers of both.
    pub(super) fn and(self, other: &Self) -> Self {
        let sum = |a: [usize; 2], b: [usize; 2]| [a[0] + b[0], a[1] + b[1]];
        Self {
            scenes: self.scenes + other.scenes,
            believable: self.believable + other.believable,
            without: std::array::from_fn(|k| self.without[k] + other.without[k]),
            avoidable: sum(self.avoidable, other.avoidable),
            prevented_by_r157: sum(self.prevented_by_r157, other.prevented_by_r157),
        }
    }

    /// Scenes with an attack, believable or not.
    fn attacked(&self) -> usize {
        self.believable + self.without[0]
    }

    /// A number with its share of the scenes.
    fn share(&self, count: usize) -> String {
        format!("{count} ({:.0} %)", 100.0 * count as f64 / self.scenes.max(1) as f64)
    }

    /// The most frequent reason of not having a believable attack.
    fn most_frequent_reason(&self) -> String {
        // Of equal counts `max_by_key` takes the last.
        let most = (0..REASONS.len()).rev().max_by_key(|reason| self.without[*reason]).unwrap_or_default();
        match self.without[most] {
            0 => "-".to_owned(),
            count => format!("{} ({count})", REASONS[most].1),
        }
    }
}

fn count([yes, all]: &mut [usize; 2], answer: Option<bool>) {
    *yes += usize::from(answer == Some(true));
    *all += usize::from(answer.is_some());
}

fn of([yes, all]: [usize; 2]) -> String {
    if all == 0 { "-".to_owned() } else { format!("{yes} of {all}") }
}

/// The table of a run; `tallies` are those of its operating points.
pub(super) fn table(job: &Job, tallies: &[Tally]) -> Table {
    let (axis, names) = operating_points(job);
    let heads = [&*axis, "scenes", "attacked", "believable", "avoidable", "by R157", "why not, most often"];
    let mut table = Table { names: 1, ..Table::new("", &heads) };
    for (tally, name) in tallies.iter().zip(names) {
        table.row(
            name,
            [
                tally.scenes.to_string(),
                tally.share(tally.attacked()),
                tally.share(tally.believable),
                of(tally.avoidable),
                of(tally.prevented_by_r157),
                tally.most_frequent_reason(),
            ],
        );
    }
    table
}

/// What differs between the operating points, and the name of each.
fn operating_points(job: &Job) -> (String, Vec<String>) {
    let points = &job.generator.points;
    let uses_point = job.generator.built.facts.uses_operating_point();
    let is_one_number =
        |point: &OperatingPointSpec| point.aggression.is_some() || point.lambda == Some(point.mu);
    match points[0].swept().filter(|_| uses_point && points.iter().all(is_one_number)) {
        Some((axis, _)) => {
            let value = |point: &OperatingPointSpec| point.label().trim_start_matches("a ").to_owned();
            (axis.replace("lambda", "λ"), points.iter().map(value).collect())
        }
        None => ("attack".to_owned(), job.variants().to_vec()),
    }
}
