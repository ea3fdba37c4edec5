//! Figures of a report, as data.

/// A chart of lines and points.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// What the figure shows, in one line.
    pub title: String,
    /// Names of both axes.
    pub axes: [String; 2],
    /// Whether an axis is logarithmic; values that have no logarithm are not drawn.
    pub is_log: [bool; 2],
    /// What is drawn.
    pub series: Vec<Series>,
}

/// A named line or a named set of points.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Points in the order of the line.
    pub points: Vec<[f64; 2]>,
    /// Whether the points are joined by a line.
    pub is_line: bool,
}

impl Figure {
    /// A chart on even axes.
    pub fn new(title: &str, axes: [&str; 2], series: Vec<Series>) -> Self {
        Self { title: title.to_owned(), axes: axes.map(str::to_owned), is_log: [false; 2], series }
    }

    /// The same on logarithmic axes.
    #[must_use]
    pub fn logarithmic(self, is_log: [bool; 2]) -> Self {
        Self { is_log, ..self }
    }
}

impl Series {
    /// A line through points.
    pub fn line(name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), points, is_line: true }
    }

    /// Points without a line.
    pub fn points(name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), points, is_line: false }
    }
}
