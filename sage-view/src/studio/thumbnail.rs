//! A small picture of a scene *now*, as SVG.

use std::fmt::Write as _;

use sage_core::{
    geometry::{Aabb, Point},
    motion::NOW,
    scene::{Map, MapKind, Scene, Track},
};

use crate::player::map::{parts_inside, simplified};

/// Half of the side that is shown, metres; width and height of the picture, pixels.
const REACH: f64 = 40.0;
const SIZE: u32 = 64;
/// Largest error of a line, metres.
const ERROR: f64 = 0.5;
const LANE_WIDTH: f64 = 3.7;

/// Colours by day and by night.
const STYLE: &str = "rect{fill:#eceae3}path{fill:none;stroke-linecap:round;stroke-linejoin:round}\
    .lane{stroke:#d3d7dc}.edge{stroke:#4d4d4d}.line{stroke:#fff}\
    .ego{stroke:#0072b2}.adversary{stroke:#d55e00}.other{stroke:#9aa2ac}\
    @media(prefers-color-scheme:dark){rect{fill:#202326}.lane{stroke:#3a3f45}.edge{stroke:#aab0b6}.line{stroke:#6d747b}\
    .ego{stroke:#4fa8e0}.adversary{stroke:#ff8d3a}}";

/// The surroundings of the ego *now*, with the way that ego and adversary go on.
pub fn thumbnail(scene: &Scene) -> String {
    let [x, y] = scene.ego().point(NOW);
    let area = Aabb { min: [x - REACH, y - REACH], max: [x + REACH, y + REACH] };
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{SIZE}\" height=\"{SIZE}\" viewBox=\"{:.1} {:.1} {:.1} {:.1}\"><style>{STYLE}</style>\
         <rect x=\"{:.1}\" y=\"{:.1}\" width=\"100%\" height=\"100%\"/>",
        area.min[0],
        -area.max[1],
        2.0 * REACH,
        2.0 * REACH,
        area.min[0],
        -area.max[1]
    );
    // A pixel is more than a metre: lines are as thick as they need to be seen.
    for (class, width) in [("lane", LANE_WIDTH), ("line", 0.4), ("edge", 0.9)] {
        path(&mut out, class, width, lines(&scene.map, class, &area).iter().map(Vec::as_slice));
    }
    let adversary = scene.adversary.map(|k| &scene.tracks[k]);
    let is_role = |k: usize| k == scene.ego || Some(k) == scene.adversary;
    let others = scene.tracks.iter().enumerate().filter(|(k, track)| !is_role(*k) && track.is_valid(NOW));
    let others: Vec<Vec<Point>> = others.map(|(_, track)| body(track)).collect();
    path(&mut out, "other", 1.8, others.iter().map(Vec::as_slice));
    for (class, track) in [("adversary", adversary), ("ego", Some(scene.ego()))] {
        let Some(track) = track else { continue };
        let valid = (NOW..track.valid.len()).filter(|k| track.is_valid(*k));
        let way: Vec<Point> = valid.map(|k| track.point(k)).collect();
        path(&mut out, class, 0.9, [&*way].into_iter());
        if track.is_valid(NOW) {
            path(&mut out, class, 2.6, [&*body(track)].into_iter());
        }
    }
    out + "</svg>"
}

/// A road user as a line along it.
fn body(track: &Track) -> Vec<Point> {
    let ([x, y], heading, half) = (track.point(NOW), track.heading[NOW], 0.5 * track.size[NOW][0]);
    let end = |side: f64| [x + side * half * heading.cos(), y + side * half * heading.sin()];
    vec![end(-1.0), end(1.0)]
}

/// The lines of a map in an area, of one of three kinds.
fn lines(map: &Map, class: &str, area: &Aabb) -> Vec<Vec<Point>> {
    let is_of = |kind: &MapKind| match class {
        "lane" => kind.is_motor_lane(),
        "edge" => kind.is_edge(),
        _ => matches!(kind, MapKind::Line(_)),
    };
    let of = map.features.iter().filter(|feature| is_of(&feature.kind)).flat_map(|feature| {
        let points: Vec<Point> = map.points_of(feature).iter().map(|p| [p[0], p[1]]).collect();
        parts_inside(&points, area)
    });
    of.filter(|part| part.len() > 1).map(|part| simplified(&part, ERROR)).collect()
}

/// Lines of one class as one path; y points up in a scene and down in a picture.
fn path<'p>(out: &mut String, class: &str, width: f64, lines: impl Iterator<Item = &'p [Point]>) {
    let mut all = String::new();
    for line in lines.filter(|line| line.len() > 1) {
        for (k, [x, y]) in line.iter().enumerate() {
            // Writing to a text cannot fail.
            let _ = write!(all, "{}{x:.1} {:.1}", if k == 0 { 'M' } else { 'L' }, -y);
        }
    }
    if !all.is_empty() {
        let _ = write!(out, "<path class=\"{class}\" stroke-width=\"{width}\" d=\"{all}\"/>");
    }
}

#[cfg(test)]
mod tests {
    use sage_data::procedural::{Kind, generate};

    #[test]
    fn a_thumbnail_is_small_and_holds_both_cars() {
        let scene = generate(Kind::FourWay, 1, 0).unwrap();
        let svg = super::thumbnail(&scene);
        assert!(svg.len() < 20_000 && svg.ends_with("</svg>"), "{} bytes", svg.len());
        for class in ["lane", "edge", "ego", "adversary"] {
            assert!(svg.contains(&format!("<path class=\"{class}\"")), "{class}");
        }
        assert!(!svg.contains("NaN"));
    }
}
