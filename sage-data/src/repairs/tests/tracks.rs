//! Invented files with unusable values, missing sizes, copies of the ego and contradictions.

use sage_core::{
    geometry::{distance, wrap_angle},
    motion::DT,
    scene::AdversaryOrigin,
};

use super::kinds;
use crate::{
    ReadOptions, checks,
    pickle::Node,
    repairs::{
        made::{Made, circle, speeding_up},
        sizes::default_size,
    },
};

#[test]
fn one_bad_value_of_a_bystander_costs_the_track() {
    let strict = ReadOptions { strict: true, ..ReadOptions::default() };
    let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e9];
    let columns = ["position", "velocity", "heading", "length", "width", "height"];
    let mut count = 0;
    for column in columns {
        let more: &[f64] = if column == "length" || column == "width" { &[0.0, -1.0] } else { &[] };
        for value in bad.iter().chain(more) {
            let made = |track| Made::lasting(9.0, 0.1, speeding_up).with_value(track, column, 7, *value);
            let scene = made("person").read().unwrap();
            assert_eq!(scene.tracks.len(), 2, "{column} {value}");
            assert!(kinds(&scene).contains(&"track-left-out"), "{column} {value}: {:?}", scene.notes);
            assert!(
                scene
                    .notes
                    .iter()
                    .any(|note| note.to_string().contains("`person`") && note.to_string().contains(column))
            );
            // The file keeps it.
            let recording = made("person").recording(&ReadOptions::default());
            assert_eq!(recording.to_pickle().unwrap(), made("person").document.to_pickle());
            for (track, options) in
                [("ego", ReadOptions::default()), ("car", ReadOptions::default()), ("person", strict.clone())]
            {
                let error = made(track).read_as(&options).unwrap_err().to_string();
                let field = format!("tracks/{track}/state/{column}");
                assert!(error.contains(&field), "{column} {value}: {error}");
            }
            count += 1;
        }
    }
    assert!(count >= 28);
    // What is not valid is nothing.
    for value in bad {
        let made = Made::lasting(9.0, 0.1, speeding_up).with_value("car", "position", 3, value);
        let made = made.with_value("car", "valid", 1, 0.0);
        let scene = made.read_as(&strict).unwrap().scene;
        assert_eq!((scene.tracks.len(), scene.tracks[1].position[1]), (3, [0.0; 3]));
        assert_eq!(made.recording(&strict).to_pickle().unwrap(), made.document.to_pickle());
    }
}

#[test]
fn sizes_come_from_columns_numbers_or_a_table() {
    let base = || Made::lasting(9.0, 0.1, speeding_up);
    let without =
        |made: Made| made.without("person", "length").without("person", "width").without("person", "height");
    let size = |made: &Made| made.read().unwrap().tracks[2].size[40];
    assert_eq!(size(&base()), [0.7f32, 0.7, 1.8].map(f64::from));
    let assumed = without(base());
    assert_eq!(size(&assumed), default_size(&sage_core::scene::TrackKind::Pedestrian));
    assert!(kinds(&assumed.read().unwrap()).contains(&"no-size"));
    // Every kind, and one size for every notation.
    for (kind, expected) in [
        ("VEHICLE", [4.6, 1.9, 1.6]),
        ("CAR", [4.6, 1.9, 1.6]),
        ("BUS", [12.0, 2.6, 3.2]),
        ("MOTORCYCLIST", [2.2, 0.9, 1.6]),
        ("PEDESTRIAN", [0.7, 0.7, 1.75]),
        ("CYCLIST", [1.75, 0.6, 1.75]),
        ("TRAFFIC_CONE", [0.4, 0.4, 2.0]),
        ("TRAFFIC_BARRIER", [0.3, 2.0, 2.0]),
        ("TRAFFIC_OBJECT", [1.0, 1.0, 1.0]),
        ("UNSET", [1.0, 1.0, 1.0]),
    ] {
        let assumed = without(base()).with_type("person", kind);
        assert_eq!(size(&assumed), expected, "{kind}");
        assert!(kinds(&assumed.read().unwrap()).contains(&"no-size"), "{kind}");
        let mut column = without(base()).with_type("person", kind);
        column.set_array("person", "size", &[91, 3], &[0.5, 0.6, 1.7].repeat(91));
        assert_eq!(size(&column), [0.5, 0.6, 1.7], "{kind}");
        let mut numbers = base().with_type("person", kind);
        for (key, value) in [("length", 0.4), ("width", 0.3), ("height", 1.5)] {
            let value = numbers.document.push(Node::Float(value));
            numbers.set("person", key, value);
        }
        assert_eq!(size(&numbers), [0.4, 0.3, 1.5], "{kind}");
        for made in [column, numbers] {
            assert!(!kinds(&made.read().unwrap()).contains(&"no-size"), "{kind}");
        }
    }
    let mut column = without(base());
    column.set_array("person", "size", &[91, 3], &[0.5, 0.6, 1.7].repeat(91));
    assert_eq!(size(&column), [0.5, 0.6, 1.7]);
    assert!(!kinds(&column.read().unwrap()).contains(&"no-size"));
    let mut flat = without(base());
    flat.set_array("person", "size", &[91, 2], &[0.5, 0.6].repeat(91));
    assert_eq!(size(&flat), [0.5, 0.6, 0.0]);
    let mut one = without(base());
    one.set_array("person", "size", &[3], &[0.5, 0.6, 1.7]);
    assert_eq!(size(&one), [0.5, 0.6, 1.7]);
    let mut numbers = base();
    for (key, value) in [("length", 0.4), ("width", 0.3), ("height", 1.5)] {
        let value = numbers.document.push(Node::Float(value));
        numbers.set("person", key, value);
    }
    assert_eq!(size(&numbers), [0.4, 0.3, 1.5]);
    let mut empty_shape = base();
    empty_shape.set_array("person", "length", &[], &[0.9]);
    assert_eq!(size(&empty_shape)[0], 0.9);
    // A changed track is written; a number for all frames stays.
    let mut changed = numbers.recording(&ReadOptions::default());
    changed.scene.tracks[2].position[20][0] += 1.0;
    let again = crate::Recording::from_bytes("x".as_ref(), changed.to_pickle().unwrap()).unwrap();
    assert_eq!(again.scene, changed.scene);
    // Half a size is an error of the track.
    assert_eq!(base().without("person", "width").read().unwrap().tracks.len(), 2);
    assert!(base().without("ego", "width").read().unwrap_err().to_string().contains("ego/state/width"));
}

#[test]
fn a_second_recording_of_the_ego_is_left_out() {
    let copy = |offset: f64| {
        let mut made = Made::lasting(9.0, 0.1, speeding_up);
        let ego = made.scene.tracks[0].clone();
        let rows: Vec<f64> = ego.position.iter().flat_map(|[x, y, z]| [x + offset, *y, *z]).collect();
        made.set_array("car", "position", &[91, 3], &rows);
        made.read().unwrap()
    };
    for offset in (-9..=9).map(|k| 0.05 * f64::from(k)) {
        let scene = copy(offset);
        assert!(scene.tracks.iter().all(|track| track.id != "car"), "{offset}");
        assert_eq!(scene.adversary_origin, AdversaryOrigin::None);
        assert!(kinds(&scene).contains(&"ego-copy"));
    }
    for offset in [0.6, 0.8, 1.5, 2.0, 3.0, 4.0, 4.5, -0.6, -0.8, -1.5, -2.0, -3.0, -4.0, -4.5] {
        let scene = copy(offset);
        assert_eq!(scene.adversary, Some(1), "{offset}");
        assert!(kinds(&scene).contains(&"contact-now"), "{offset}");
    }
    assert!(!kinds(&copy(4.7)).contains(&"contact-now"));
}

fn velocities_times(made: &mut Made, scale: f64) {
    for track in made.scene.tracks.clone() {
        let rows: Vec<f64> = track.velocity.iter().flatten().map(|x| scale * x).collect();
        made.set_array(&track.id, "velocity", &[91, 2], &rows);
    }
}

#[test]
fn contradictions_are_named_with_their_cause_and_positions_can_be_trusted() {
    let trust = ReadOptions { trust_positions: true, ..ReadOptions::default() };
    /// Kind of the warning, words of its cause, and what is done to the file.
    type Case<'c> = (&'c str, &'c str, &'c dyn Fn(&mut Made));
    let velocities = |made: &mut Made, map: fn([f64; 2]) -> [f64; 2]| {
        for track in made.scene.tracks.clone() {
            let rows: Vec<f64> = track.velocity.iter().flat_map(|v| map(*v)).collect();
            made.set_array(&track.id, "velocity", &[91, 2], &rows);
        }
    };
    let headings = |made: &mut Made, map: fn(f64) -> f64| {
        for track in made.scene.tracks.clone() {
            let rows: Vec<f64> = track.heading.iter().map(|h| map(*h)).collect();
            made.set_array(&track.id, "heading", &[91], &rows);
        }
    };
    let cases: [Case; 9] = [
        ("velocity-against-positions", "they are 0", &|made| velocities(made, |_| [0.0; 2])),
        ("velocity-against-positions", "point elsewhere", &|made| velocities(made, |[x, y]| [-y, x])),
        ("velocity-against-positions", "point elsewhere", &|made| velocities(made, |[x, y]| [-x, -y])),
        ("times-against-motion", "0.028 s", &|made| velocities(made, |v| v.map(|x| 3.6 * x))),
        ("times-against-motion", "0.200 s", &|made| velocities(made, |v| v.map(|x| 0.5 * x))),
        ("heading-against-positions", "backwards", &|made| headings(made, |h| h + std::f64::consts::PI)),
        ("heading-against-positions", "degrees", &|made| headings(made, |h| h.to_degrees() + 0.001)),
        ("heading-against-positions", "another zero", &|made| {
            headings(made, |h| std::f64::consts::FRAC_PI_2 - h)
        }),
        ("heading-against-positions", "another zero", &|made| headings(made, |h| h + 1.0)),
    ];
    for (kind, cause, change) in cases {
        let mut made = Made::lasting(9.0, 0.1, circle);
        change(&mut made);
        let scene = made.read().unwrap();
        let found = checks::important(&scene).into_iter().find(|warning| warning.kind == kind);
        let found = found.unwrap_or_else(|| panic!("{kind}, {cause}: {:?}", kinds(&scene)));
        assert!(found.detail.contains(cause), "{cause}: {}", found.detail);
        let trusted = made.read_as(&trust).unwrap().scene;
        let left: Vec<&str> = kinds(&trusted).into_iter().filter(|kind| kind.contains("against")).collect();
        assert!(left.is_empty(), "{kind}, {cause}: {left:?}");
        for frame in 1..90 {
            let (_, heading, velocity) = circle(frame as f64 * DT);
            assert!(distance(trusted.tracks[1].velocity[frame], velocity) < 0.05, "{cause}, frame {frame}");
            assert!(
                wrap_angle(trusted.tracks[1].heading[frame] - heading).abs() < 0.01,
                "{cause}, frame {frame}"
            );
        }
    }
    let finds = |kind: &str, change: &dyn Fn(&mut Made)| {
        let mut made = Made::lasting(9.0, 0.1, circle);
        change(&mut made);
        kinds(&made.read().unwrap()).contains(&kind)
    };
    for angle in [-3.1, -2.5, -1.6, -1.0, -0.8, 0.8, 1.0, 1.6, 2.5, 3.1_f64] {
        let (sin, cos) = angle.sin_cos();
        let columns: Vec<Vec<f64>> = Made::lasting(9.0, 0.1, circle)
            .scene
            .tracks
            .iter()
            .map(|track| {
                track.velocity.iter().flat_map(|[x, y]| [cos * x - sin * y, sin * x + cos * y]).collect()
            })
            .collect();
        let rotate = |made: &mut Made| {
            for (id, rows) in ["ego", "car", "person"].into_iter().zip(&columns) {
                made.set_array(id, "velocity", &[91, 2], rows);
            }
        };
        assert!(finds("velocity-against-positions", &rotate), "velocities turned by {angle}");
        let turned: Vec<Vec<f64>> = Made::lasting(9.0, 0.1, circle)
            .scene
            .tracks
            .iter()
            .map(|track| track.heading.iter().map(|heading| heading + angle).collect())
            .collect();
        let turn = |made: &mut Made| {
            for (id, rows) in ["ego", "car", "person"].into_iter().zip(&turned) {
                made.set_array(id, "heading", &[91], rows);
            }
        };
        assert!(finds("heading-against-positions", &turn), "headings turned by {angle}");
    }
    for scale in [0.2778, 0.3048, 0.447, 0.6214, 1.609, 2.237, 3.281, 3.6] {
        let scaled = |made: &mut Made| velocities_times(made, scale);
        assert!(finds("times-against-motion", &scaled), "velocities times {scale}");
    }
    let clean = Made::lasting(9.0, 0.1, circle).read().unwrap();
    assert!(kinds(&clean).iter().all(|kind| !kind.contains("against")), "{:?}", kinds(&clean));
    let teleport =
        Made::lasting(9.0, 0.1, speeding_up).with_value("person", "position", 3 * 40, 120.0).read().unwrap();
    assert!(kinds(&teleport).contains(&"jumps"));
    let fast =
        Made::lasting(9.0, 0.1, speeding_up).with_value("person", "velocity", 30, 150.0).read().unwrap();
    assert!(kinds(&fast).contains(&"speed-beyond-vehicles"));
    let mut large = Made::lasting(9.0, 0.1, speeding_up);
    large.set_array("car", "length", &[91], &[80.0; 91]);
    assert!(kinds(&large.read().unwrap()).contains(&"size-beyond-vehicles"));
}
