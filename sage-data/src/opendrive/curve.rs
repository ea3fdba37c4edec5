//! Pieces of a reference line: straight lines and cubic curves (ASAM OpenDRIVE 1.7, 7.3 to 7.6).

use sage_core::geometry::{Point, distance, sub, wrap_angle};

use super::{CURVE, center_line::COORDINATE};
use crate::xml::{Xml, rounded};

/// Largest angle between the chord and a heading at which a piece is a straight line, radians.
const STRAIGHT: f64 = 1e-7;

/// Straight lines whose headings differ by less have one direction, radians. ASAM's checker takes 1e-6.
const SAME_DIRECTION: f64 = 2e-6;

/// Largest change of a length by halving its interval, metres.
const ACCURACY: f64 = 1e-7;
/// Largest number of times that an interval is halved.
const HALVINGS: usize = 20;

/// Nodes and weights of Gauss's quadrature with twelve points on [−1, 1], for positive nodes.
const QUADRATURE: [[f64; 2]; 6] = [
    [0.125_233_408_511_468_9, 0.249_147_045_813_402_8],
    [0.367_831_498_998_180_2, 0.233_492_536_538_354_8],
    [0.587_317_954_286_617_4, 0.203_167_426_723_065_9],
    [0.769_902_674_194_304_7, 0.160_078_328_543_346_2],
    [0.904_117_256_370_474_9, 0.106_939_325_995_318_4],
    [0.981_560_634_246_719_3, 0.047_175_336_386_511_83],
];

/// One piece, with all numbers as the file writes them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    start: Point,
    heading: f64,
    /// Arc length, metres.
    pub(super) length: f64,
    /// `bU cU dU cV dV` of a cubic curve; aU, aV and bV are 0. None for a straight line.
    cubic: Option<[f64; 5]>,
}

impl Piece {
    /// The piece between two points with a heading at each: straight, or the cubic Hermite curve whose speed
    /// at both ends is the chord.
    pub(super) fn between(start: Point, end: Point, headings: [f64; 2]) -> Self {
        let chord = sub(end, start);
        let (bearing, span) = (chord[1].atan2(chord[0]), distance(start, end));
        if headings.iter().all(|heading| wrap_angle(heading - bearing).abs() < STRAIGHT) {
            let (heading, length) = (rounded(bearing, CURVE), rounded(span, CURVE));
            return Self { start, heading, length, cubic: None };
        }
        let [heading, end_heading] = headings.map(|heading| rounded(wrap_angle(heading), CURVE));
        let (sin, cos) = heading.sin_cos();
        let [u, v] = [chord[0] * cos + chord[1] * sin, chord[1] * cos - chord[0] * sin];
        let (turn_sin, turn_cos) = (end_heading - heading).sin_cos();
        let [du, dv] = [span * turn_cos, span * turn_sin];
        let cubic = [span, 3.0 * u - 2.0 * span - du, span + du - 2.0 * u, 3.0 * v - dv, dv - 2.0 * v]
            .map(|coefficient| rounded(coefficient, CURVE));
        Self { start, heading, length: rounded(arc_length(&cubic), CURVE), cubic: Some(cubic) }
    }

    /// The straight line from the start of this one to the end of the next, if both are straight lines of one direction.
    pub(super) fn extended_by(&self, next: &Self, end: Point) -> Option<Self> {
        let is_straight = self.cubic.is_none() && next.cubic.is_none();
        let is_one = is_straight && wrap_angle(next.heading - self.heading).abs() < SAME_DIRECTION;
        let chord = sub(end, self.start);
        let bearing = chord[1].atan2(chord[0]);
        is_one.then(|| Self::between(self.start, end, [bearing; 2]))
    }

    /// Place at a share of the piece's parameter, 0 to 1.
    pub(super) fn at(&self, p: f64) -> Point {
        let [b_u, c_u, d_u, c_v, d_v] = self.cubic.unwrap_or([self.length, 0.0, 0.0, 0.0, 0.0]);
        let [u, v] = [p * (b_u + p * (c_u + p * d_u)), p * p * (c_v + p * d_v)];
        let (sin, cos) = self.heading.sin_cos();
        [self.start[0] + u * cos - v * sin, self.start[1] + u * sin + v * cos]
    }

    /// Writes the piece at a distance along its road.
    pub(super) fn write(&self, xml: &mut Xml, s: f64) {
        xml.element("geometry", |xml| {
            xml.number("s", s, CURVE);
            xml.number("x", self.start[0], COORDINATE).number("y", self.start[1], COORDINATE);
            xml.number("hdg", self.heading, CURVE).number("length", self.length, CURVE);
            let Some([b_u, c_u, d_u, c_v, d_v]) = self.cubic else { return xml.element("line", |_| {}) };
            xml.element("paramPoly3", |xml| {
                xml.integer("aU", 0).number("bU", b_u, CURVE).number("cU", c_u, CURVE);
                xml.number("dU", d_u, CURVE).integer("aV", 0).integer("bV", 0);
                xml.number("cV", c_v, CURVE).number("dV", d_v, CURVE).text("pRange", "normalized");
            });
        });
    }
}

/// Integral of √(u′² + v′²) over [0, 1].
fn arc_length(cubic: &[f64; 5]) -> f64 {
    refined(cubic, [0.0, 1.0], quadrature(cubic, [0.0, 1.0]), HALVINGS)
}

/// The integral over an interval whose quadrature is `whole`. Where a curve turns back on itself, the speed
/// has a cusp, which needs shorter intervals.
fn refined(cubic: &[f64; 5], [from, to]: [f64; 2], whole: f64, halvings: usize) -> f64 {
    let middle = 0.5 * (from + to);
    let halves = [[from, middle], [middle, to]];
    let lengths = halves.map(|half| quadrature(cubic, half));
    let sum = lengths[0] + lengths[1];
    if halvings == 0 || (sum - whole).abs() < ACCURACY {
        return sum;
    }
    (0..2).map(|k| refined(cubic, halves[k], lengths[k], halvings - 1)).sum()
}

fn quadrature([b_u, c_u, d_u, c_v, d_v]: &[f64; 5], [from, to]: [f64; 2]) -> f64 {
    let (middle, reach) = (0.5 * (from + to), 0.5 * (to - from));
    let speed = |p: f64| {
        let u = b_u + p * (2.0 * c_u + 3.0 * p * d_u);
        let v = p * (2.0 * c_v + 3.0 * p * d_v);
        (u * u + v * v).sqrt()
    };
    let pair =
        |[node, weight]: &[f64; 2]| weight * (speed(middle - reach * node) + speed(middle + reach * node));
    reach * QUADRATURE.iter().map(pair).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn a_quarter_of_a_circle_has_nearly_its_length() {
        // The Hermite curve with the chord as speed is 2 % shorter than the arc of 15.708 m.
        let piece = Piece::between([0.0, 0.0], [10.0, 10.0], [0.0, FRAC_PI_2]);
        assert!((piece.length - 10.0 * FRAC_PI_2).abs() < 0.35, "{}", piece.length);
        let fine: f64 = {
            let at = |p: f64| piece.at(p);
            assert!(distance(at(1.0), [10.0, 10.0]) < 1e-8);
            (0..100_000).map(|k| distance(at(f64::from(k) * 1e-5), at(f64::from(k + 1) * 1e-5))).sum()
        };
        assert!((piece.length - fine).abs() < 1e-6, "{} {fine}", piece.length);
    }

    #[test]
    fn a_curve_with_a_cusp_has_its_length() {
        // Back to nearly where it starts: u' changes sign, and v is small.
        let piece = Piece::between([0.0, 0.0], [10.0, 1e-4], [0.0, std::f64::consts::PI]);
        let at = |p: f64| piece.at(p);
        let fine: f64 =
            (0..100_000).map(|k| distance(at(f64::from(k) * 1e-5), at(f64::from(k + 1) * 1e-5))).sum();
        assert!((piece.length - fine).abs() < 1e-5, "{} {fine}", piece.length);
    }

    #[test]
    fn equal_headings_along_the_chord_give_a_straight_line() {
        let piece = Piece::between([1.0, 1.0], [4.0, 5.0], [4f64.atan2(3.0); 2]);
        assert_eq!((piece.length, piece.cubic), (5.0, None));
    }
}
