//! Plans of a search or a rate, or candidates of a selection, by what came of them, the worst in front.

use sage_core::geometry::Point;

use super::{palette as color, svg::Svg, viewport::Viewport};

/// Radii of the largest and the smallest dot, pixels.
const LARGEST: f64 = 9.0;
const SMALLEST: f64 = 1.0;

/// What came of a drive against a plan, or what a candidate would do. Later ones are drawn in front.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outcome {
    /// No drive was made.
    NotDriven,
    /// The driver touched nobody.
    NoContact,
    /// A contact that is no attack.
    OtherContact,
    /// An attack that misses a clause.
    Attack,
    /// A failure of the driver.
    Failure,
}

impl Outcome {
    pub(super) const ALL: [Self; 5] =
        [Self::NotDriven, Self::NoContact, Self::OtherContact, Self::Attack, Self::Failure];

    /// Words of the legend of a search.
    pub fn words(self) -> &'static str {
        match self {
            Self::NotDriven => "not driven",
            Self::NoContact => "no contact",
            Self::OtherContact => "contact, no attack",
            Self::Attack => "attack, not all clauses",
            Self::Failure => "failure",
        }
    }

    /// Colour, width in pixels and opacity of its lines.
    fn stroke(self) -> (&'static str, f64, f64) {
        match self {
            Self::NotDriven => (color::GROUND, 1.2, 0.9),
            Self::NoContact => (color::OTHER_PLAN, 1.2, 0.55),
            Self::OtherContact => (color::PEDESTRIAN, 1.4, 0.75),
            Self::Attack => (color::ALMOST, 1.6, 0.8),
            Self::Failure => (color::FAILURE, 2.0, 0.9),
        }
    }

    /// Draws a dot in its colour, in pixels; its area is a share of the largest.
    pub(super) fn dot(self, svg: &mut Svg, at: Point, share: f64) {
        let tone = self.stroke().0;
        let attributes =
            format!(r#"fill="{tone}" fill-opacity="0.8" stroke="{}" stroke-width="0.4""#, color::INK);
        svg.circle(at, (LARGEST * share.sqrt()).max(SMALLEST), &attributes);
    }

    /// Draws a line in its colour, in pixels.
    pub(super) fn line(self, svg: &mut Svg, pixels: Vec<Point>) {
        let (tone, width, opacity) = self.stroke();
        let attributes = format!(
            r#"fill="none" stroke="{tone}" stroke-width="{width}" stroke-opacity="{opacity}" stroke-linejoin="round""#
        );
        svg.lines(&[pixels], &attributes);
    }
}

/// A plan that a driver drove against, or may.
pub struct Tried {
    /// Positions of the adversary from *now* to the contact, or to the end of the plan.
    pub points: Vec<Point>,
    /// Share of the largest probability, for a dot at the end of the plan whose area shows it. There is no line then, but of a plan
    /// with a contact.
    pub dot: Option<f64>,
    /// What came of it.
    pub outcome: Outcome,
    /// What came of it, as the legend says it.
    pub words: &'static str,
    /// Centres of ego and adversary at the contact of a failure.
    pub contact: Option<[Point; 2]>,
}

/// Draws all plans, and a dot at each contact of a failure.
pub(super) fn draw(svg: &mut Svg, viewport: &Viewport, all: &[Tried]) {
    for outcome in Outcome::ALL {
        for tried in all.iter().filter(|tried| tried.outcome == outcome) {
            if tried.dot.is_none() || tried.contact.is_some() {
                outcome.line(svg, tried.points.iter().map(|p| viewport.pixel(*p)).collect());
            }
            if let (Some(share), Some(end)) = (tried.dot, tried.points.last()) {
                outcome.dot(svg, viewport.pixel(*end), share);
            }
        }
    }
    for [ego, adversary] in all.iter().filter_map(|tried| tried.contact) {
        let middle = [0.5 * (ego[0] + adversary[0]), 0.5 * (ego[1] + adversary[1])];
        let attributes = format!(r#"fill="{}" stroke="{}" stroke-width="1""#, color::CONTACT, color::INK);
        svg.circle(viewport.pixel(middle), 3.4, &attributes);
    }
}
