//! What an evaluation in closed loop reports of its episodes.

use sage_sim::rl::EpisodeRow;

/// A column: name, value of an episode, and the weight of an episode in the mean.
#[derive(Clone, Copy)]
pub(crate) struct Column {
    pub(crate) name: &'static str,
    /// `None` if it was not measured.
    pub(crate) value: fn(&EpisodeRow) -> Option<f64>,
    weight: fn(&EpisodeRow) -> f64,
}

const fn per_episode(name: &'static str, value: fn(&EpisodeRow) -> Option<f64>) -> Column {
    Column { name, value, weight: |_| 1.0 }
}

/// A mean over steps: longer episodes weigh more.
const fn per_step(name: &'static str, value: fn(&EpisodeRow) -> Option<f64>) -> Column {
    Column { name, value, weight: |row| row.steps as f64 }
}

pub(crate) const REWARD: Column = per_episode("reward", |r| Some(r.reward));
pub(crate) const COST: Column = per_episode("cost", |r| Some(r.cost));
pub(crate) const COMPLETION: Column = per_episode("completion", |r| Some(r.completion));
pub(crate) const CONTACT: Column = per_episode("contact", |r| flag(r.contact));
pub(crate) const AT_FAULT: Column = per_episode("at_fault", |r| flag(r.at_fault));
pub(crate) const OFF_ROAD: Column = per_episode("off_road", |r| flag(r.off_road?));
pub(crate) const SPEED: Column = per_step("speed", |r| Some(r.speed));
pub(crate) const JERK: Column = per_step("jerk", |r| Some(r.jerk));

/// All columns.
pub(crate) const COLUMNS: [Column; 13] = [
    REWARD,
    COST,
    COMPLETION,
    per_episode("completion_recorded", |r| Some(r.completion_recorded)),
    CONTACT,
    AT_FAULT,
    per_episode("adversary", |r| flag(r.adversary)),
    OFF_ROAD,
    per_episode("arrived", |r| flag(r.arrived)),
    per_episode("time_limit", |r| flag(r.time_limit)),
    per_episode("failed", |r| flag(r.failed.is_some())),
    SPEED,
    JERK,
];

fn flag(is: bool) -> Option<f64> {
    Some(f64::from(u8::from(is)))
}

/// The names of all columns, as the end of a line of CSV.
pub(crate) fn csv_names() -> String {
    COLUMNS.iter().map(|column| format!(",{}", column.name)).collect()
}

/// The values of all columns, as the end of a line of CSV. What is not measured is empty.
pub(crate) fn csv_values(value: impl Fn(&Column) -> Option<f64>) -> String {
    let text = |column| value(column).map_or(String::new(), |value| value.to_string());
    COLUMNS.iter().map(|column| format!(",{}", text(column))).collect()
}

/// One episode as the end of a line of CSV: its scene, its steps, all columns.
pub(crate) fn csv_episode(row: &EpisodeRow, names: &[String]) -> String {
    let scene = names.get(row.scene).map_or("unknown", String::as_str).replace('"', "'");
    format!("\"{scene}\",{}{}\n", row.steps, csv_values(|column| (column.value)(row)))
}

impl Column {
    /// Weighted value and weight of some episodes. Episodes in which it is not measured have no weight.
    pub(crate) fn sums<'a>(&self, rows: impl IntoIterator<Item = &'a EpisodeRow>) -> [f64; 2] {
        rows.into_iter().fold([0.0; 2], |[sum, all], row| match (self.value)(row) {
            Some(value) => {
                let weight = (self.weight)(row);
                [sum + weight * value, all + weight]
            }
            None => [sum, all],
        })
    }

    /// Mean of some episodes; 0 without any steps, `None` if it is measured in none of them.
    pub(crate) fn mean<'a>(&self, rows: impl IntoIterator<Item = &'a EpisodeRow> + Clone) -> Option<f64> {
        let mut measured = rows.clone().into_iter().map(self.value);
        let is_unmeasured =
            measured.next().is_some_and(|first| first.is_none() && measured.all(|v| v.is_none()));
        let [sum, weight] = self.sums(rows);
        (!is_unmeasured).then(|| if weight > 0.0 { sum / weight } else { 0.0 })
    }
}
