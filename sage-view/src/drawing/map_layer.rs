//! Draws the map: surfaces, road lines, edges, signs, lights.

use std::collections::BTreeSet;

use sage_core::{
    geometry::{Aabb, Point},
    scene::{LightState, MapFeature, MapKind, Scene},
};

use super::{palette as color, svg::Svg, viewport::Viewport};

/// Width of a lane without a width in the file, metres.
const LANE_WIDTH: f64 = 3.5;
/// Distance between chevrons along a lane, metres.
const CHEVRONS: f64 = 15.0;

/// Kinds of map features in the picture, for the legend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Shown {
    Lane,
    BikeLane,
    WhiteLine,
    YellowLine,
    Edge,
    Sidewalk,
    Median,
    Crosswalk,
    SpeedBump,
    Driveway,
    StopSign,
    LightStop,
    LightCaution,
    LightGo,
}

/// Draws the map at a frame.
pub(super) fn draw(svg: &mut Svg, viewport: &Viewport, scene: &Scene, frame: usize) -> BTreeSet<Shown> {
    let map = &scene.map;
    let mut shown = BTreeSet::new();
    let visible: Vec<&MapFeature> = map
        .features
        .iter()
        .filter(|f| viewport.shows(&Aabb::of(map.points_of(f).iter().map(|p| [p[0], p[1]]))))
        .collect();
    let points = |f: &MapFeature| map.points_of(f);
    let parts = |f: &MapFeature| viewport.parts(points(f));

    for feature in visible.iter().filter(|f| f.kind == MapKind::Driveway) {
        svg.polygon(&pixels(viewport, points(feature)), &format!(r#"fill="{}""#, color::DRIVEWAY));
        shown.insert(Shown::Driveway);
    }
    for feature in visible.iter().filter(|f| map.is_sidewalk_area(f)) {
        let attributes = format!(r#"fill="{}" fill-rule="nonzero""#, color::SIDEWALK);
        svg.polygon(&pixels(viewport, points(feature)), &attributes);
    }
    svg.open(r#"fill="none" stroke-linejoin="round" stroke-linecap="round""#);
    for bike in [true, false] {
        for feature in visible.iter().filter(|f| f.kind.is_lane() && (f.kind == MapKind::LaneBike) == bike) {
            let tone = if bike { color::BIKE_LANE } else { color::ASPHALT };
            let width = (lane_width(feature) * viewport.scale).max(1.0);
            svg.lines(&parts(feature), &format!(r#"stroke="{tone}" stroke-width="{width:.1}""#));
            shown.insert(if bike { Shown::BikeLane } else { Shown::Lane });
        }
    }
    svg.close();
    for feature in visible.iter().filter(|f| matches!(f.kind, MapKind::Crosswalk | MapKind::SpeedBump)) {
        let stripes = feature.kind == MapKind::Crosswalk;
        let pattern = if stripes { "stripes" } else { "bumps" };
        svg.polygon(&pixels(viewport, points(feature)), &format!(r#"fill="url(#{pattern})""#));
        shown.insert(if stripes { Shown::Crosswalk } else { Shown::SpeedBump });
    }
    chevrons(svg, viewport, &visible, points);
    svg.open(r#"fill="none" stroke-linejoin="round""#);
    for feature in &visible {
        if let MapKind::Line(name) = &feature.kind {
            shown.insert(paint(svg, viewport, name, &parts(feature)));
        }
    }
    for feature in visible.iter().filter(|f| f.kind.is_edge()) {
        let (tone, width, mark) = match feature.kind {
            MapKind::EdgeMedian => (color::MEDIAN, 2.0, Shown::Median),
            _ if map.is_sidewalk_area(feature) => (color::EDGE, 1.2, Shown::Sidewalk),
            _ => (color::EDGE, 2.2, Shown::Edge),
        };
        svg.lines(&parts(feature), &format!(r#"stroke="{tone}" stroke-width="{width}""#));
        shown.insert(mark);
    }
    svg.close();
    for feature in visible.iter().filter(|f| f.kind == MapKind::StopSign) {
        for p in pixels(viewport, points(feature)) {
            stop_sign(svg, p);
            shown.insert(Shown::StopSign);
        }
    }
    for light in &scene.lights {
        let Some([x, y, _]) = light.stop_point else { continue };
        let state = light.states.get(frame).copied().unwrap_or(LightState::Unknown);
        if viewport.shows(&Aabb::around([x, y], 0.0)) {
            shown.extend(traffic_light(svg, viewport.pixel([x, y]), state));
        }
    }
    shown
}

/// Fill patterns of map areas.
pub(super) fn patterns(scale: f64) -> String {
    let stripe = (1.0 * scale).max(3.0);
    format!(
        concat!(
            r#"<pattern id="stripes" width="{0:.1}" height="{0:.1}" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">"#,
            r#"<rect width="{0:.1}" height="{0:.1}" fill="{1}"/><rect width="{2:.1}" height="{0:.1}" fill="{3}"/></pattern>"#,
            r#"<pattern id="bumps" width="6" height="6" patternUnits="userSpaceOnUse">"#,
            r#"<circle cx="3" cy="3" r="1.6" fill="{4}"/></pattern>"#
        ),
        stripe,
        color::ASPHALT,
        0.5 * stripe,
        color::WHITE_PAINT,
        color::MEDIAN
    )
}

fn pixels(viewport: &Viewport, points: &[[f64; 3]]) -> Vec<Point> {
    points.iter().map(|p| viewport.pixel([p[0], p[1]])).collect()
}

/// Mean width of a lane, or the default width, metres.
pub fn lane_width(feature: &MapFeature) -> f64 {
    let widths = feature.lane.as_ref().map(|lane| &lane.width[..]).unwrap_or_default();
    let known: Vec<f64> = widths.iter().map(|[l, r]| l + r).filter(|w| *w > 1.0).collect();
    if known.is_empty() {
        LANE_WIDTH
    } else {
        (known.iter().sum::<f64>() / known.len() as f64).clamp(1.2, 7.0)
    }
}

/// Draws a road line by its name: yellow or white, solid or broken, single or double.
fn paint(svg: &mut Svg, viewport: &Viewport, name: &str, parts: &[Vec<Point>]) -> Shown {
    let yellow = name.contains("YELLOW");
    let tone = if yellow { color::YELLOW_PAINT } else { color::WHITE_PAINT };
    let dash = if name.contains("BROKEN") {
        format!(r#" stroke-dasharray="{:.1} {:.1}""#, 3.0 * viewport.scale, 3.0 * viewport.scale)
    } else {
        String::new()
    };
    let width = (0.15 * viewport.scale).clamp(1.0, 2.5);
    if name.contains("DOUBLE") {
        svg.lines(parts, &format!(r#"stroke="{tone}" stroke-width="{:.1}"{dash}"#, 3.0 * width));
        svg.lines(parts, &format!(r#"stroke="{}" stroke-width="{width:.1}""#, color::ASPHALT));
    } else {
        svg.lines(parts, &format!(r#"stroke="{tone}" stroke-width="{width:.1}"{dash}"#));
    }
    if yellow { Shown::YellowLine } else { Shown::WhiteLine }
}

/// Draws small arrow heads along lanes. Short lanes get none: in junctions they would overlap.
fn chevrons<'m>(
    svg: &mut Svg,
    viewport: &Viewport,
    visible: &[&'m MapFeature],
    points: impl Fn(&'m MapFeature) -> &'m [[f64; 3]],
) {
    let mut heads = Vec::new();
    let long = |f: &&&'m MapFeature| f.kind.is_motor_lane() && length(points(f)) > 2.0 * CHEVRONS;
    for feature in visible.iter().filter(long) {
        let mut left = 0.5 * CHEVRONS;
        for pair in points(feature).windows(2) {
            let d = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
            let length = d[0].hypot(d[1]);
            left -= length;
            if left > 0.0 || length == 0.0 {
                continue;
            }
            left += CHEVRONS;
            let [c, s] = [d[0] / length, d[1] / length];
            let at =
                |x: f64, y: f64| viewport.pixel([pair[1][0] + x * c - y * s, pair[1][1] + x * s + y * c]);
            if viewport.shows(&Aabb::around([pair[1][0], pair[1][1]], 1.0)) {
                heads.push(vec![at(-0.8, 0.6), at(0.0, 0.0), at(-0.8, -0.6)]);
            }
        }
    }
    svg.lines(&heads, &format!(r#"fill="none" stroke="{}" stroke-width="1.2""#, color::CHEVRON));
}

/// Length of a polyline in the plane, metres.
fn length(points: &[[f64; 3]]) -> f64 {
    points.windows(2).map(|p| (p[1][0] - p[0][0]).hypot(p[1][1] - p[0][1])).sum()
}

/// An octagon.
pub(super) fn stop_sign(svg: &mut Svg, [x, y]: Point) {
    let corner = |k: u32| {
        let a = (f64::from(k) + 0.5) * std::f64::consts::FRAC_PI_4;
        [x + 6.0 * a.cos(), y + 6.0 * a.sin()]
    };
    let corners: Vec<Point> = (0..8).map(corner).collect();
    svg.polygon(&corners, r##"fill="#a50f15" stroke="#fff" stroke-width="1.2""##);
}

/// Draws a light by colour and shape: square for stop, triangle for caution, circle for go.
pub(super) fn traffic_light(svg: &mut Svg, [x, y]: Point, state: LightState) -> Option<Shown> {
    let attributes = |tone: &str| format!(r#"fill="{tone}" stroke="{}" stroke-width="1""#, color::INK);
    match state {
        LightState::Stop | LightState::FlashingStop => {
            svg.rect([x - 4.0, y - 4.0], [8.0, 8.0], &attributes("#b2182b"));
            Some(Shown::LightStop)
        }
        LightState::Caution => {
            svg.polygon(&[[x, y - 5.0], [x + 5.0, y + 4.0], [x - 5.0, y + 4.0]], &attributes("#f0c800"));
            Some(Shown::LightCaution)
        }
        LightState::Go => {
            svg.circle([x, y], 4.5, &attributes("#4dc36b"));
            Some(Shown::LightGo)
        }
        LightState::Unknown => None,
    }
}
