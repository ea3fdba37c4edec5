//! Formats for the mutations: whole files, and what differs between formats in damaging them.

use std::ops::Range;

use sage_core::seed::Rng;
use sage_data::{
    Recording,
    procedural::{Kind, generate},
    womd,
};
use serde_json::{Value, json};

use super::{Mutant, programs};

/// A file with another part in a place.
type Around = fn(&[u8], Range<usize>, Vec<u8>) -> Vec<u8>;

/// A format.
pub struct Format {
    pub name: &'static str,
    /// Path that files are read as: some formats are known by their name.
    pub path: &'static str,
    /// Whole files.
    pub bases: Vec<Vec<u8>>,
    /// Where damage passes checksums and lengths, so that what lies behind them is tested.
    pub inside: fn(&[u8]) -> Option<Range<usize>>,
    /// A file with another part in that place, with the checksums and lengths of this part.
    pub around: Around,
    /// Files that are made, not damaged.
    pub made: Option<fn(&Self, &mut Rng) -> Mutant>,
}

/// The formats that are read without further libraries, from pickles, a shard and procedural scenes.
pub fn all() -> Vec<Format> {
    let newest = include_bytes!("../data/newest_p5.pkl");
    let pickles: [&[u8]; 4] = [
        include_bytes!("../data/small_p2_core.pkl"),
        include_bytes!("../data/small_p4_core.pkl"),
        newest,
        include_bytes!("../../../examples/crossing.pkl"),
    ];
    of(&pickles.map(<[u8]>::to_vec))
}

/// The formats, with these pickles.
pub fn of(pickles: &[Vec<u8>]) -> Vec<Format> {
    let native = |pickle: &Vec<u8>| {
        let recording = Recording::from_bytes("base".as_ref(), pickle.clone()).expect("a scene");
        recording.to_native().expect("written")
    };
    let plain =
        |name, path, bases| Format { name, path, bases, inside: |_| None, around: joined, made: None };
    vec![
        Format { made: Some(programs::made), ..plain("pickle", "some.pkl", pickles.to_vec()) },
        Format {
            inside: header,
            around: with_header,
            ..plain("native", "some.safetensors", pickles.iter().map(native).collect())
        },
        Format {
            inside: |file| Some(12..file.len() - 4),
            around: |_, _, message| womd::frame(&message),
            ..plain("record", "some.tfrecord#0", records(include_bytes!("../data/womd_synthetic.tfrecord")))
        },
        plain("json", "some.json", vec![json_scene(Kind::Straight), json_scene(Kind::FourWay)]),
    ]
}

/// The records of a shard.
pub fn records(shard: &[u8]) -> Vec<Vec<u8>> {
    let (mut records, mut rest) = (Vec::new(), shard);
    while let Some(length) = rest.first_chunk() {
        let (record, after) = rest.split_at(16 + u64::from_le_bytes(*length) as usize);
        records.push(record.to_vec());
        rest = after;
    }
    records
}

/// A small scene as JSON of GPUDrive, with lights and all types of roads.
fn json_scene(kind: Kind) -> Vec<u8> {
    let scene = generate(kind, 0, 0).expect("a scene");
    let json = Recording::procedural(scene).to_gpudrive().expect("written").json;
    let mut value: Value = serde_json::from_slice(&json).expect("JSON");
    value["objects"].as_array_mut().expect("a list").truncate(3);
    value["roads"].as_array_mut().expect("a list").truncate(12);
    value["tl_states"] =
        json!({"1": {"state": ["stop", "go"], "x": [0, 0], "y": [0, 0], "z": [0, 0], "time_index": [3, 9]}});
    value["metadata"]["tracks_to_predict"] = json!([{"track_index": 1, "difficulty": 2}]);
    value.to_string().into_bytes()
}

/// The header of a safetensors file.
pub fn header(file: &[u8]) -> Option<Range<usize>> {
    let length = u64::from_le_bytes(*file.first_chunk()?) as usize;
    Some(8..8 + length)
}

/// A safetensors file with another header.
pub fn with_header(file: &[u8], place: Range<usize>, mut header: Vec<u8>) -> Vec<u8> {
    header.resize(header.len().next_multiple_of(8), b' ');
    [&(header.len() as u64).to_le_bytes(), &header[..], &file[place.end..]].concat()
}

/// A file with another part in a place.
pub fn joined(file: &[u8], place: Range<usize>, part: Vec<u8>) -> Vec<u8> {
    [&file[..place.start], &part, &file[place.end..]].concat()
}

/// The rows of a table: cells with `|` between them. Lines that begin with `#` are remarks.
pub fn lines<const N: usize>(table: &'static str) -> impl Iterator<Item = [&'static str; N]> {
    let rows = table.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    rows.map(|line| {
        let mut cells = line.split('|').map(str::trim);
        std::array::from_fn(|_| cells.next().unwrap_or_default())
    })
}

/// A word with `\n` and `\x41` as the bytes that they name.
pub fn unescaped(word: &str) -> Vec<u8> {
    let mut out = Vec::with_capacity(word.len());
    let mut rest = word.as_bytes();
    while let [first, after @ ..] = rest {
        rest = after;
        match (first, after) {
            (b'\\', [letter @ (b'n' | b'\\'), after @ ..]) => {
                out.push(if *letter == b'n' { b'\n' } else { b'\\' });
                rest = after;
            }
            (b'\\', [b'x', high, low, after @ ..]) => {
                let digit = |c: &u8| char::from(*c).to_digit(16).expect("a hexadecimal digit") as u8;
                out.push(16 * digit(high) + digit(low));
                rest = after;
            }
            _ => out.push(*first),
        }
    }
    out
}
