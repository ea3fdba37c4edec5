//! What the reports of a training run show of its episodes: metrics of episodes, in a fixed order, then registered ones.

use anyhow::Result;
use sage_core::metric::{Metric, Metrics};
use sage_sim::{evaluation::EpisodeRow, metrics::episode_metrics};

pub(super) const COMPLETION: &str = "completion";
pub(super) const CONTACT: &str = "contact";
pub(super) const OFF_ROAD: &str = "off road";
/// Names of all columns.
const NAMES: [&str; 14] = [
    "reward",
    "cost",
    COMPLETION,
    "completion recorded",
    CONTACT,
    "at fault",
    "adversary",
    OFF_ROAD,
    "arrived",
    "time limit",
    "failed",
    "speed",
    "jerk",
    "standing",
];

/// The columns.
pub(super) struct Columns(Vec<Metric<EpisodeRow>>);

impl Columns {
    /// All columns: those above, then registered metrics that are not built in.
    ///
    /// *Errors*: a built-in column that is not registered.
    pub(super) fn new(registered: &Metrics<EpisodeRow>) -> Result<Self> {
        let built_in = episode_metrics()?;
        let is_own = |metric: &&Metric<EpisodeRow>| {
            built_in.all().iter().all(|known| known.info.name != metric.info.name)
        };
        let own = registered.all().iter().filter(is_own).map(|metric| metric.info.name.to_string());
        let names: Vec<String> = NAMES.map(str::to_owned).into_iter().chain(own).collect();
        Ok(Self(registered.by_names(&names)?))
    }

    /// Names, as heads of CSV and keys of JSON.
    pub(super) fn names(&self) -> Vec<String> {
        self.0.iter().map(|metric| metric.info.name.replace(' ', "_")).collect()
    }

    /// Values of an episode as cells of CSV; empty where not measured.
    pub(super) fn cells(&self, row: &EpisodeRow) -> Vec<String> {
        self.0.iter().map(|metric| text(metric.value(row))).collect()
    }

    /// Means of some episodes.
    pub(super) fn means(&self, rows: &[EpisodeRow]) -> Vec<Option<f64>> {
        self.0.iter().map(|metric| mean(metric, rows)).collect()
    }

    /// Mean of a column; 0 without any steps, `None` if it is measured in none of the episodes.
    pub(super) fn mean(&self, name: &str, rows: &[EpisodeRow]) -> Option<f64> {
        self.0.iter().find(|metric| metric.info.name == name).and_then(|metric| mean(metric, rows))
    }
}

/// A number as a cell of CSV; empty for none.
pub(super) fn text(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// Longer episodes weigh more in a mean over steps.
fn mean(metric: &Metric<EpisodeRow>, rows: &[EpisodeRow]) -> Option<f64> {
    let is_unmeasured = !rows.is_empty() && rows.iter().all(|row| metric.value(row).is_none());
    let [sum, weight] = rows.iter().fold([0.0; 2], |[sum, all], row| match metric.value(row) {
        Some(value) => {
            let weight = if metric.info.weight.is_some() { row.steps as f64 } else { 1.0 };
            [sum + weight * value, all + weight]
        }
        None => [sum, all],
    });
    (!is_unmeasured).then(|| if weight > 0.0 { sum / weight } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_over_steps_weigh_by_steps() {
        let columns = Columns::new(&episode_metrics().unwrap()).unwrap();
        let row = |steps, speed, off_road| EpisodeRow { steps, speed, off_road, ..EpisodeRow::default() };
        let rows = [row(10, 2.0, None), row(30, 6.0, Some(true))];
        // (20 + 180)/40, and the mean over the episode in which it is measured.
        assert_eq!((columns.mean("speed", &rows), columns.mean(OFF_ROAD, &rows)), (Some(5.0), Some(1.0)));
        assert_eq!((columns.mean(OFF_ROAD, &rows[..1]), columns.mean("speed", &[])), (None, Some(0.0)));
        assert_eq!(columns.names()[3], "completion_recorded");
    }
}
