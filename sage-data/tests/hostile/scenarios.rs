//! Scenarios of Argoverse 2: rows in Parquet, and a map beside them.

#[path = "../argoverse/mod.rs"]
mod argoverse;

use std::path::PathBuf;

use argoverse::{ID, Row, Shape, map, parquet, rows, write};
use sage_data::Recording;

use super::{assert_table, damage, damage_as, error_of, limited, mutants, turn};
use mutants::{Format, formats, formats::lines, tables::changed};

/// A folder with a whole scenario and its map.
fn scenario(map: &str) -> (tempfile::TempDir, PathBuf) {
    let root = tempfile::tempdir().unwrap();
    let file = write(root.path(), &parquet(&rows(), &Shape::default()), map);
    (root, file)
}

/// The rows with another value in a column.
fn with(column: &'static str, which: &str, value: &str) -> Vec<u8> {
    let mut rows = rows();
    if which == "-" {
        return parquet(&rows, &Shape { without: vec![column], ..Shape::default() });
    }
    let number = which.parse::<usize>().ok();
    let is_meant =
        |(k, row): &(usize, &mut Row)| number.map_or(which == "*" || row.0 == which, |number| number == *k);
    rows.iter_mut().enumerate().filter(is_meant).for_each(|(_, row)| set(row, column, value));
    parquet(&rows, &Shape::default())
}

fn set(row: &mut Row, column: &str, value: &str) {
    let motion = ["position_x", "position_y", "heading", "velocity_x", "velocity_y"];
    let (sum, number) = value.strip_prefix('+').map_or((0.0, value), |added| (1.0, added));
    match column {
        "track_id" if value == "LONG" => row.0 += &"x".repeat(300),
        "track_id" => row.0 = value.to_owned(),
        "timestep" => row.3 = (sum * row.3 as f64) as i64 + number.parse::<i64>().unwrap(),
        _ => {
            let slot = &mut row.4[motion.iter().position(|name| *name == column).unwrap()];
            *slot = sum * *slot + number.parse::<f64>().unwrap();
        }
    }
}

#[test]
fn rows_and_maps_that_no_scenario_has_are_named() {
    let _turn = turn();
    let whole = map().to_string();
    let (_folder, file) = scenario(&whole);
    let path = file.to_str().unwrap();
    assert_table(lines(include_str!("parquet.table")).map(|[column, which, value, words]| {
        (format!("{column} {which} {value}"), words, error_of(path, &with(column, which, value)))
    }));
    let plain = parquet(&rows(), &Shape::default());
    let others: [(&[u8], &str); 3] = [
        (&plain, ""),
        (&parquet(&[], &Shape::default()), "no rows"),
        (b"PAR1", "no scenario that can be read"),
    ];
    assert_table(others.map(|(bytes, words)| (words.to_owned(), words, error_of(path, bytes))));
    assert_table(lines(include_str!("map.table")).map(|[place, value, words]| {
        let map = changed(whole.as_bytes(), place, value);
        let (_folder, file) = scenario(&String::from_utf8(map.clone()).unwrap());
        let error = limited(map.len(), || Recording::read(&file).err()).map(|error| error.to_string());
        assert!(error.as_ref().is_none_or(|error| error.len() < 900 && !error.contains('\n')), "{error:?}");
        (format!("{place} {value}"), words, error)
    }));
    std::fs::remove_file(file.with_file_name(format!("log_map_archive_{ID}.json"))).unwrap();
    assert!(error_of(path, &plain).unwrap().contains("no `log_map_archive_"));
}

#[test]
fn broken_bytes_of_parquet_are_errors_or_scenes() {
    let (_folder, file) = scenario(&map().to_string());
    let shapes = [
        Shape::default(),
        Shape { dictionary: true, groups: 3, ..Shape::default() },
        Shape { snappy: false, ..Shape::default() },
    ];
    for shape in shapes {
        let whole = parquet(&rows(), &shape);
        for share in 0..40 {
            assert!(
                error_of(file.to_str().unwrap(), &whole[..whole.len() * share / 40]).is_some(),
                "{share} of 40"
            );
        }
        let format = Format {
            name: "parquet",
            path: Box::leak(file.display().to_string().into_boxed_str()),
            bases: vec![whole],
            // The footer decides what is read where.
            inside: |file| Some(file.len() - file.len().min(2500)..file.len()),
            around: formats::joined,
            made: None,
        };
        damage(&format, 1500);
    }
}

#[test]
fn broken_maps_beside_a_scenario_are_errors_or_scenes() {
    let text = map().to_string();
    let (_folder, file) = scenario(&text);
    let beside = file.with_file_name(format!("log_map_archive_{ID}.json"));
    assert!(beside.is_file());
    let format = Format {
        name: "map of a scenario",
        path: "map.json",
        bases: vec![text.into_bytes()],
        inside: |_| None,
        around: formats::joined,
        made: None,
    };
    damage_as(&format, 1500, |mutant| {
        std::fs::write(&beside, &mutant.bytes).unwrap();
        let file = file.as_path();
        std::panic::catch_unwind(|| Recording::read(file).is_ok()).unwrap()
    });
}
