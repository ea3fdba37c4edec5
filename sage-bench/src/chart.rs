//! Charts as SVG.

pub mod bar;
pub mod heat_map;
pub mod learning;
pub mod line;
pub mod triangle;

/// A number of an axis: as short as it is exact to three decimals, and never `-0`.
pub(crate) fn tick(x: &f64) -> String {
    let rounded = (x * 1e3).round() / 1e3;
    if rounded == 0.0 { "0".to_owned() } else { rounded.to_string() }
}
