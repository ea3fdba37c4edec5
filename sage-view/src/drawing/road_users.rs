//! Draws road users and their trajectories.

use std::collections::BTreeSet;

use sage_core::{
    geometry::{Aabb, OrientedBox, Point},
    motion::{HORIZON, NOW},
    scene::{Scene, Track, TrackKind},
};

use super::{
    palette::{self as color, Ramp},
    svg::Svg,
    viewport::Viewport,
};

/// Number of marks for the ends of candidates. Marks are used instead of text on the road.
pub(super) const GLYPHS: usize = 6;

/// Draws the background agents at a frame, with a thin line along their logged future.
pub(super) fn background(
    svg: &mut Svg,
    viewport: &Viewport,
    scene: &Scene,
    frame: usize,
) -> BTreeSet<TrackKind> {
    let mut shown = BTreeSet::new();
    let others = || {
        let extra = |k: usize| k != scene.ego && Some(k) != scene.adversary;
        scene.tracks.iter().enumerate().filter(move |(k, _)| extra(*k)).map(|(_, track)| track)
    };
    svg.open(
        r##"fill="none" stroke="#7d8793" stroke-width="1" stroke-dasharray="1 3" stroke-linecap="round""##,
    );
    for track in others().filter(|track| track.is_valid(frame)) {
        let ahead: Vec<[f64; 3]> = (frame..track.valid.len().min(NOW + HORIZON + 1))
            .take_while(|&f| track.is_valid(f))
            .map(|f| track.position[f])
            .collect();
        svg.lines(&viewport.parts(&ahead), "");
    }
    svg.close();
    for track in others().filter(|track| track.is_valid(frame)) {
        let b = track.oriented_box(frame);
        if !viewport.shows(&b.aabb()) {
            continue;
        }
        user(svg, viewport, &track.kind, &b);
        shown.insert(track.kind.clone());
    }
    shown
}

/// Draws a background agent by its kind.
pub(super) fn user(svg: &mut Svg, viewport: &Viewport, kind: &TrackKind, b: &OrientedBox) {
    let tone = match kind {
        TrackKind::Vehicle => {
            let attributes = format!(r##"fill="{}" stroke="#555d66" stroke-width="1""##, color::VEHICLE);
            return svg.car(viewport, b, &attributes);
        }
        TrackKind::Pedestrian => color::PEDESTRIAN,
        TrackKind::Cyclist => color::CYCLIST,
        TrackKind::Other(_) => color::OTHER,
    };
    let attributes = format!(r#"fill="{tone}" stroke="{}" stroke-width="0.8""#, color::INK);
    // Small boxes would be invisible at this scale, so these agents get a mark.
    let [x, y] = viewport.pixel(b.center);
    match kind {
        TrackKind::Pedestrian => svg.circle([x, y], 4.0, &attributes),
        TrackKind::Cyclist => {
            let corners = b.corners().map(|p| viewport.pixel(p));
            svg.polygon(&corners, &attributes);
            svg.circle([x, y], 3.0, &attributes);
        }
        _ => svg.polygon(&[[x, y - 4.5], [x + 4.0, y + 3.0], [x - 4.0, y + 3.0]], &attributes),
    }
}

/// Ego or adversary. Without colour, stripes and diamonds on the trajectory identify the adversary.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// The car under test.
    Ego,
    /// The adversary.
    Adversary,
}

impl Role {
    fn tone(self) -> &'static str {
        match self {
            Self::Ego => color::EGO,
            Self::Adversary => color::ADVERSARY,
        }
    }

    pub(super) fn ramp(self) -> &'static Ramp {
        match self {
            Self::Ego => &color::EGO_TIME,
            Self::Adversary => &color::ADVERSARY_TIME,
        }
    }
}

/// Draws ego or adversary. In a wide viewport a ring makes the small box visible.
pub(super) fn role(svg: &mut Svg, viewport: &Viewport, b: &OrientedBox, role: Role) {
    let tone = role.tone();
    if 2.0 * b.half_length * viewport.scale < 20.0 {
        let ring = format!(r#"fill="none" stroke="{tone}" stroke-width="2.5""#);
        svg.circle(viewport.pixel(b.center), 14.0, &ring);
    }
    svg.car(viewport, b, &format!(r##"fill="{tone}" stroke="#fff" stroke-width="1.5""##));
    if role == Role::Adversary {
        for share in [-0.2, -0.62] {
            let stripe = OrientedBox { half_length: 0.09 * b.half_length, ..*b };
            let [c, s] = b.axis;
            let offset = share * b.half_length;
            let stripe =
                OrientedBox { center: [b.center[0] + offset * c, b.center[1] + offset * s], ..stripe };
            svg.polygon(&stripe.corners().map(|p| viewport.pixel(p)), r##"fill="#fff""##);
        }
    }
    let corners = b.corners().map(|p| viewport.pixel(p));
    svg.polygon(&corners, &format!(r#"fill="none" stroke="{}" stroke-width="1""#, color::INK));
}

/// Draws a person as the adversary: a mark that is seen at any scale.
pub(super) fn person(svg: &mut Svg, viewport: &Viewport, kind: &TrackKind, b: &OrientedBox) {
    let tone = color::ADVERSARY;
    let at = viewport.pixel(b.center);
    svg.circle(at, 12.0, &format!(r#"fill="none" stroke="{tone}" stroke-width="2""#));
    if *kind == TrackKind::Cyclist {
        svg.polygon(&b.corners().map(|p| viewport.pixel(p)), &format!(r#"fill="{tone}""#));
    }
    svg.circle(at, 5.0, &format!(r##"fill="{tone}" stroke="#fff" stroke-width="1.5""##));
}

/// Draws the ego's evasive manoeuvre.
pub(super) fn evasion(svg: &mut Svg, viewport: &Viewport, points: &[Point]) {
    let pixels: Vec<Point> = points.iter().map(|p| viewport.pixel(*p)).collect();
    evasion_line(svg, &pixels);
}

/// The line of an evasive manoeuvre, in pixels.
pub(super) fn evasion_line(svg: &mut Svg, pixels: &[Point]) {
    let attributes =
        format!(r#"fill="none" stroke="{}" stroke-width="3" stroke-dasharray="6 4""#, color::EVASION);
    svg.lines(&[pixels.to_vec()], &attributes);
}

/// Draws a trajectory coloured by time, with a mark each second: dots for the ego, diamonds for the
/// adversary.
pub(super) fn trajectory(svg: &mut Svg, viewport: &Viewport, points: &[Point], role: Role) {
    let ramp = role.ramp();
    let pixels: Vec<Point> = points.iter().map(|p| viewport.pixel(*p)).collect();
    svg.lines(
        std::slice::from_ref(&pixels),
        r##"fill="none" stroke="#fff" stroke-opacity="0.8" stroke-width="6" stroke-linecap="round" stroke-linejoin="round""##,
    );
    let share = |k: usize| (k as f64 / HORIZON as f64).min(1.0);
    svg.open(r#"fill="none" stroke-width="3" stroke-linecap="round""#);
    // One colour per half second: finer steps are not visible.
    for first in (0..pixels.len().saturating_sub(1)).step_by(5) {
        let last = (first + 5).min(pixels.len() - 1);
        svg.lines(&[pixels[first..=last].to_vec()], &format!(r#"stroke="{}""#, ramp.at(share(first))));
    }
    svg.close();
    for k in (10..pixels.len()).step_by(10) {
        let attributes = format!(r##"fill="#fff" stroke="{}" stroke-width="1.4""##, ramp.at(share(k)));
        let [x, y] = pixels[k];
        match role {
            Role::Ego => svg.circle([x, y], 2.6, &attributes),
            Role::Adversary => {
                let diamond = [[x, y - 4.6], [x + 4.6, y], [x, y + 4.6], [x - 4.6, y]];
                svg.polygon(&diamond, &attributes);
            }
        }
    }
}

/// Draws the mark of a candidate by its number.
pub(super) fn glyph(svg: &mut Svg, [x, y]: Point, number: usize) {
    let attributes = format!(r##"fill="{}" stroke="#fff" stroke-width="1.2""##, ADVERSARY_END);
    let star = |n: u32, inner: f64| -> Vec<Point> {
        (0..2 * n)
            .map(|k| {
                let r = if k % 2 == 0 { 7.0 } else { inner };
                let a = f64::from(k) * std::f64::consts::PI / f64::from(n) - std::f64::consts::FRAC_PI_2;
                [x + r * a.cos(), y + r * a.sin()]
            })
            .collect()
    };
    match number % GLYPHS {
        0 => svg.circle([x, y], 5.5, &attributes),
        1 => svg.rect([x - 5.0, y - 5.0], [10.0, 10.0], &attributes),
        2 => svg.polygon(&[[x, y - 6.5], [x + 6.0, y + 4.5], [x - 6.0, y + 4.5]], &attributes),
        3 => svg.polygon(&[[x, y - 7.0], [x + 7.0, y], [x, y + 7.0], [x - 7.0, y]], &attributes),
        4 => svg.polygon(&star(5, 3.0), &attributes),
        _ => svg.polygon(&star(4, 2.4), &attributes),
    }
}

/// Tone of candidate marks.
const ADVERSARY_END: &str = "#7a2a00";

/// Marks the first contact of two cars, with the outlines of both boxes.
pub(super) fn contact(svg: &mut Svg, viewport: &Viewport, boxes: [&OrientedBox; 2]) {
    for (b, tone) in boxes.into_iter().zip([color::EGO, color::ADVERSARY]) {
        let corners = b.corners().map(|p| viewport.pixel(p));
        let attributes = format!(
            r#"fill="{tone}" fill-opacity="0.18" stroke="{tone}" stroke-width="1.8" stroke-dasharray="4 2""#
        );
        svg.polygon(&corners, &attributes);
    }
    let middle = [0, 1].map(|k| 0.5 * (boxes[0].center[k] + boxes[1].center[k]));
    burst(svg, viewport.pixel(middle));
}

/// Draws the outlines of boxes with a label beside the first.
pub(super) fn mark(svg: &mut Svg, viewport: &Viewport, boxes: &[OrientedBox], label: &str) {
    for b in boxes {
        let corners = b.corners().map(|p| viewport.pixel(p));
        svg.polygon(&corners, &format!(r#"fill="none" stroke="{}" stroke-width="1.6""#, color::FAILURE));
    }
    let Some(first) = boxes.first() else { return };
    let [x, y] = viewport.pixel(first.center);
    let attributes = format!(
        r##"font-size="12" font-family="sans-serif" fill="{}" stroke="#fff" stroke-width="3" paint-order="stroke""##,
        color::INK
    );
    svg.text([x + 12.0, y + 4.0], &attributes, label);
}

/// Draws the mark of a contact.
pub(super) fn burst(svg: &mut Svg, [x, y]: Point) {
    let corner = |k: u32| {
        let r = if k.is_multiple_of(2) { 11.0 } else { 5.0 };
        let a = f64::from(k) * std::f64::consts::PI / 8.0;
        [x + r * a.cos(), y + r * a.sin()]
    };
    let corners: Vec<Point> = (0..16).map(corner).collect();
    svg.polygon(
        &corners,
        &format!(r#"fill="{}" stroke="{}" stroke-width="1.4""#, color::CONTACT, color::INK),
    );
}

/// Logged positions of the future, frame 10 to 90, as far as they are valid without a gap.
pub(super) fn logged_trajectory(track: &Track) -> Vec<Point> {
    (NOW..=NOW + HORIZON)
        .skip_while(|&f| !track.is_valid(f))
        .take_while(|&f| track.is_valid(f))
        .map(|f| track.point(f))
        .collect()
}

/// Bounds of points; empty without points.
pub(super) fn bounds(points: &[Point]) -> Aabb {
    Aabb::of(points.iter().copied())
}
