//! Made-up scenarios of Argoverse 2, as files of several shapes.

#![allow(dead_code)] // Each test binary uses some of it.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use parquet::{
    basic::{Compression, Encoding},
    data_type::{ByteArray, ByteArrayType, DoubleType, FloatType, Int32Type, Int64Type},
    file::{properties::WriterProperties, writer::SerializedFileWriter},
    schema::parser::parse_message_type,
};
use serde_json::{Value, json};

/// Id of all of them.
pub const ID: &str = "0000-made";

/// A row: id, type, category, step, position, heading, velocity.
pub type Row = (String, &'static str, i64, i64, [f64; 5]);

/// How a file is written.
#[derive(Clone)]
pub struct Shape {
    pub groups: usize,
    pub dictionary: bool,
    pub snappy: bool,
    pub single: bool,
    pub optional: bool,
    /// Columns that are left out.
    pub without: Vec<&'static str>,
}

impl Default for Shape {
    fn default() -> Self {
        Self {
            groups: 1,
            dictionary: false,
            snappy: true,
            single: false,
            optional: true,
            without: Vec::new(),
        }
    }
}

/// The ego on the right lane, a scored vehicle that crosses its way, others.
pub fn rows() -> Vec<Row> {
    let mut rows = Vec::new();
    let mut add = |id: &str,
                   kind: &'static str,
                   category: i64,
                   steps: std::ops::Range<i64>,
                   from: [f64; 2],
                   speed: [f64; 2]| {
        for step in steps {
            let t = 0.1 * step as f64;
            let heading = f64::atan2(speed[1], speed[0]);
            let motion = [from[0] + speed[0] * t, from[1] + speed[1] * t, heading, speed[0], speed[1]];
            rows.push((id.to_owned(), kind, category, step, motion));
        }
    };
    add("AV", "vehicle", 1, 0..110, [100.0, 200.0], [8.0, 0.0]);
    add("1", "vehicle", 3, 0..110, [150.0, 240.0], [0.0, -8.0]);
    add("2", "vehicle", 0, 0..110, [140.0, 202.0], [0.0, -1.0]);
    add("3", "bus", 1, 5..80, [60.0, 203.5], [6.0, 0.0]);
    add("4", "pedestrian", 0, 20..60, [130.0, 209.0], [0.0, 1.0]);
    add("5", "motorcyclist", 1, 0..110, [90.0, 203.5], [9.0, 0.0]);
    add("6", "static", 0, 0..110, [120.0, 207.0], [0.0, 0.0]);
    add("7", "riderless_bicycle", 0, 3..40, [118.0, 207.0], [0.0, 0.0]);
    rows
}

/// Two lanes eastwards and one southwards across them, in one drivable area each way.
pub fn map() -> Value {
    let line = |points: &[[f64; 2]]| -> Value {
        points.iter().map(|[x, y]| json!({"x": x, "y": y, "z": 20.0})).collect::<Vec<_>>().into()
    };
    let lane = |id: i64, left: [[f64; 2]; 2], right: [[f64; 2]; 2], kind: &str| {
        json!({
            "id": id, "is_intersection": false, "lane_type": kind,
            "left_lane_boundary": line(&left), "right_lane_boundary": line(&right),
            "left_lane_mark_type": "DASHED_WHITE", "right_lane_mark_type": "SOLID_WHITE",
            "left_neighbor_id": null, "right_neighbor_id": null, "predecessors": [], "successors": []
        })
    };
    let mut first = lane(11, [[50.0, 201.75], [150.0, 201.75]], [[50.0, 198.25], [150.0, 198.25]], "VEHICLE");
    first["successors"] = json!([12]);
    first["left_neighbor_id"] = json!(13);
    first["centerline"] = line(&[[50.0, 200.0], [100.0, 200.0], [150.0, 200.0]]);
    let mut second =
        lane(12, [[150.0, 201.75], [250.0, 201.75]], [[150.0, 198.25], [250.0, 198.25]], "VEHICLE");
    second["predecessors"] = json!([11]);
    let beside = lane(13, [[50.0, 205.25], [250.0, 205.25]], [[50.0, 201.75], [250.0, 201.75]], "BUS");
    let across = lane(14, [[151.75, 300.0], [151.75, 120.0]], [[148.25, 300.0], [148.25, 120.0]], "VEHICLE");
    let bikes = lane(15, [[50.0, 207.0], [250.0, 207.0]], [[50.0, 205.5], [250.0, 205.5]], "BIKE");
    json!({
        "lane_segments": {"11": first, "12": second, "13": beside, "14": across, "15": bikes},
        "drivable_areas": {
            // Clockwise, as in the files.
            "1": {"id": 1, "area_boundary": line(&[[50.0, 197.0], [50.0, 208.0], [250.0, 208.0], [250.0, 197.0]])},
            "2": {"id": 2, "area_boundary": line(&[[147.0, 120.0], [147.0, 300.0], [153.0, 300.0], [153.0, 120.0]])}
        },
        "pedestrian_crossings": {
            "21": {"id": 21, "edge1": line(&[[130.0, 197.0], [130.0, 208.0]]), "edge2": line(&[[133.0, 197.0], [133.0, 208.0]])}
        }
    })
}

/// Bytes of a scenario.
pub fn parquet(rows: &[Row], shape: &Shape) -> Vec<u8> {
    let number = if shape.single { "float" } else { "double" };
    let integer = if shape.single { "int32" } else { "int64" };
    let repetition = if shape.optional { "optional" } else { "required" };
    let columns = [
        ("track_id", "binary"),
        ("object_type", "binary"),
        ("object_category", integer),
        ("timestep", integer),
        ("position_x", number),
        ("position_y", number),
        ("heading", number),
        ("velocity_x", number),
        ("velocity_y", number),
        ("scenario_id", "binary"),
        ("focal_track_id", "binary"),
    ];
    let columns: Vec<_> = columns.into_iter().filter(|(name, _)| !shape.without.contains(name)).collect();
    let fields: Vec<String> = columns
        .iter()
        .map(|(name, kind)| {
            format!("{repetition} {kind} {name}{};", if *kind == "binary" { " (UTF8)" } else { "" })
        })
        .collect();
    let schema = parse_message_type(&format!("message schema {{ {} }}", fields.join(" "))).unwrap();
    let properties = WriterProperties::builder()
        .set_compression(if shape.snappy { Compression::SNAPPY } else { Compression::UNCOMPRESSED })
        .set_dictionary_enabled(shape.dictionary)
        .set_encoding(Encoding::PLAIN)
        .build();
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties)).unwrap();
    let size = rows.len().div_ceil(shape.groups).max(1);
    for part in rows.chunks(size) {
        let mut group = writer.next_row_group().unwrap();
        for (name, _) in &columns {
            let mut column = group.next_column().unwrap().unwrap();
            let levels = shape.optional.then(|| vec![1; part.len()]);
            let levels = levels.as_deref();
            let texts = |text: &dyn Fn(&Row) -> String| -> Vec<ByteArray> {
                part.iter().map(|row| ByteArray::from(text(row).into_bytes())).collect()
            };
            let integers = |of: &dyn Fn(&Row) -> i64| part.iter().map(of).collect::<Vec<i64>>();
            match *name {
                "track_id" => {
                    column.typed::<ByteArrayType>().write_batch(&texts(&|row| row.0.clone()), levels, None)
                }
                "object_type" => {
                    column.typed::<ByteArrayType>().write_batch(&texts(&|row| row.1.to_owned()), levels, None)
                }
                "scenario_id" => {
                    column.typed::<ByteArrayType>().write_batch(&texts(&|_| ID.to_owned()), levels, None)
                }
                "focal_track_id" => {
                    column.typed::<ByteArrayType>().write_batch(&texts(&|_| "5".to_owned()), levels, None)
                }
                "object_category" | "timestep" => {
                    let all = integers(&|row| if *name == "timestep" { row.3 } else { row.2 });
                    match shape.single {
                        true => {
                            let all: Vec<i32> = all.iter().map(|x| *x as i32).collect();
                            column.typed::<Int32Type>().write_batch(&all, levels, None)
                        }
                        false => column.typed::<Int64Type>().write_batch(&all, levels, None),
                    }
                }
                _ => {
                    let names = ["position_x", "position_y", "heading", "velocity_x", "velocity_y"];
                    let k = names.iter().position(|known| known == name).unwrap();
                    let all: Vec<f64> = part.iter().map(|row| row.4[k]).collect();
                    match shape.single {
                        true => {
                            let all: Vec<f32> = all.iter().map(|x| *x as f32).collect();
                            column.typed::<FloatType>().write_batch(&all, levels, None)
                        }
                        false => column.typed::<DoubleType>().write_batch(&all, levels, None),
                    }
                }
            }
            .unwrap();
            column.close().unwrap();
        }
        group.close().unwrap();
    }
    writer.into_inner().unwrap()
}

/// Writes a scenario and its map into a folder of their own. Returns the scenario.
pub fn write(root: &Path, scenario: &[u8], map: &str) -> PathBuf {
    let folder = root.join(ID);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join(format!("log_map_archive_{ID}.json")), map).unwrap();
    let file = folder.join(format!("scenario_{ID}.parquet"));
    std::fs::write(&file, scenario).unwrap();
    file
}
