//! Hostile scene files, built from the shipped scene. One reader takes them for data, but Python's reader
//! would execute `touch MARKER`.

#![allow(dead_code)] // Each test program uses a part of it.

use std::{collections::BTreeMap, path::Path};

use sage_data::{Recording, pickle::Document};
use serde_json::{Map, Value, json};

/// The values of the shipped scene as a pickle of protocol 4.
fn plain(scene: &Path) -> Vec<u8> {
    Document::parse(std::fs::read(scene).unwrap()).unwrap().to_pickle()
}

fn text(word: &str) -> Vec<u8> {
    [&[b'X'][..], &(word.len() as u32).to_le_bytes(), word.as_bytes()].concat()
}

/// A pickle whose MEMOIZE follows a gap. Python stores at the number of entries and executes `os.system(…)`.
/// A reader that stores at the length of its table reads `numpy.dtype('f8')` instead.
pub fn memo(scene: &Path, marker: &Path) -> Vec<u8> {
    let mut program = plain(scene);
    assert_eq!(program.pop(), Some(b'.'));
    // The scene's own entries come before ours.
    let entries = memo_entries(&program);
    let put = |k: u32| [&[b'r'][..], &(entries + k).to_le_bytes(), b"0"].concat();
    let get = |k: u32| [&[b'j'][..], &(entries + k).to_le_bytes()].concat();
    let command = text(&format!("touch {}", marker.display()));
    for part in [
        [text("x"), put(5)].concat(),
        [text("numpy"), put(2)].concat(),
        [text("os"), b"\x940".to_vec()].concat(),
        [text("dtype"), put(3)].concat(),
        [text("system"), b"\x940".to_vec()].concat(),
        [text("f8"), put(4)].concat(),
        [command, b"\x940".to_vec()].concat(),
        [get(2), get(3), b"\x93".to_vec(), get(4), b"\x85R0.".to_vec()].concat(),
    ] {
        program.extend(part);
    }
    program
}

/// Entries that Python's memo has after a program of ours, without its STOP: the least number that cannot
/// be recalled.
fn memo_entries(program: &[u8]) -> u32 {
    let is_there = |k: u32| {
        let recall = [program, b"0j", &k.to_le_bytes(), b"0N."].concat();
        Document::parse(recall).is_ok()
    };
    (0..).find(|k| !is_there(*k)).unwrap()
}

/// A native file whose header length begins with 0x80 0x04, so that Python reads the header as opcodes.
pub fn polyglot(scene: &Path, marker: &Path) -> Vec<u8> {
    /// 0x80 0x04, then `G`, whose eight bytes swallow the zeros and the opening brace.
    const LENGTH: usize = 0x80 | (4 << 8) | (0x47 << 16);
    let native = Recording::read(scene).unwrap().to_native().unwrap();
    let (length, rest) = native.split_first_chunk::<8>().unwrap();
    let (header, data) = rest.split_at(u64::from_le_bytes(*length) as usize);
    let header: Map<String, Value> = serde_json::from_slice(header).unwrap();
    let short = |word: &str| {
        let n = word.len();
        assert!((0x20..=0x7e).contains(&n) && ![0x22, 0x5c].contains(&n), "{n}");
        format!("U{}{word}", n as u8 as char)
    };
    // Names are long, because their lengths have to be printable; the memo's index is a letter of UTF-8.
    let command = format!("{:<40}", format!("touch {}", marker.display()));
    let code = [
        short("multiprocessing.popen_spawn_posix"),
        short("os.path.os.path.os.path.os.system"),
        "q\u{93}".to_owned(),
        short(&command),
        "q\u{85}R.".to_owned(),
    ]
    .concat();
    let rest: String = serde_json::to_string(&header).unwrap().split_off(1);
    let tensor = json!({"dtype": "U8", "shape": [0], "data_offsets": [0, 0]});
    let mut head = format!("{{\"a{code}\":{tensor},{rest}").into_bytes();
    assert!(head.len() <= LENGTH);
    head.resize(LENGTH, b' ');
    [&(LENGTH as u64).to_le_bytes()[..], &head, data].concat()
}

/// Writes `dataset_summary.pkl` and `dataset_mapping.pkl` of names and their folders.
pub fn summary(folder: &Path, files: &[(&str, &str)]) {
    let dict = |values: &dyn Fn(&str) -> Vec<u8>| {
        let entries: Vec<u8> =
            files.iter().flat_map(|(name, folder)| [text(name), values(folder)].concat()).collect();
        [b"\x80\x04}(", &entries[..], b"u."].concat()
    };
    std::fs::write(folder.join("dataset_summary.pkl"), dict(&|_| b"}".to_vec())).unwrap();
    std::fs::write(folder.join("dataset_mapping.pkl"), dict(&|folder| text(folder))).unwrap();
}

/// All files under a folder with their bytes.
pub fn snapshot(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(dir) = open.pop() {
        for entry in std::fs::read_dir(dir).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && !path.is_symlink() {
                open.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                found.insert(name, std::fs::read(&path).unwrap_or_default());
            }
        }
    }
    found
}
