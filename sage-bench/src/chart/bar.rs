//! Horizontal bars of two values for each of many names.

use std::fmt::Write as _;

use sage_core::text::escaped_html;

/// Height of a row, width of a letter of the names and of the longest bar, pixels.
const ROW: usize = 26;
const LETTER: usize = 8;
const BARS: usize = 380;
/// Colours of the two values, those of the first lines of a line chart.
const COLORS: [&str; 2] = ["#0072b2", "#d55e00"];

/// Draws the bars of shares from 0 to 1; `names` are those of the two values.
pub fn draw(names: [&str; 2], rows: &[(&str, [f64; 2])]) -> String {
    let height = ROW * (rows.len() + 2);
    let left = LETTER * rows.iter().map(|row| row.0.len()).max().unwrap_or(0) + 16;
    let width = left + BARS + 80;
    let most = rows.iter().flat_map(|row| row.1).filter(|x| x.is_finite()).fold(1e-12, f64::max);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    for (k, (name, color)) in names.iter().zip(COLORS).enumerate() {
        let x = left + 200 * k;
        // Writing to a string cannot fail.
        let _ = writeln!(
            svg,
            "<rect x=\"{x}\" y=\"9\" width=\"12\" height=\"10\" fill=\"{color}\"/><text x=\"{}\" y=\"19\">{}</text>",
            x + 18,
            escaped_html(name)
        );
    }
    for (k, (name, values)) in rows.iter().enumerate() {
        let y = ROW * (k + 1) + 8;
        let _ = writeln!(
            svg,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>",
            left - 8,
            y + 15,
            escaped_html(name)
        );
        for (j, (value, color)) in values.iter().zip(COLORS).enumerate() {
            let length = if value.is_finite() { BARS as f64 * value / most } else { 0.0 };
            let _ = writeln!(
                svg,
                "<rect x=\"{left}\" y=\"{}\" width=\"{length:.1}\" height=\"9\" fill=\"{color}\"/>\
                 <text x=\"{:.1}\" y=\"{}\" font-size=\"10\">{:.1} %</text>",
                y + 10 * j,
                left as f64 + length + 5.0,
                y + 10 * j + 8,
                100.0 * value
            );
        }
    }
    svg += "</svg>\n";
    svg
}
