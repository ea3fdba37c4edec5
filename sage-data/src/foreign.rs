//! Formats that are recognised but not read. Errors name them, and what to do.
//!
//! A file is recognised by a bounded look at its first bytes, or, if it is a pickle, by the shape of its outermost
//! values. Nothing here decides whether a file is read: it explains why one was not.

use std::path::Path;

use crate::{
    Error,
    pickle::{Document, Id, Node},
};

/// Bytes that are looked at.
pub(crate) const LOOK: usize = 1 << 16;
/// Entries of a pickled dict that are looked at.
const ENTRIES: usize = 8;

/// A format that is not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Foreign {
    /// What the file is, after `is`.
    pub(crate) what: &'static str,
    /// What to do.
    pub(crate) remedy: &'static str,
}

impl Foreign {
    pub(crate) fn error(self, path: &Path) -> Error {
        Error::OtherFormat { path: path.to_owned(), found: self.what, remedy: self.remedy }
    }
}

/// Formats by their first bytes.
const MAGIC: [(&[u8], &str, &str); 16] = [
    (b"ARROW1", "an Arrow file", CONVERT),
    (b"SQLite format 3\0", "an SQLite database, as nuPlan has them", CONVERT),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file", CONVERT),
    (b"\x93NUMPY", "a NumPy array (.npy)", CONVERT),
    (b"PK\x03\x04", "a zip archive", UNPACK),
    (b"PK\x05\x06", "an empty zip archive", "copy it again"),
    (b"BZh", "a file compressed by bzip2", DECOMPRESS),
    (b"\xfd7zXZ\0", "a file compressed by xz", DECOMPRESS),
    (b"\x28\xb5\x2f\xfd", "a file compressed by zstd", DECOMPRESS),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", UNPACK),
    (b"Rar!\x1a\x07", "a RAR archive", UNPACK),
    (b"%PDF-", "a PDF document", GIVE_SCENE),
    (b"\x89PNG\r\n\x1a\n", "a picture (PNG)", GIVE_SCENE),
    (b"GIF8", "a picture (GIF)", GIVE_SCENE),
    (b"\xff\xd8\xff", "a picture (JPEG)", GIVE_SCENE),
    (
        b"version https://git-lfs",
        "a pointer of Git LFS, which stands for the file",
        "fetch the file itself with `git lfs pull`",
    ),
];

const CONVERT: &str = "convert it with ScenarioNet, and give the .pkl files that it writes";
const UNPACK: &str = "unpack it, and give the files or the folder";
const DECOMPRESS: &str = "decompress it first";
const GIVE_SCENE: &str = "give a scene file: .pkl, .safetensors, a Waymo TFRecord file, JSON of GPUDrive, or a Parquet scenario of Argoverse 2";
const GIVE_FOLDER: &str = "give the folder that it is in, or a scene file of that folder";

/// The format of a file whose first bytes are those of no other format.
pub(crate) fn by_magic(start: &[u8]) -> Option<Foreign> {
    let found = MAGIC.into_iter().find(|(magic, ..)| start.starts_with(magic));
    found.map(|(_, what, remedy)| Foreign { what, remedy })
}

/// The format of a file that is neither a pickle, a native file nor a record, by its first bytes.
pub(crate) fn of_bytes(bytes: &[u8]) -> Option<Foreign> {
    let start = &bytes[..bytes.len().min(LOOK)];
    if bytes.is_empty() {
        return Some(Foreign { what: "an empty file", remedy: "copy or create it again" });
    }
    if let Some(found) = by_magic(start) {
        // The name of its first file says what kind of archive it is.
        let is_numpy = start.starts_with(b"PK\x03\x04") && contains(&start[..start.len().min(512)], b".npy");
        let numpy = Foreign { what: "a NumPy archive (.npz)", remedy: CONVERT };
        return Some(if is_numpy { numpy } else { found });
    }
    if start.get(257..262) == Some(b"ustar") {
        return Some(Foreign { what: "a tar archive", remedy: UNPACK });
    }
    if start.iter().all(|byte| *byte == 0) {
        let what = "a file of zeros, as a failed copy leaves it";
        return Some(Foreign { what, remedy: "copy it again" });
    }
    of_text(start)
}

/// The kind of a text.
fn of_text(start: &[u8]) -> Option<Foreign> {
    // A pickle of protocol 0, though it may be cut off: its own error says more.
    if [&b"(dp"[..], b"(lp", b"(d\n", b"ccollections"].iter().any(|begin| start.starts_with(begin)) {
        return None;
    }
    let found = |what, remedy| Some(Foreign { what, remedy });
    let body = start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(start).trim_ascii_start();
    // The look may end inside a character.
    let is_text = match std::str::from_utf8(body) {
        Ok(text) => is_plain(text),
        Err(error) => {
            let (valid, rest) = body.split_at(error.valid_up_to());
            rest.len() < 4 && start.len() == LOOK && std::str::from_utf8(valid).is_ok_and(is_plain)
        }
    };
    if !is_text {
        return None;
    }
    let lower: Vec<u8> = body.iter().take(1024).map(u8::to_ascii_lowercase).collect();
    if lower.starts_with(b"<!doctype html") || lower.starts_with(b"<html") {
        return found("a web page (HTML)", "download the file itself: a page was saved in its place");
    }
    if body.starts_with(b"<") {
        if contains(&lower, b"<openscenario") {
            return found("an OpenSCENARIO scenario, which is only written", GIVE_SCENE);
        }
        if contains(&lower, b"<opendrive") {
            return found("an OpenDRIVE map, which is only written", GIVE_SCENE);
        }
        if contains(&lower, b"<commonroad") {
            return found("a CommonRoad scenario", GIVE_SCENE);
        }
        return found("an XML file", GIVE_SCENE);
    }
    if body.starts_with(b"{") || body.starts_with(b"[") {
        return Some(of_json(body));
    }
    found("a text file", GIVE_SCENE)
}

/// True if a text has no control characters but white space.
fn is_plain(text: &str) -> bool {
    text.chars().all(|c| !c.is_control() || matches!(c, '\n' | '\r' | '\t' | '\u{c}'))
}

fn of_json(body: &[u8]) -> Foreign {
    let has = |key: &[u8]| contains(body, key);
    let found = |what, remedy| Foreign { what, remedy };
    if has(b"\"drivable_areas\"") || has(b"\"lane_segments\"") {
        return found(
            "a map of Argoverse 2 (JSON), without road users",
            "give the scenario_….parquet file beside it",
        );
    }
    if has(b"\"run_hash\"") {
        return found(
            "a row of `sage generate` (JSON)",
            "give one of the scene files that its `files` names",
        );
    }
    if has(b"\"command\"") && has(b"\"results\"") {
        return found("a record of a run of `sage` (JSON)", GIVE_FOLDER);
    }
    if body.starts_with(b"[") && has(b"\"trajectory\"") {
        return found("a file of candidates (JSON)", "give it to `sage score SCENE --candidates FILE`");
    }
    found("a JSON file", GIVE_SCENE)
}

fn contains(text: &[u8], part: &[u8]) -> bool {
    text.windows(part.len()).any(|window| window == part)
}

/// What a pickle is that is no scene, by its outermost values.
pub(crate) fn of_document(document: &Document) -> Option<Foreign> {
    let root = document.root();
    let found = |what, remedy| Some(Foreign { what, remedy });
    let has = |id: Id, keys: &[&str]| keys.iter().any(|key| document.get(id, key).is_some());
    if let Some(items) = document.items(root) {
        let is_scene = items.first().is_some_and(|first| has(*first, &["tracks"]));
        return if is_scene {
            found("a list of scenes", "save each scene as a pickle of its own")
        } else {
            None
        };
    }
    if let Node::Array(_) = document.node(root) {
        return found("a pickled numpy array", GIVE_SCENE);
    }
    let entries = document.entries(root)?;
    if has(root, &["tracks"]) {
        return None;
    }
    if has(root, &["track_infos"]) && has(root, &["map_infos"]) {
        return found("a preprocessed scene of MTR", "give the Waymo TFRecord file that it was made from");
    }
    let first = &entries[..entries.len().min(ENTRIES)];
    let all = |is: &dyn Fn(Id, Id) -> bool| !first.is_empty() && first.iter().all(|(k, v)| is(*k, *v));
    let is_file = |key: Id| document.text(key).is_some_and(|name| name.ends_with(".pkl"));
    if all(&|key, value| is_file(key) && document.text(value).is_some()) {
        return found("the mapping of a data set, as `dataset_mapping.pkl`", GIVE_FOLDER);
    }
    let summaries =
        ["object_summary", "number_summary", "sdc_id", "track_length", "scenario_id", "metadrive_processed"];
    if all(&|key, value| has(value, &summaries) && (is_file(key) || !has(value, &["tracks"]))) {
        return found("the summary of a data set, as `dataset_summary.pkl`", GIVE_FOLDER);
    }
    if all(&|_, value| has(value, &["tracks"])) {
        return found("a dict of scenes", "save each scene as a pickle of its own");
    }
    None
}
