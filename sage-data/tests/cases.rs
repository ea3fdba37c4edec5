//! Forms of public reports, invented small: what is read, and what is said about it.
//!
//! The files lie in the folder `cases` of `SAGE_REFERENCE`.

#![allow(clippy::print_stderr, clippy::unwrap_used)] // Tests say what they leave out; a failed unwrap is a failed test.

use std::path::PathBuf;

use sage_core::scene::Scene;
use sage_data::{ReadOptions, Recording, checks};

fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("SAGE_REFERENCE").map(|folder| PathBuf::from(folder).join("cases"));
    let folder = folder.filter(|folder| folder.is_dir());
    if folder.is_none() {
        eprintln!("left out: SAGE_REFERENCE does not name the folder with `cases`");
    }
    folder
}

/// What must come of a file: frames, tracks, adversary, kinds of important warnings; or words of the error.
type Expected<'e> = Result<(usize, usize, &'e str, &'e [&'e str]), &'e [&'e str]>;

const SHORT: &[&str] = &["short-recording"];
const RATE: &[&str] = &["frame-rate"];
const OLD: &[&str] = &["protocol 0 or 1", "python3 -c"];
const OUT: &[&str] = &["track-left-out"];
const NO_EDGE: &[&str] = &["no-road-edges"];

#[rustfmt::skip]
const CASES: &[(&str, Expected)] = &[
    ("base", Ok((91, 3, "b", &[]))),
    ("bumper", Ok((91, 4, "a", &[]))),
    ("cone_no_size", Ok((91, 4, "b", &["no-size"]))),
    ("decel", Ok((91, 3, "a", &[]))),
    ("degrees", Ok((91, 4, "b", &["heading-against-positions"]))),
    ("ego_few", Ok((91, 3, "a", &[]))),
    ("ego_gap_later", Ok((91, 3, "b", &[]))),
    ("ego_gap_now", Err(&["metadata/sdc_id", "not valid at frame 10"])),
    ("ego_over_edge", Ok((91, 2, "b", &[]))),
    ("ego_stands", Ok((91, 3, "a", &[]))),
    ("ego_twice", Ok((91, 3, "b", &["ego-copy"]))),
    ("empty_map", Ok((91, 3, "b", NO_EDGE))),
    ("frames_50", Ok((50, 3, "a", SHORT))),
    ("frames_81", Ok((81, 3, "b", SHORT))),
    ("heading_flipped", Ok((91, 3, "b", &["heading-against-positions"]))),
    ("heading_turns", Ok((91, 3, "b", &[]))),
    ("inside_ego", Ok((91, 2, "b", &["ego-copy"]))),
    ("int_keys", Ok((91, 3, "9", &[]))),
    ("int_keys_str_sdc", Ok((91, 3, "9", &[]))),
    ("lane_polygon_only", Ok((91, 3, "b", &[]))),
    ("light_none", Ok((91, 3, "b", &[]))),
    ("light_nuplan", Ok((91, 3, "b", &[]))),
    ("light_red", Ok((91, 3, "b", &[]))),
    ("nan_invalid", Ok((91, 3, "b", &[]))),
    ("nan_valid", Ok((91, 2, "a", OUT))),
    ("nan_velocity_bystander", Ok((91, 3, "b", OUT))),
    ("neg_length", Ok((91, 3, "b", OUT))),
    ("no_metadata", Err(&["`metadata` is missing", "sdc_id"])),
    ("no_sdc_id", Err(&["metadata/sdc_id", "missing"])),
    ("no_ts", Ok((91, 3, "b", &[]))),
    ("off_centre", Ok((91, 3, "a", &[]))),
    ("ooi_missing", Ok((91, 3, "b", &[]))),
    ("overlap_now", Ok((91, 3, "a", &["contact-now"]))),
    ("padding_at_origin", Ok((91, 4, "b", &[]))),
    ("parking_far", Ok((91, 3, "a", NO_EDGE))),
    ("poly_lists", Ok((91, 3, "b", &[]))),
    ("pos2d", Ok((91, 3, "b", &[]))),
    ("proto0", Err(OLD)),
    ("proto1", Err(OLD)),
    ("proto2", Ok((91, 3, "b", &[]))),
    ("queue_moves_off", Ok((91, 2, "l", &[]))),
    ("rate_100hz", Ok((91, 3, "b", RATE))),
    ("rate_20hz", Ok((91, 3, "b", RATE))),
    ("rate_25hz", Ok((91, 3, "b", RATE))),
    ("rate_2hz", Err(&["metadata/ts", "2 Hz", "--resample"])),
    ("scalar_size", Ok((91, 3, "b", &[]))),
    ("sdc_int", Ok((91, 3, "b", &[]))),
    ("sdc_np_int", Ok((91, 2, "8", &[]))),
    ("sidewalk", Ok((91, 3, "a", &[]))),
    ("size_column", Ok((91, 3, "b", &[]))),
    ("ts_lies_2hz", Err(&["metadata/ts", "2 Hz", "velocities fit", "--resample"])),
    ("ttc", Ok((91, 3, "a", &[]))),
    ("type_bus", Ok((91, 3, "b", &[]))),
    ("type_motorcyclist", Ok((91, 3, "b", &[]))),
    ("type_none", Ok((91, 3, "b", &[]))),
    ("type_unset", Ok((91, 3, "b", &[]))),
    ("u_turn", Ok((91, 3, "a", &[]))),
    ("u_turn_6m", Ok((91, 2, "b", &[]))),
    ("u_turn_wide", Ok((91, 2, "b", &[]))),
    ("utm32", Ok((91, 3, "b", &[]))),
    ("utm64", Ok((91, 3, "b", &[]))),
    ("vector_stop_point", Ok((91, 3, "b", &[]))),
    ("velocity3d", Ok((91, 3, "b", &[]))),
    ("womd_test_11", Ok((11, 3, "b", SHORT))),
    ("zero_size_ped", Ok((91, 3, "b", OUT))),
    ("zero_velocity", Ok((91, 3, "b", &["velocity-against-positions"]))),
];

fn important(scene: &Scene) -> Vec<&'static str> {
    let mut kinds: Vec<&str> = checks::important(scene).into_iter().map(|warning| warning.kind).collect();
    kinds.dedup();
    kinds
}

#[test]
fn every_case_is_read_or_refused_as_it_must_be() {
    let Some(folder) = folder() else { return };
    let mut wrong = Vec::new();
    let mut files: Vec<String> = std::fs::read_dir(&folder)
        .unwrap()
        .filter_map(|entry| entry.unwrap().file_name().to_str()?.strip_suffix(".pkl").map(str::to_owned))
        .collect();
    files.retain(|file| !CASES.iter().any(|(name, _)| name == file));
    assert!(files.is_empty(), "cases without an expectation: {files:?}");
    for (name, expected) in CASES {
        let found = Recording::read(&folder.join(format!("{name}.pkl")));
        match (found, expected) {
            (Ok(recording), Ok((frames, tracks, adversary, kinds))) => {
                let scene = &recording.scene;
                let id = scene.adversary.map_or("none", |k| &scene.tracks[k].id);
                let found = (scene.frames, scene.tracks.len(), id, &important(scene)[..]);
                if found != (*frames, *tracks, *adversary, *kinds) {
                    wrong.push(format!("{name}: {found:?}, notes {:?}", scene.notes));
                }
                // Whatever was mended, the file keeps its values.
                let again =
                    Recording::from_bytes("again.pkl".as_ref(), recording.to_pickle().unwrap()).unwrap();
                assert_eq!(again.scene, recording.scene, "{name}");
                let native =
                    Recording::from_bytes("again.safetensors".as_ref(), recording.to_native().unwrap());
                assert_eq!(native.unwrap().scene.tracks, recording.scene.tracks, "{name}");
            }
            (Err(error), Err(words)) => {
                let text = error.to_string();
                let missing: Vec<_> = words.iter().filter(|word| !text.contains(**word)).collect();
                if !missing.is_empty() {
                    wrong.push(format!("{name}: {missing:?} not in {text}"));
                }
            }
            (Ok(recording), Err(_)) => wrong.push(format!("{name} is read: {:?}", recording.scene.notes)),
            (Err(error), Ok(_)) => wrong.push(format!("{name}: {error}")),
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn slow_recordings_are_read_on_demand_and_contradictory_times_stay_named() {
    let Some(folder) = folder() else { return };
    let options = ReadOptions { resample: true, ..ReadOptions::default() };
    let slow = Recording::read_as(&folder.join("rate_2hz.pkl"), &options).unwrap().scene;
    assert_eq!(slow.frames, 96);
    assert_eq!(important(&slow), ["frame-rate"]);
    let lies = Recording::read_as(&folder.join("ts_lies_2hz.pkl"), &options).unwrap().scene;
    assert!(important(&lies).contains(&"times-against-motion"), "{:?}", important(&lies));
}

#[test]
fn resampled_cases_hold_the_motion_of_the_base() {
    let Some(folder) = folder() else { return };
    for name in ["rate_20hz", "rate_25hz", "rate_100hz"] {
        let scene = Recording::read(&folder.join(format!("{name}.pkl"))).unwrap().scene;
        for frame in 0..91 {
            // The ego drives 10 m/s along +x from the origin.
            let [x, y] = scene.ego().point(frame);
            assert!(
                (x - frame as f64).abs() < 1e-6 && (y + 1.75).abs() < 1e-9,
                "{name}, frame {frame}: {x}, {y}"
            );
        }
    }
}
