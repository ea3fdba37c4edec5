//! A value over the plane of two coordinates as coloured cells, with marked points.

use crate::{Error, Result};
use plotters::prelude::*;

/// Size of a picture, pixels.
const SIZE: (u32, u32) = (640, 560);
/// Colours from the least to the greatest value, also of different lightness.
const RAMP: [[u8; 3]; 5] = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

/// Cells of a square grid, row by row of the second coordinate, and the coordinates of both axes.
pub struct Grid<'a> {
    /// Title.
    pub title: &'a str,
    /// Names of the axes.
    pub axes: [&'a str; 2],
    /// Coordinates along both axes.
    pub at: &'a [f64],
    /// Values, row by row.
    pub values: Vec<f64>,
    /// Named points.
    pub marks: &'a [(&'a str, [f64; 2])],
}

/// Draws the grid.
///
/// *Errors*: those of the drawing library.
pub fn draw(grid: &Grid) -> Result<String> {
    let mut svg = String::new();
    plot(&mut svg, grid).map_err(|e| Error::Value(format!("the map cannot be drawn: {e}")))?;
    Ok(svg)
}

pub(crate) fn colour(share: f64) -> RGBColor {
    let position = share.clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
    let low = (position.floor() as usize).min(RAMP.len() - 2);
    let part = position - low as f64;
    let mix = |k: usize| {
        let (a, b) = (f64::from(RAMP[low][k]), f64::from(RAMP[low + 1][k]));
        (a + (b - a) * part).round() as u8
    };
    RGBColor(mix(0), mix(1), mix(2))
}

fn plot(svg: &mut String, grid: &Grid) -> Result<(), Box<dyn std::error::Error>> {
    let (Some(first), Some(last)) = (grid.at.first(), grid.at.last()) else { return Ok(()) };
    let half = 0.5 * (last - first) / (grid.at.len().max(2) - 1) as f64;
    let finite = || grid.values.iter().copied().filter(|x| x.is_finite());
    let (low, high) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let range = first - half..last + half;
    let mut chart = ChartBuilder::on(&root)
        .caption(format!("{}: {low:.2} (dark) to {high:.2} (bright)", grid.title), ("sans-serif", 16))
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(56)
        .build_cartesian_2d(range.clone(), range)?;
    let [x, y] = grid.axes;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_desc(x)
        .y_desc(y)
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 15))
        .draw()?;
    let cells = grid.values.iter().enumerate().map(|(k, value)| {
        let (x, y) = (grid.at[k % grid.at.len()], grid.at[k / grid.at.len()]);
        let share = (value - low) / (high - low).max(1e-12);
        Rectangle::new([(x - half, y - half), (x + half, y + half)], colour(share).filled())
    });
    chart.draw_series(cells)?;
    chart.draw_series(LineSeries::new([(0.0, 1.0), (1.0, 0.0)], WHITE.stroke_width(2)))?;
    for (name, [x, y]) in grid.marks {
        chart.draw_series([Circle::new((*x, *y), 5, WHITE.filled())])?;
        chart.draw_series([Circle::new((*x, *y), 5, BLACK.stroke_width(1))])?;
        let style = ("sans-serif", 14).into_font().color(&WHITE);
        chart.draw_series([Text::new((*name).to_owned(), (x + 0.6 * half, y + 1.4 * half), style)])?;
    }
    root.present()?;
    Ok(())
}
