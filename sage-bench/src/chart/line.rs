//! Charts of several lines through measured points.

use std::ops::Range;

use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use super::tick;
use crate::{Error, Result};

/// Size of a picture, pixels.
const SIZE: (u32, u32) = (760, 520);
/// Colours of the lines, in their order; they repeat.
const COLORS: [RGBColor; 12] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(90, 90, 90),
    RGBColor(148, 103, 189),
    RGBColor(140, 86, 75),
    RGBColor(128, 128, 0),
    RGBColor(200, 30, 60),
    RGBColor(20, 20, 20),
];

/// A named line and its points.
pub type Line = (String, Vec<[f64; 2]>);

/// A corner for the legend.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Legend {
    /// At the lower right.
    #[default]
    LowerRight,
    /// At the upper right.
    UpperRight,
    /// At the upper left.
    UpperLeft,
}

/// A chart of lines.
#[derive(Default)]
pub struct Chart<'a> {
    /// Names of the axes.
    pub axes: [&'a str; 2],
    /// The lines.
    pub lines: Vec<Line>,
    /// Named sets of points that are not joined; their colours follow those of the lines.
    pub dots: Vec<Line>,
    /// Whether an axis is logarithmic; points that have no logarithm are left out.
    pub is_log: [bool; 2],
    /// Ranges of both axes; by default those of the points with a margin.
    pub ranges: Option<[Range<f64>; 2]>,
    /// Whether a unit has the same length on both axes, so that angles are true.
    pub is_isometric: bool,
    /// Ends of a dashed line.
    pub dashed: Option<[[f64; 2]; 2]>,
    /// Place of the legend.
    pub legend: Legend,
    /// Named points.
    pub marks: Vec<(String, [f64; 2])>,
    /// Small texts beside points, such as the operating points at the ends of a line.
    pub texts: Vec<(String, [f64; 2])>,
}

/// Draws named lines, with ranges that fit their points.
///
/// *Errors*: those of the drawing library.
///
/// ```
/// use sage_bench::chart::line::draw;
///
/// let line = ("idm".to_owned(), vec![[0.0, 0.1], [0.5, 0.2], [1.0, 0.6]]);
/// let svg = draw(["lambda", "attack rate"], vec![line])?;
/// assert!(svg.starts_with("<svg") && svg.contains("attack rate"));
/// # Ok::<(), sage_bench::Error>(())
/// ```
pub fn draw(axes: [&str; 2], lines: Vec<Line>) -> Result<String> {
    Chart { axes, lines, ..Chart::default() }.draw()
}

impl Chart<'_> {
    /// Draws the chart.
    ///
    /// *Errors*: those of the drawing library.
    pub fn draw(&self) -> Result<String> {
        let mut svg = String::new();
        let placed = |lines: &[Line]| lines.iter().map(|line| self.placed(line)).collect::<Vec<_>>();
        self.plot(&mut svg, &placed(&self.lines), &placed(&self.dots))
            .map_err(|e| Error::Value(format!("the chart cannot be drawn: {e}")))?;
        Ok(svg)
    }

    /// A line with the logarithms of its points on logarithmic axes.
    fn placed(&self, (name, points): &Line) -> Line {
        let place =
            |point: &[f64; 2]| [0, 1].map(|k| if self.is_log[k] { point[k].log10() } else { point[k] });
        let is_drawn = |point: &[f64; 2]| point.iter().all(|x| x.is_finite());
        (name.clone(), points.iter().map(place).filter(is_drawn).collect())
    }

    /// Range of points along an axis, with a margin.
    fn range(&self, lines: &[&Line], axis: usize) -> Range<f64> {
        let points = lines.iter().flat_map(|(_, points)| points).chain(self.marks.iter().map(|(_, p)| p));
        let all = || points.clone().map(|p| p[axis]).filter(|x| x.is_finite());
        let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
        if low > high {
            return 0.0..1.0;
        }
        let margin = 0.05 * (high - low).max(1e-6);
        low - margin..high + margin
    }

    fn ranges(&self, lines: &[&Line]) -> [Range<f64>; 2] {
        if let Some(ranges) = &self.ranges {
            return ranges.clone();
        }
        let [x, y] = [0, 1].map(|axis| self.range(lines, axis));
        if !self.is_isometric {
            return [x, y];
        }
        let wide = f64::from(SIZE.0) / f64::from(SIZE.1);
        let height = (y.end - y.start).max((x.end - x.start) / wide);
        let around = |range: &Range<f64>, length: f64| {
            let middle = 0.5 * (range.start + range.end);
            middle - 0.5 * length..middle + 0.5 * length
        };
        [around(&x, height * wide), around(&y, height)]
    }

    fn plot(
        &self,
        svg: &mut String,
        lines: &[Line],
        dots: &[Line],
    ) -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let [xs, ys] = self.ranges(&lines.iter().chain(dots).collect::<Vec<_>>());
        let mut chart = ChartBuilder::on(&root)
            .margin(12)
            .x_label_area_size(42)
            .y_label_area_size(56)
            .build_cartesian_2d(xs.clone(), ys.clone())?;
        let [x, y] = self.axes;
        let mut mesh = chart.configure_mesh();
        // Numbers that are easy to read are written out, to two digits.
        let power = |x: &f64| match 10f64.powf(*x) {
            x if (0.99..9.95).contains(&x) => tick(&((10.0 * x).round() / 10.0)),
            x if (9.95..1000.0).contains(&x) => format!("{x:.0}"),
            x => format!("{x:.1e}"),
        };
        let plain = |x: &f64| tick(x);
        let formatter = |is_log: bool| -> &dyn Fn(&f64) -> String { if is_log { &power } else { &plain } };
        mesh.x_label_formatter(formatter(self.is_log[0])).y_label_formatter(formatter(self.is_log[1]));
        mesh.x_desc(x)
            .y_desc(y)
            .label_style(("sans-serif", 14))
            .axis_desc_style(("sans-serif", 15))
            .light_line_style(WHITE)
            .draw()?;
        if let Some(ends) = self.dashed {
            let grey = RGBColor(150, 150, 150);
            let ends = ends.map(|[x, y]| (x, y));
            chart.draw_series(DashedLineSeries::new(ends, 5, 5, grey.stroke_width(1)))?;
        }
        // A line without points keeps its colour for other charts.
        let drawn = lines.iter().zip(COLORS.iter().cycle());
        for ((name, points), color) in drawn.filter(|(line, _)| !line.1.is_empty()) {
            let points: Vec<(f64, f64)> = points.iter().map(|[x, y]| (*x, *y)).collect();
            chart
                .draw_series(LineSeries::new(points.clone(), color.stroke_width(2)))?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
            chart.draw_series(points.into_iter().map(|point| Circle::new(point, 2, color.filled())))?;
        }
        let drawn = dots.iter().zip(COLORS.iter().cycle().skip(lines.len()));
        for ((name, points), color) in drawn.filter(|(line, _)| !line.1.is_empty()) {
            let points = points.iter().map(|[x, y]| Circle::new((*x, *y), 2, color.mix(0.6).filled()));
            chart
                .draw_series(points)?
                .label(name)
                .legend(move |(x, y)| Circle::new((x + 9, y), 3, color.filled()));
        }
        let (dx, dy) = (0.012 * (xs.end - xs.start), 0.012 * (ys.end - ys.start));
        for (name, [x, y]) in &self.marks {
            chart.draw_series([Circle::new((*x, *y), 5, BLACK.filled())])?;
            let style = ("sans-serif", 14).into_font().color(&BLACK);
            // Near the right border the name is to the left.
            let is_right = *x > xs.start + 0.8 * (xs.end - xs.start);
            let (place, side) = if is_right { (x - dx, HPos::Right) } else { (x + dx, HPos::Left) };
            let style = style.pos(Pos::new(side, VPos::Top));
            chart.draw_series([Text::new(name.clone(), (place, y + 3.0 * dy), style)])?;
        }
        for (text, [x, y]) in &self.texts {
            let style = ("sans-serif", 11).into_font().color(&RGBColor(90, 90, 90));
            let style = style.pos(Pos::new(HPos::Center, VPos::Bottom));
            chart.draw_series([Text::new(text.clone(), (*x, y + dy), style)])?;
        }
        chart
            .configure_series_labels()
            .position(match self.legend {
                Legend::LowerRight => SeriesLabelPosition::LowerRight,
                Legend::UpperRight => SeriesLabelPosition::UpperRight,
                Legend::UpperLeft => SeriesLabelPosition::UpperLeft,
            })
            .label_font(("sans-serif", 13))
            .background_style(WHITE.mix(0.8))
            .draw()?;
        root.present()?;
        Ok(())
    }
}
