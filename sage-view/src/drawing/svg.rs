//! SVG text: shapes in pixels with one decimal.

use std::fmt::Write;

use sage_core::{
    geometry::{OrientedBox, Point},
    text::{is_hidden, push_markup},
};

use super::viewport::Viewport;

/// SVG text under construction.
#[derive(Default)]
pub(super) struct Svg {
    text: String,
}

/// Escapes text for XML, without characters that are not seen.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars().filter(|c| !is_hidden(*c)) {
        push_markup(&mut out, c);
    }
    out
}

/// A number with at most one decimal.
fn short(x: f64) -> String {
    let rounded = (x * 10.0).round() / 10.0;
    if rounded == 0.0 { "0".to_owned() } else { format!("{rounded}") }
}

impl Svg {
    /// Adds raw SVG.
    pub(super) fn raw(&mut self, text: &str) {
        self.text.push_str(text);
        self.text.push('\n');
    }

    /// Opens a group with attributes.
    pub(super) fn open(&mut self, attributes: &str) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.text, "<g {attributes}>");
    }

    /// Closes a group.
    pub(super) fn close(&mut self) {
        self.raw("</g>");
    }

    /// Several polylines as one SVG path.
    pub(super) fn lines(&mut self, parts: &[Vec<Point>], attributes: &str) {
        let data = path_data(parts, false);
        if !data.is_empty() {
            let _ = writeln!(self.text, r#"<path d="{data}" {attributes}/>"#);
        }
    }

    /// A filled polygon.
    pub(super) fn polygon(&mut self, points: &[Point], attributes: &str) {
        let data = path_data(&[points.to_vec()], true);
        let _ = writeln!(self.text, r#"<path d="{data}" {attributes}/>"#);
    }

    /// A circle.
    pub(super) fn circle(&mut self, [x, y]: Point, radius: f64, attributes: &str) {
        let _ = writeln!(
            self.text,
            r#"<circle cx="{}" cy="{}" r="{}" {attributes}/>"#,
            short(x),
            short(y),
            short(radius)
        );
    }

    /// A rectangle.
    pub(super) fn rect(&mut self, [x, y]: Point, [w, h]: Point, attributes: &str) {
        let _ = writeln!(
            self.text,
            r#"<rect x="{}" y="{}" width="{}" height="{}" {attributes}/>"#,
            short(x),
            short(y),
            short(w),
            short(h)
        );
    }

    /// A line of text.
    pub(super) fn text(&mut self, [x, y]: Point, attributes: &str, text: &str) {
        let _ = writeln!(
            self.text,
            r#"<text x="{}" y="{}" {attributes}>{}</text>"#,
            short(x),
            short(y),
            escape(text)
        );
    }

    /// A car: its box, and a windscreen that marks the front.
    pub(super) fn car(&mut self, viewport: &Viewport, b: &OrientedBox, attributes: &str) {
        let at = |along: f64, across: f64| {
            let [c, s] = b.axis;
            let (x, y) = (along * b.half_length, across * b.half_width);
            viewport.pixel([b.center[0] + x * c - y * s, b.center[1] + x * s + y * c])
        };
        self.polygon(&[at(1.0, 1.0), at(-1.0, 1.0), at(-1.0, -1.0), at(1.0, -1.0)], attributes);
        let screen = [at(0.62, 0.78), at(0.28, 0.66), at(0.28, -0.66), at(0.62, -0.78)];
        self.polygon(&screen, r##"fill="#fff" fill-opacity="0.75""##);
    }

    /// Returns the whole picture.
    pub(super) fn finish(self, [width, height]: Point, title: &str) -> String {
        format!(
            concat!(
                r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {} {}" width="{}" height="{}" "#,
                r#"font-family="Helvetica, Arial, 'DejaVu Sans', sans-serif" role="img">"#,
                "\n<title>{}</title>\n{}</svg>\n"
            ),
            short(width),
            short(height),
            short(width),
            short(height),
            escape(title),
            self.text
        )
    }
}

fn path_data(parts: &[Vec<Point>], closed: bool) -> String {
    let mut data = String::new();
    for part in parts.iter().filter(|part| part.len() > 1) {
        for (k, [x, y]) in part.iter().enumerate() {
            let command = if k == 0 {
                "M"
            } else if k == 1 {
                "L"
            } else {
                " "
            };
            let _ = write!(data, "{command}{} {}", short(*x), short(*y));
        }
        if closed {
            data.push('Z');
        }
    }
    data
}
