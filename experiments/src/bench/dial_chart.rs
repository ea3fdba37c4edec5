//! Chart of the rate of attacks over the aggression.

use anyhow::{Result, anyhow};
use plotters::prelude::*;
use sage_generators::Rate;

/// Size of the picture, pixels.
const SIZE: (u32, u32) = (640, 400);
/// Colours of the lines, in their order.
const COLORS: [RGBColor; 4] =
    [RGBColor(31, 119, 180), RGBColor(214, 39, 40), RGBColor(44, 160, 44), RGBColor(148, 103, 189)];

/// Rates at evenly spaced operating points from 0 to 1.
pub(crate) struct Line {
    pub(crate) name: &'static str,
    pub(crate) rates: Vec<f64>,
}

/// Draws the lines, and a dashed straight line between the ends of the first one.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn draw(rate: Rate, lines: &[Line]) -> Result<String> {
    let mut svg = String::new();
    plot(&mut svg, rate, lines).map_err(|e| anyhow!("the chart cannot be drawn: {e}"))?;
    Ok(svg)
}

fn plot(svg: &mut String, rate: Rate, lines: &[Line]) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..1.0, 0.0..100.0)?;
    chart
        .configure_mesh()
        .x_desc("aggression, or lambda = mu")
        .y_desc(match rate {
            Rate::Attack => "scenes attacked, %",
            Rate::Believable => "scenes attacked believably, %",
        })
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 15))
        .light_line_style(WHITE)
        .draw()?;
    if let Some([first, .., last]) = lines.first().map(|line| &line.rates[..]) {
        let ends = [(0.0, 100.0 * first), (1.0, 100.0 * last)];
        let grey = RGBColor(150, 150, 150);
        chart.draw_series(DashedLineSeries::new(ends, 5, 5, grey.stroke_width(1)))?;
    }
    for (line, color) in lines.iter().zip(COLORS) {
        let last = line.rates.len().saturating_sub(1).max(1) as f64;
        let points: Vec<(f64, f64)> =
            line.rates.iter().enumerate().map(|(k, rate)| (k as f64 / last, 100.0 * rate)).collect();
        chart
            .draw_series(LineSeries::new(points.clone(), color.stroke_width(2)))?
            .label(line.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
        chart.draw_series(points.into_iter().map(|point| Circle::new(point, 3, color.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .label_font(("sans-serif", 14))
        .background_style(WHITE.mix(0.8))
        .draw()?;
    root.present()?;
    Ok(())
}
