//! Figures as SVG.

use anyhow::Result;
use theory_checks::Figure;

use sage_bench::chart::line::{Chart, Legend, Line};

/// Draws a figure.
///
/// *Errors*: those of the drawing library.
pub(super) fn draw(figure: &Figure) -> Result<String> {
    let [x, y] = &figure.axes;
    let of = |is_line: bool| -> Vec<Line> {
        let series = figure.series.iter().filter(|series| series.is_line == is_line);
        series.map(|series| (series.name.clone(), series.points.clone())).collect()
    };
    let chart = Chart {
        axes: [x, y],
        lines: of(true),
        dots: of(false),
        is_log: figure.is_log,
        legend: if is_low_right(figure) { Legend::UpperRight } else { Legend::LowerRight },
        ..Chart::default()
    };
    Ok(chart.draw()?)
}

/// Whether more points are at the lower right of a figure than at the upper right, where the legend then is.
fn is_low_right(figure: &Figure) -> bool {
    let place = |point: &[f64; 2]| [0, 1].map(|k| if figure.is_log[k] { point[k].log10() } else { point[k] });
    let points = figure.series.iter().flat_map(|series| &series.points).map(place);
    let points: Vec<[f64; 2]> = points.filter(|point| point.iter().all(|x| x.is_finite())).collect();
    let ranges = [0, 1].map(|k| {
        let values = points.iter().map(|point| point[k]);
        (values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max))
    });
    let shares = points.iter().map(|point| {
        [0, 1].map(|k| {
            let (low, high) = ranges[k];
            (point[k] - low) / (high - low)
        })
    });
    let right: Vec<f64> = shares.filter(|[x, _]| *x > 0.7).map(|[_, y]| y).collect();
    right.iter().filter(|y| **y < 0.25).count() > right.iter().filter(|y| **y > 0.75).count()
}
