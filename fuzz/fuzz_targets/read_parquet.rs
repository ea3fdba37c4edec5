//! Any bytes as the rows of a scenario of Argoverse 2, beside a whole map: an error, or a scene that every format keeps.
#![no_main]

#[path = "../../sage-data/tests/mutants/mod.rs"]
mod mutants;

use std::{path::PathBuf, sync::OnceLock};

/// A file that does not exist, with a map beside it. Without it nothing can be fuzzed, so a refusal of the system may panic.
fn scenario() -> PathBuf {
    let folder = std::env::temp_dir().join("sage-fuzz-argoverse2");
    let lane = r#"{"id": 1, "lane_type": "VEHICLE", "left_lane_boundary": [{"x": 0, "y": 2}, {"x": 99, "y": 2}],
        "right_lane_boundary": [{"x": 0, "y": -2}, {"x": 99, "y": -2}]}"#;
    let area =
        r#"{"area_boundary": [{"x": 0, "y": -4}, {"x": 0, "y": 4}, {"x": 99, "y": 4}, {"x": 99, "y": -4}]}"#;
    let map = format!(r#"{{"lane_segments": {{"1": {lane}}}, "drivable_areas": {{"1": {area}}}}}"#);
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(folder.join("log_map_archive_1.json"), map).expect("written");
    folder.join("scenario_1.parquet")
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    let _ = mutants::consume(PATH.get_or_init(scenario), bytes);
});
