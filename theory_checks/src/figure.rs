//! Figures of a report, as data.

use serde::Serialize;

/// A chart of lines or points.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// What the figure shows, in one line.
    pub title: String,
    /// Names of both axes.
    pub axes: [String; 2],
    /// Whether an axis is logarithmic.
    pub is_log: [bool; 2],
    /// Whether points are joined by lines.
    pub is_joined: bool,
    /// Names and points of the series.
    pub series: Vec<(String, Vec<[f64; 2]>)>,
}

impl Figure {
    /// A chart of lines on even axes.
    pub fn lines(title: &str, axes: [&str; 2], series: Vec<(String, Vec<[f64; 2]>)>) -> Self {
        let axes = axes.map(str::to_owned);
        Self { title: title.to_owned(), axes, is_log: [false; 2], is_joined: true, series }
    }

    /// The same on logarithmic axes; points that have no logarithm are not drawn.
    #[must_use]
    pub fn logarithmic(self, is_log: [bool; 2]) -> Self {
        Self { is_log, ..self }
    }

    /// The same as points that are not joined.
    #[must_use]
    pub fn scattered(self) -> Self {
        Self { is_joined: false, ..self }
    }
}
