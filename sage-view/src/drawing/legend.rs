//! The legend beside the picture: road users, trajectories, map features, time and scale.

use std::collections::BTreeSet;

use sage_core::{
    geometry::{OrientedBox, Point},
    scene::{LightState, TrackKind},
};

use super::{
    map_layer::{self, Shown},
    palette::{self as color, Ramp},
    road_users::{self, Role},
    svg::Svg,
    tried::{Outcome, Tried},
    viewport::Viewport,
};

/// Width of the column, pixels.
pub(super) const WIDTH: f64 = 270.0;
/// Height of a row, pixels.
const ROW: f64 = 21.0;
/// Maximum number of letters in a row; longer text is cut with an ellipsis.
const LETTERS: usize = 31;
/// Maximum number of candidates with their own row.
const NAMED: usize = 12;

/// Content of the legend.
pub(super) struct Content<'c> {
    pub(super) title: &'c str,
    pub(super) subtitle: &'c str,
    pub(super) ego: &'c str,
    pub(super) adversary: Option<(&'c str, &'c TrackKind)>,
    /// Names of the candidates and the step of their first contact.
    pub(super) candidates: &'c [(String, Option<usize>)],
    /// Plans of a search.
    pub(super) tried: &'c [Tried],
    /// Time at which the evasive manoeuvre starts, seconds.
    pub(super) evasion: Option<f64>,
    pub(super) has_contact: bool,
    pub(super) map: &'c BTreeSet<Shown>,
    pub(super) users: &'c BTreeSet<TrackKind>,
}

/// Position of the next row.
struct Cursor {
    x: f64,
    y: f64,
}

impl Cursor {
    fn next(&mut self, svg: &mut Svg, text: &str) -> Point {
        let sign = [self.x + 16.0, self.y];
        svg.text([self.x + 38.0, self.y + 4.5], r#"font-size="13""#, &shortened(text, LETTERS));
        self.y += ROW;
        sign
    }
}

/// Draws the column at `x`; returns the height that picture and column need.
pub(super) fn draw(svg: &mut Svg, viewport: &Viewport, x: f64, content: &Content) -> f64 {
    svg.open(&format!(r#"fill="{}""#, color::INK));
    svg.text([x, 24.0], r#"font-size="17" font-weight="bold""#, &shortened(content.title, 24));
    svg.text([x, 44.0], r##"font-size="12.5" fill="#555""##, &shortened(content.subtitle, 36));
    let mut at = Cursor { x, y: 72.0 };
    roles(svg, &mut at, content);
    users(svg, &mut at, content.users);
    map(svg, &mut at, content.map);
    let height = viewport.height.max(at.y + 44.0);
    scale_bar(svg, viewport, [x, height - 12.0]);
    svg.close();
    height
}

/// A car of the size of a sign.
fn sign_car(center: Point) -> (Viewport, OrientedBox) {
    let viewport = Viewport::on(&sage_core::geometry::Aabb::around([0.0, 0.0], 0.5), 0.0, 1.0, [1.0, 1.0]);
    let [x, y] = center;
    // The window is one pixel a metre with y up, its corner at (−½, ½).
    (viewport, OrientedBox::new([x - 0.5, 0.5 - y], 0.0, 24.0, 11.0))
}

fn roles(svg: &mut Svg, at: &mut Cursor, content: &Content) {
    let sign = at.next(svg, &format!("ego {}", content.ego));
    let (viewport, car) = sign_car(sign);
    road_users::role(svg, &viewport, &car, Role::Ego);
    ramp(svg, at, Role::Ego.ramp(), "its recording");
    if let Some((adversary, kind)) = content.adversary {
        let sign = at.next(svg, &format!("adversary {adversary}"));
        let (viewport, car) = sign_car(sign);
        if kind.is_person() {
            road_users::person(svg, &viewport, &TrackKind::Pedestrian, &car);
        } else {
            road_users::role(svg, &viewport, &car, Role::Adversary);
        }
        let words = if content.candidates.is_empty() { "its trajectory" } else { "candidates" };
        if content.tried.is_empty() {
            ramp(svg, at, Role::Adversary.ramp(), words);
        }
    }
    for outcome in Outcome::ALL.into_iter().rev() {
        let mut of_outcome = content.tried.iter().filter(|tried| tried.outcome == outcome).peekable();
        if let Some(words) = of_outcome.peek().map(|tried| tried.words) {
            let is_dots = of_outcome.peek().is_some_and(|tried| tried.dot.is_some());
            let [x, y] = at.next(svg, &format!("{words}: {}", of_outcome.count()));
            match is_dots {
                true => outcome.dot(svg, [x, y], 0.3),
                false => outcome.line(svg, vec![[x - 12.0, y], [x + 12.0, y]]),
            }
        }
    }
    if content.tried.iter().any(|tried| tried.dot.is_some()) {
        at.next(svg, "area of a dot: probability");
    }
    for (number, (name, contact)) in content.candidates.iter().enumerate().take(NAMED) {
        let text = match contact {
            Some(step) => format!("{name}: hit {:.1} s", *step as f64 / 10.0),
            None => name.clone(),
        };
        let sign = at.next(svg, &text);
        road_users::glyph(svg, sign, number);
    }
    if let Some(more) = content.candidates.len().checked_sub(NAMED).filter(|n| *n > 0) {
        at.next(svg, &format!("and {more} more"));
    }
    if let Some(start) = content.evasion {
        let [x, y] = at.next(svg, &format!("evasive manoeuvre from {start:.1} s on"));
        road_users::evasion_line(svg, &[[x - 12.0, y], [x + 12.0, y]]);
    }
    if content.has_contact {
        let sign = at.next(svg, "first contact");
        road_users::burst(svg, sign);
    }
    at.y += 8.0;
}

/// A colour bar of time with a label.
fn ramp(svg: &mut Svg, at: &mut Cursor, ramp: &Ramp, what: &str) {
    const STEPS: u32 = 16;
    let (x, y) = (at.x + 38.0, at.y - 2.0);
    for k in 0..STEPS {
        let share = f64::from(k) / f64::from(STEPS - 1);
        let attributes = format!(r#"fill="{}""#, ramp.at(share));
        svg.rect([x + 5.0 * f64::from(k), y - 5.0], [5.2, 8.0], &attributes);
    }
    svg.text([x + 88.0, y + 3.0], r##"font-size="11.5" fill="#555""##, &format!("{what}, 0 to 8 s"));
    at.y += ROW;
}

fn users(svg: &mut Svg, at: &mut Cursor, users: &BTreeSet<TrackKind>) {
    let mut other_named = false;
    for kind in users {
        let words = match kind {
            TrackKind::Vehicle => "other vehicle",
            TrackKind::Pedestrian => "pedestrian",
            TrackKind::Cyclist => "cyclist",
            TrackKind::Other(_) if other_named => continue,
            TrackKind::Other(_) => {
                other_named = true;
                "cone, barrier, other"
            }
        };
        let sign = at.next(svg, words);
        let (viewport, mut car) = sign_car(sign);
        if *kind == TrackKind::Cyclist {
            (car.half_length, car.half_width) = (8.0, 2.5);
        }
        road_users::user(svg, &viewport, kind, &car);
    }
    at.y += 8.0;
}

fn map(svg: &mut Svg, at: &mut Cursor, shown: &BTreeSet<Shown>) {
    for item in shown {
        let words = match item {
            Shown::Lane => "lane and its direction",
            Shown::BikeLane => "bike lane",
            Shown::WhiteLine => "white line",
            Shown::YellowLine => "yellow line",
            Shown::Edge => "road edge",
            Shown::Sidewalk => "sidewalk, not road",
            Shown::Median => "median",
            Shown::Crosswalk => "crosswalk",
            Shown::SpeedBump => "speed bump",
            Shown::Driveway => "driveway",
            Shown::StopSign => "stop sign",
            Shown::LightStop => "light: stop",
            Shown::LightCaution => "light: caution",
            Shown::LightGo => "light: go",
        };
        let [x, y] = at.next(svg, words);
        let patch = |svg: &mut Svg, fill: &str| {
            svg.rect([x - 14.0, y - 6.0], [28.0, 12.0], &format!(r#"fill="{fill}""#))
        };
        let line = |svg: &mut Svg, tone: &str, width: f64| {
            let attributes = format!(r#"stroke="{tone}" stroke-width="{width}" fill="none""#);
            svg.lines(&[vec![[x - 14.0, y], [x + 14.0, y]]], &attributes);
        };
        match item {
            Shown::Lane => {
                patch(svg, color::ASPHALT);
                let head = vec![[x - 3.0, y - 4.0], [x + 3.0, y], [x - 3.0, y + 4.0]];
                svg.lines(&[head], &format!(r#"stroke="{}" stroke-width="1.5" fill="none""#, color::CHEVRON));
            }
            Shown::BikeLane => patch(svg, color::BIKE_LANE),
            Shown::WhiteLine => {
                patch(svg, color::ASPHALT);
                line(svg, color::WHITE_PAINT, 2.0);
            }
            Shown::YellowLine => {
                patch(svg, color::ASPHALT);
                line(svg, color::YELLOW_PAINT, 2.0);
            }
            Shown::Edge => line(svg, color::EDGE, 2.2),
            Shown::Sidewalk => {
                patch(svg, color::SIDEWALK);
                line(svg, color::EDGE, 1.2);
            }
            Shown::Median => line(svg, color::MEDIAN, 2.0),
            Shown::Crosswalk => patch(svg, "url(#stripes)"),
            Shown::SpeedBump => patch(svg, "url(#bumps)"),
            Shown::Driveway => patch(svg, color::DRIVEWAY),
            Shown::StopSign => map_layer::stop_sign(svg, [x, y]),
            Shown::LightStop => drop(map_layer::traffic_light(svg, [x, y], LightState::Stop)),
            Shown::LightCaution => drop(map_layer::traffic_light(svg, [x, y], LightState::Caution)),
            Shown::LightGo => drop(map_layer::traffic_light(svg, [x, y], LightState::Go)),
        }
    }
}

/// A bar of a round number of metres.
fn scale_bar(svg: &mut Svg, viewport: &Viewport, [x, y]: Point) {
    let lengths = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0];
    let metres = lengths.into_iter().rev().find(|m| m * viewport.scale <= 0.7 * WIDTH).unwrap_or(1.0);
    let end = x + metres * viewport.scale;
    let bar = vec![vec![[x, y - 6.0], [x, y]], vec![[x, y], [end, y]], vec![[end, y], [end, y - 6.0]]];
    svg.lines(
        &bar,
        &format!(r#"fill="none" stroke="{}" stroke-width="1.6" stroke-linecap="square""#, color::INK),
    );
    svg.text([x, y - 12.0], r#"font-size="12.5""#, &format!("{metres} m"));
}

fn shortened(text: &str, letters: usize) -> String {
    if text.chars().count() <= letters {
        return text.to_owned();
    }
    format!("{}…", text.chars().take(letters - 1).collect::<String>())
}
