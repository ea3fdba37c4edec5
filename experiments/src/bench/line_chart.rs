//! Charts of several lines through measured points.

use anyhow::{Result, anyhow};
use plotters::prelude::*;

/// Size of a picture, pixels.
const SIZE: (u32, u32) = (760, 520);
/// Colours of the lines, in their order; they repeat.
const COLORS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(90, 90, 90),
    RGBColor(148, 103, 189),
];

/// Draws named lines.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn draw([x, y]: [&str; 2], lines: &[(String, Vec<[f64; 2]>)]) -> Result<String> {
    let mut svg = String::new();
    plot(&mut svg, [x, y], lines).map_err(|e| anyhow!("the chart cannot be drawn: {e}"))?;
    Ok(svg)
}

/// Range of a coordinate with a margin.
fn range(lines: &[(String, Vec<[f64; 2]>)], axis: usize) -> std::ops::Range<f64> {
    let all = || lines.iter().flat_map(|(_, points)| points).map(|p| p[axis]).filter(|x| x.is_finite());
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    if low > high {
        return 0.0..1.0;
    }
    let margin = 0.05 * (high - low).max(1e-6);
    low - margin..high + margin
}

fn plot(
    svg: &mut String,
    [x, y]: [&str; 2],
    lines: &[(String, Vec<[f64; 2]>)],
) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(56)
        .build_cartesian_2d(range(lines, 0), range(lines, 1))?;
    chart
        .configure_mesh()
        .x_desc(x)
        .y_desc(y)
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 15))
        .light_line_style(WHITE)
        .draw()?;
    // A line without points keeps its colour for other charts.
    for ((name, points), color) in
        lines.iter().zip(COLORS.iter().cycle()).filter(|(line, _)| !line.1.is_empty())
    {
        let points: Vec<(f64, f64)> = points.iter().map(|[x, y]| (*x, *y)).collect();
        chart
            .draw_series(LineSeries::new(points.clone(), color.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
        chart.draw_series(points.into_iter().map(|point| Circle::new(point, 2, color.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .label_font(("sans-serif", 13))
        .background_style(WHITE.mix(0.8))
        .draw()?;
    root.present()?;
    Ok(())
}
