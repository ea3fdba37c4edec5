//! Height of a road along its reference line: linear pieces (ASAM OpenDRIVE 1.7, 8.4).

use super::{CURVE, simplify};
use crate::xml::Xml;

/// Largest difference between a recorded height and the written one, metres.
const TOLERANCE: f64 = 0.02;
/// Slopes that differ by less are equal.
const SAME_SLOPE: f64 = 1e-6;

/// Writes the heights `z` at the distances `s`, which rise.
pub(super) fn write(xml: &mut Xml, heights: &[[f64; 2]]) {
    let kept = simplify::kept(heights.len(), TOLERANCE, |a, b, k| {
        let ([s, z], [end, end_z]) = (heights[a], heights[b]);
        (z + (heights[k][0] - s) / (end - s) * (end_z - z) - heights[k][1]).abs()
    });
    xml.element("elevationProfile", |xml| {
        let mut before: Option<f64> = None;
        for pair in kept.windows(2) {
            let ([s, z], [end, end_z]) = (heights[pair[0]], heights[pair[1]]);
            let slope = (end_z - z) / (end - s);
            // Two pieces with one slope are redundant.
            if before.is_none_or(|before| (slope - before).abs() > SAME_SLOPE) {
                xml.element("elevation", |xml| {
                    xml.number("s", s, CURVE).number("a", z, CURVE).number("b", slope, CURVE);
                    xml.integer("c", 0).integer("d", 0);
                });
                before = Some(slope);
            }
        }
    });
}
