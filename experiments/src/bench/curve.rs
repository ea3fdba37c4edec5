//! Training curves as CSV and as a picture.

use std::fmt::Write as _;

use anyhow::{Result, anyhow};
use plotters::prelude::*;
use sage_backbones::training::EpochRow;

use crate::output::Folder;

/// Size of the picture, pixels.
const SIZE: (u32, u32) = (720, 360);

/// Writes `curve.csv` and `curve.svg` into a folder.
///
/// *Errors*: the folder cannot be written to.
pub(crate) fn write(folder: &Folder, rows: &[EpochRow]) -> Result<()> {
    let mut csv = "epoch,steps,goal_loss,trajectory_loss,gradient,rate,min_fde6_m,nll,seconds\n".to_owned();
    for r in rows {
        writeln!(
            csv,
            "{},{},{},{},{},{},{},{},{:.1}",
            r.epoch, r.steps, r.goal, r.trajectory, r.gradient, r.rate, r.min_fde6, r.nll, r.seconds
        )?;
    }
    folder.write("curve.csv", csv.as_bytes())?;
    let picture = draw(rows).map_err(|e| anyhow!("the curve cannot be drawn: {e}"))?;
    folder.write("curve.svg", picture.as_bytes())
}

fn draw(rows: &[EpochRow]) -> Result<String, Box<dyn std::error::Error>> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let (left, right) = root.split_horizontally(SIZE.0 / 2);
        let nll = |r: &EpochRow| r.nll;
        panel(&left, "loss over goals (training)", rows, |r| r.goal, Some(("nll (validation)", nll)))?;
        panel(&right, "minFDE6, m (validation)", rows, |r| r.min_fde6, None)?;
        root.present()?;
    }
    Ok(svg)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Curve = fn(&EpochRow) -> f64;

fn panel(
    area: &Area,
    title: &str,
    rows: &[EpochRow],
    curve: Curve,
    other: Option<(&str, Curve)>,
) -> Result<(), Box<dyn std::error::Error + 'static>> {
    let curves: Vec<(&str, Curve, RGBColor)> = std::iter::once((title, curve, RGBColor(31, 119, 180)))
        .chain(other.map(|(t, c)| (t, c, RGBColor(214, 39, 40))))
        .collect();
    let values = curves.iter().flat_map(|(_, curve, _)| rows.iter().map(curve)).filter(|v| v.is_finite());
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    let (low, high) = if low < high { (low, high) } else { (low.min(0.0), low.min(0.0) + 1.0) };
    let (low, high) = if low.is_finite() { (low, high) } else { (0.0, 1.0) };
    let margin = 0.08 * (high - low);
    let last = rows.last().map_or(1.0, |r| f64::from(r.epoch)).max(2.0);
    let mut chart = ChartBuilder::on(area)
        .margin(10)
        .x_label_area_size(34)
        .y_label_area_size(46)
        .caption(title, ("sans-serif", 15))
        .build_cartesian_2d(1.0..last, low - margin..high + margin)?;
    chart.configure_mesh().x_desc("epoch").light_line_style(WHITE).draw()?;
    for (name, curve, color) in &curves {
        let points = rows.iter().map(|r| (f64::from(r.epoch), curve(r)));
        let color = *color;
        let series = chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
        series
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2)));
    }
    if curves.len() > 1 {
        let corner = SeriesLabelPosition::UpperRight;
        chart.configure_series_labels().position(corner).background_style(WHITE.mix(0.8)).draw()?;
    }
    Ok(())
}
