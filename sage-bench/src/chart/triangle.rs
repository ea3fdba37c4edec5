//! Values over the mixtures of three experts: a triangle of coloured cells, an expert at each corner.

use plotters::prelude::*;

use super::heat_map::colour;
use crate::{Error, Result};

/// Width of one triangle and height of the picture, pixels.
const WIDTH: u32 = 380;
const HEIGHT: u32 = 400;
/// Height of an equilateral triangle of side 1.
const RISE: f64 = 0.866_025_403_784_438_6;

/// A value at each mixture.
pub struct Triangle<'a> {
    /// Title.
    pub title: &'a str,
    /// In the order of the mixtures.
    pub values: Vec<f64>,
}

/// Mixtures of three experts whose weights are multiples of `1 / steps`, row by row.
pub fn mixtures(steps: u32) -> Vec<[f64; 3]> {
    let share = |k: u32| f64::from(k) / f64::from(steps);
    let row = |third: u32| {
        (0..=steps - third).map(move |second| [share(steps - third - second), share(second), share(third)])
    };
    (0..=steps).flat_map(row).collect()
}

/// Draws triangles side by side; `corners` are the names of the experts.
///
/// *Errors*: those of the drawing library.
pub fn draw(corners: [&str; 3], steps: u32, triangles: &[Triangle]) -> Result<String> {
    let mut svg = String::new();
    plot(&mut svg, corners, steps, triangles)
        .map_err(|e| Error::Value(format!("the triangles cannot be drawn: {e}")))?;
    Ok(svg)
}

/// Position of a mixture: the first expert at the lower left, the second at the lower right, the third on top.
fn position([_, second, third]: [f64; 3]) -> (f64, f64) {
    (second + 0.5 * third, RISE * third)
}

fn plot(
    svg: &mut String,
    corners: [&str; 3],
    steps: u32,
    triangles: &[Triangle],
) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, (WIDTH * triangles.len() as u32, HEIGHT)).into_drawing_area();
    root.fill(&WHITE)?;
    let centres = mixtures(steps);
    // Cells are the hexagons of the lattice.
    let radius = 1.0 / (3f64.sqrt() * f64::from(steps));
    for (area, triangle) in root.split_evenly((1, triangles.len())).iter().zip(triangles) {
        let finite = || triangle.values.iter().copied().filter(|x| x.is_finite());
        let low = finite().fold(f64::INFINITY, f64::min);
        let high = finite().fold(f64::NEG_INFINITY, f64::max);
        let caption = format!("{}: {low:.2} (dark) to {high:.2} (bright)", triangle.title);
        let mut chart = ChartBuilder::on(area)
            .caption(caption, ("sans-serif", 15))
            .margin(8)
            .build_cartesian_2d(-0.16..1.16, -0.26..1.12)?;
        let cells = centres.iter().zip(&triangle.values).map(|(mixture, value)| {
            let (x, y) = position(*mixture);
            let corner = |k: u32| {
                let angle = std::f64::consts::FRAC_PI_6 + std::f64::consts::FRAC_PI_3 * f64::from(k);
                (x + radius * angle.cos(), y + radius * angle.sin())
            };
            let share = (value - low) / (high - low).max(1e-12);
            Polygon::new((0..6).map(corner).collect::<Vec<_>>(), colour(share).filled())
        });
        chart.draw_series(cells)?;
        let names = corners.iter().zip([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        for (name, corner) in names {
            let (x, y) = position(corner);
            let y = if y > 0.0 { y + 1.9 * radius + 0.02 } else { y - 1.5 * radius - 0.02 };
            let style = ("sans-serif", 14).into_font().color(&BLACK);
            let width = 0.011 * name.len() as f64;
            chart.draw_series([Text::new((*name).to_owned(), (x - width, y), style)])?;
        }
    }
    root.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mixtures_are_the_lattice_of_the_simplex() {
        let all = mixtures(4);
        assert_eq!(all.len(), 15);
        assert_eq!((all[0], all[4], all[14]), ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]));
        assert!(all.iter().all(|weights| (weights.iter().sum::<f64>() - 1.0).abs() < 1e-12));
        let picture = draw(["a", "b", "c"], 4, &[Triangle { title: "t", values: vec![0.0; 15] }]);
        assert!(picture.unwrap().contains("polygon"));
    }
}
