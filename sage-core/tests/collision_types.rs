//! What happened defines the type of a collision: worked examples, and their picture in the documents.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::{
    f64::consts::{FRAC_PI_2, PI},
    fmt::Write,
    fs,
    path::Path,
};

use sage_core::{
    geometry::{OrientedBox, Point},
    objective::CollisionType::{self, *},
};

/// A position and a heading at a time, s.
type Drive = fn(f64) -> (Point, f64);

/// Worked examples: what the adversary does, and the type. The ego drives along +x at 10 m/s. The first of a type is drawn.
const EXAMPLES: [(CollisionType, Drive); 8] = [
    // One ahead in the lane, whether it stands, slows or swerves out at last.
    (RearEnd, |t| ([30.0 + 2.0 * t, 0.0], 0.0)),
    // One that comes over from the next lane a second before.
    (CutIn, |t| ([20.0 + 5.0 * t, (3.5 - 3.5 * (t - 2.0).max(0.0)).max(0.0)], 0.0)),
    (RearEnded, |t| ([-20.0 + 15.0 * t, 0.0], 0.0)),
    (Sideswipe, |t| ([10.0 * t, 4.0 - t], 0.0)),
    (Oncoming, |t| ([80.0 - 10.0 * t, 0.5], PI)),
    (TurningAcross, |t| {
        let angle = ((t - 2.0).max(0.0) * 0.7).min(FRAC_PI_2);
        ([52.0 - 5.0 * t.min(2.0) - 7.0 * angle.sin(), 5.0 - 7.0 * (1.0 - angle.cos())], PI + angle)
    }),
    (Crossing, |t| ([40.0, -40.0 + 10.0 * t], FRAC_PI_2)),
    (RearEnd, |t| ([30.0 + 2.0 * t, 0.6], 0.0)),
];

/// Boxes of a car of 4 m × 2 m at the steps after *now*.
fn boxes(at: impl Fn(f64) -> (Point, f64)) -> Vec<OrientedBox> {
    let area = |step: usize| {
        let (center, heading) = at(0.1 * step as f64);
        OrientedBox::new(center, heading, 4.0, 2.0)
    };
    (1..=80).map(area).collect()
}

/// Boxes of ego and adversary up to their first contact.
fn up_to_contact(drive: Drive) -> [Vec<OrientedBox>; 2] {
    let both = [boxes(|t| ([10.0 * t, 0.0], 0.0)), boxes(drive)];
    let contact = both[0].iter().zip(&both[1]).position(|(a, b)| a.intersects(b)).unwrap();
    both.map(|boxes| boxes[..=contact].to_vec())
}

#[test]
fn what_happened_defines_the_type() {
    for (expected, drive) in EXAMPLES {
        let [ego, adversary] = up_to_contact(drive);
        assert_eq!(CollisionType::between(&ego, &adversary), Some(expected));
    }
    assert_eq!(CollisionType::between(&[], &[]), None);
    assert!(CollisionType::ALL.iter().all(|kind| EXAMPLES.iter().any(|(drawn, _)| drawn == kind)));
}

/// The picture of the documents; after a change, `SAGE_WRITE_PICTURES=1 cargo test -p sage-core --test collision_types`
/// writes it anew.
#[test]
fn the_picture_shows_the_examples() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/pictures/collision-types.svg");
    if std::env::var_os("SAGE_WRITE_PICTURES").is_some() {
        fs::write(&file, picture()).unwrap();
    }
    assert!(fs::read_to_string(file).unwrap() == picture(), "the picture is not that of the examples");
}

/// Size of a panel, pixels, and metres shown from left to right.
const WIDTH: f64 = 230.0;
const HEIGHT: f64 = 150.0;
const SHOWN: f64 = 46.0;

fn picture() -> String {
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n",
        4.0 * WIDTH,
        2.0 * HEIGHT
    );
    for (k, kind) in CollisionType::ALL.into_iter().enumerate() {
        let (_, drive) = EXAMPLES.into_iter().find(|(drawn, _)| *drawn == kind).unwrap();
        let corner = [WIDTH * (k % 4) as f64, HEIGHT * (k / 4) as f64];
        panel(&mut svg, kind, &up_to_contact(drive), corner);
    }
    svg += "</svg>\n";
    svg
}

/// Draws both cars two seconds, a second and no time before the contact, with their ways.
fn panel(svg: &mut String, kind: CollisionType, both: &[Vec<OrientedBox>; 2], [x, y]: Point) {
    let last = both[0].len() - 1;
    let meeting = both[0][last].center;
    let scale = WIDTH / SHOWN;
    let drawn = |[px, py]: Point| {
        [WIDTH / 2.0 + scale * (px - meeting[0] + 6.0), HEIGHT / 2.0 + 8.0 - scale * (py - meeting[1])]
    };
    writeln!(
        svg,
        "<svg x=\"{x}\" y=\"{y}\" width=\"{WIDTH}\" height=\"{HEIGHT}\">\n\
         <rect x=\"1\" y=\"1\" width=\"{}\" height=\"{}\" fill=\"#f3f1ea\"/><text x=\"10\" y=\"20\">{}</text>",
        WIDTH - 2.0,
        HEIGHT - 2.0,
        kind.name()
    )
    .unwrap();
    for (boxes, colour) in both.iter().zip(["#1f5fbf", "#c62828"]) {
        let way: Vec<String> = boxes.iter().map(|area| point(drawn(area.center))).collect();
        writeln!(svg, "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\"/>", way.join(" ")).unwrap();
        for (step, opacity) in [(last.saturating_sub(20), 0.25), (last.saturating_sub(10), 0.5), (last, 1.0)]
        {
            let area = &boxes[step];
            let corner = |[along, across]: [f64; 2]| {
                let ([cos, sin], [cx, cy]) = (area.axis, area.center);
                let (l, w) = (along * area.half_length, across * area.half_width);
                point(drawn([cx + l * cos - w * sin, cy + l * sin + w * cos]))
            };
            let corners =
                [[1.0, 1.0], [1.0, 0.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]].map(corner).join(" ");
            writeln!(svg, "<polygon points=\"{corners}\" fill=\"{colour}\" fill-opacity=\"{opacity}\"/>")
                .unwrap();
        }
    }
    *svg += "</svg>\n";
}

fn point([x, y]: Point) -> String {
    format!("{x:.1},{y:.1}")
}
