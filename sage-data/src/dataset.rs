//! Folders of scenes as ScenarioNet data sets: names of files, shards, and the two tables that MetaDrive and
//! ScenarioNet read first.
//!
//! `dataset_summary.pkl` maps each file name to the metadata of the file, with lists instead of arrays and
//! tuples instead of sets. `dataset_mapping.pkl` maps each file name to the folder of the file, here always
//! `""`. Both list the files in natural order.

use std::{
    collections::HashMap,
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

use sage_core::{
    files::{self, Existing},
    text::natural_order,
};

use crate::{
    Error, folder, names,
    pickle::{DictWriter, Document, Dtype, ElementKind, Id, Node},
    recording,
};

/// Name of the table of metadata.
pub const SUMMARY: &str = "dataset_summary.pkl";
/// Name of the table of folders.
pub const MAPPING: &str = "dataset_mapping.pkl";

/// Name of a scene's pickle in a data set, as ScenarioNet builds it: `sd_<dataset>_<version>_<scene>.pkl`.
///
/// Dataset and version come from files, so any character other than a letter, digit, `.` or `-` becomes `-`, and so do separators
/// of folders in the name of a scene. Then no name leads out of its folder, and underscores separate the first parts.
pub fn file_name(dataset: &str, version: &str, scene: &str) -> String {
    let scene = scene.replace(['/', '\\'], "-");
    format!("sd_{}_{}_{scene}.pkl", names::plain(dataset), names::plain(version))
}

/// One of several parts of the scenes of a folder, for runs on several machines.
///
/// ```
/// use sage_data::dataset::{Shard, file_name};
///
/// // Each scene is in one shard of three, wherever and in whichever order the shards run.
/// let holds = |scene: &str| (1..=3).filter(|number| Shard { number: *number, of: 3 }.holds(scene)).count();
/// assert!(["crossing", "merge-1-0", "42"].into_iter().all(|scene| holds(scene) == 1));
/// // Underscores separate the parts of a file name, so data set and version have none.
/// assert_eq!(file_name("my_own", "v1.2", "crossing"), "sd_my-own_v1.2_crossing.pkl");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of the shard, 1 to `of`.
    pub number: u32,
    /// Number of shards.
    pub of: u32,
}

/// Maximum number of shards of a folder.
const MOST_SHARDS: u32 = 1_000_000;

impl Shard {
    /// The shard of `of` that holds a scene: number `crc32(name) % of + 1`, with the CRC-32 of zlib over the UTF-8
    /// bytes of the name.
    pub fn of_scene(scene: &str, of: u32) -> Self {
        Self { number: crc32fast::hash(scene.as_bytes()) % of + 1, of }
    }

    /// True if a scene belongs to the shard.
    pub fn holds(self, scene: &str) -> bool {
        self == Self::of_scene(scene, self.of)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("`{text}` is no shard; expected K/N with 1 <= K <= N <= {MOST_SHARDS}, such as 2/8");
        let (number, of) = text.split_once('/').ok_or_else(wrong)?;
        let [number, of] = [number, of].map(|part| part.trim().parse::<u32>());
        match (number, of) {
            (Ok(number), Ok(of)) if 1 <= number && number <= of && of <= MOST_SHARDS => {
                Ok(Self { number, of })
            }
            _ => Err(wrong()),
        }
    }
}

/// Writes both tables for the pickles of a folder whose names begin with `sd_`. Returns their number. Files
/// are read in parallel, and the summary is written entry by entry. Without pickles both tables are removed.
///
/// *Errors*: a file with such a name that is not a scene; [`Error::Write`].
pub fn write_tables(folder: &Path) -> Result<usize, Error> {
    let files = pickles(folder)?;
    if files.is_empty() {
        for table in [SUMMARY, MAPPING] {
            files::remove_inside(folder, table.as_ref())
                .map_err(|source| Error::Write { path: folder.join(table), source })?;
        }
        return Ok(0);
    }
    let path = folder.join(SUMMARY);
    let mut failed = None;
    let written = files::write_with(&path, Existing::Replace, |out| {
        let mut table = DictWriter::begin(out)?;
        let taken = folder::in_order(&files, summary, |file, summary| match summary {
            Ok(summary) => table.add(&name(file), &summary).map_err(Some),
            Err(error) => {
                failed = Some(error);
                Err(None)
            }
        });
        match taken {
            // The error is in `failed`. This one only prevents the rename of the incomplete table.
            Err(None) => Err(std::io::ErrorKind::InvalidData.into()),
            Err(Some(error)) => Err(error),
            Ok(()) => table.end(),
        }
    });
    if let Some(error) = failed {
        return Err(error);
    }
    written.map_err(|source| Error::Write { path, source })?;
    let mut mapping = Document::empty();
    let same_folder = mapping.new_text("");
    let entries: Vec<(String, Id)> = files.iter().map(|file| (name(file), same_folder)).collect();
    let root = mapping.new_dict(entries);
    mapping.set_root(root);
    let path = folder.join(MAPPING);
    files::write(&path, &mapping.to_pickle(), Existing::Replace)
        .map_err(|source| Error::Write { path, source })?;
    Ok(files.len())
}

fn name(file: &Path) -> String {
    file.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Pickles of scenes that lie directly in a folder, in natural order.
fn pickles(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let fail = |source| Error::Read { path: folder.to_owned(), source };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let is_scene = path.file_name().and_then(|name| name.to_str());
        let is_scene = is_scene.is_some_and(|name| name.starts_with("sd_") && name.ends_with(".pkl"));
        if is_scene && path.is_file() {
            files.push(path);
        }
    }
    files.sort_by(|a, b| natural_order(&name(a), &name(b)));
    Ok(files)
}

/// The metadata of a file as its entry of the summary: plain values without arrays and sets.
fn summary(file: &Path) -> Result<Document, Error> {
    let document = recording::parse(file, recording::read_inside(file)?)?;
    let metadata = document.get(document.root(), "metadata").ok_or_else(|| Error::Field {
        path: file.to_owned(),
        field: "metadata".to_owned(),
        found: "missing".to_owned(),
        expected: "a dict; a file whose name begins with `sd_` is a scene of the data set".to_owned(),
    })?;
    let mut plain = Plain { from: &document, to: Document::empty(), copied: HashMap::new() };
    let root = plain.copy(metadata);
    plain.to.set_root(root);
    Ok(plain.to)
}

/// Copies values: arrays become lists, and sets become tuples. Shared values stay shared, so the copy is not
/// larger than the original. The reader limits the depth of nesting.
struct Plain<'d> {
    from: &'d Document,
    to: Document,
    copied: HashMap<Id, Id>,
}

impl Plain<'_> {
    fn copy(&mut self, id: Id) -> Id {
        if let Some(copy) = self.copied.get(&id) {
            return *copy;
        }
        let from = self.from;
        let node = match from.node(id) {
            Node::Array(array) => {
                let shape: Vec<usize> = array.shape.iter().map(|n| *n as usize).collect();
                let size = usize::from(array.dtype.size);
                let elements: Vec<&[u8]> = from.bytes(array.data).chunks_exact(size).collect();
                // Where each index steps to: the last one runs fastest, or the first one in Fortran's order.
                let mut strides = vec![1usize; shape.len()];
                let mut stride = 1usize;
                for axis in 0..shape.len() {
                    let axis = if array.fortran { axis } else { shape.len() - 1 - axis };
                    strides[axis] = stride;
                    stride = stride.saturating_mul(shape[axis]);
                }
                self.nested(array.dtype, &elements, &shape, &strides, 0)
            }
            Node::Scalar(dtype, span) => self.number(*dtype, from.bytes(*span)),
            Node::Set(items) | Node::FrozenSet(items) | Node::Tuple(items) => Node::Tuple(self.all(items)),
            Node::List(items) => Node::List(self.all(items)),
            Node::Dict(entries) | Node::DefaultDict { entries, .. } => {
                Node::Dict(entries.iter().map(|(key, value)| (self.copy(*key), self.copy(*value))).collect())
            }
            Node::Str(span) => Node::Str(self.to.push_bytes(from.bytes(*span))),
            Node::Bytes(span) | Node::ByteArray(span) => Node::Bytes(self.to.push_bytes(from.bytes(*span))),
            Node::BigInt(span) => Node::BigInt(self.to.push_bytes(from.bytes(*span))),
            node @ (Node::Bool(_) | Node::Int(_) | Node::Float(_)) => node.clone(),
            _ => Node::None,
        };
        let copy = self.to.push(node);
        self.copied.insert(id, copy);
        copy
    }

    fn all(&mut self, items: &[Id]) -> Vec<Id> {
        items.iter().map(|item| self.copy(*item)).collect()
    }

    /// An array from an element on as nested lists, one level an axis. An array without elements is one empty
    /// list: its axes may be of any length.
    fn nested(
        &mut self,
        dtype: Dtype,
        all: &[&[u8]],
        shape: &[usize],
        strides: &[usize],
        first: usize,
    ) -> Node {
        let Some((length, inner)) = shape.split_first() else {
            return all.get(first).map_or(Node::None, |bytes| self.number(dtype, bytes));
        };
        if all.is_empty() {
            return Node::List(Vec::new());
        }
        let item = |k: usize| {
            let node = self.nested(dtype, all, inner, &strides[1..], first + k * strides[0]);
            self.to.push(node)
        };
        Node::List((0..*length).map(item).collect())
    }

    /// A number of numpy as one of Python, exactly.
    fn number(&mut self, dtype: Dtype, bytes: &[u8]) -> Node {
        let value = || dtype.read(bytes).next().unwrap_or(0.0);
        match dtype.kind {
            ElementKind::Float => Node::Float(value()),
            ElementKind::Bool => Node::Bool(value() != 0.0),
            _ => match dtype.integer(bytes) {
                Some(integer) => Node::Int(integer),
                // Above the range of i64: little-endian two's complement with a byte for the sign.
                None => {
                    let mut bytes = bytes.to_vec();
                    if dtype.big_endian {
                        bytes.reverse();
                    }
                    bytes.push(0);
                    Node::BigInt(self.to.push_bytes(&bytes))
                }
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_do_not_lead_out_of_the_folder() {
        assert_eq!(file_name("waymo", "v1.2", "0-lambda0.50"), "sd_waymo_v1.2_0-lambda0.50.pkl");
        assert_eq!(file_name("../a_b", "MetaDrive v0.3", "x"), "sd_..-a-b_MetaDrive-v0.3_x.pkl");
        assert_eq!(file_name("", "", "x"), "sd_unknown_unknown_x.pkl");
    }

    #[test]
    fn a_summary_holds_arrays_as_nested_lists_with_exact_integers() {
        use crate::pickle::Array;
        let mut document = Document::empty();
        let mut array = |shape: &[u32], fortran: bool, values: &[u64]| {
            let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
            let data = document.push_bytes(&bytes);
            let dtype = Dtype { kind: ElementKind::Uint, size: 8, big_endian: false };
            let array = Array { dtype, shape: shape.to_vec(), fortran, from_buffer: false, data };
            document.push(Node::Array(Box::new(array)))
        };
        let large = [1_700_000_000_123_456_789, u64::MAX];
        let arrays = [
            array(&[2], false, &large),
            array(&[2, 3], true, &[0, 3, 1, 4, 2, 5]),
            array(&[1, 2, 2], false, &[0, 1, 2, 3]),
            array(&[4_000_000_000, 0], false, &[]),
        ];
        let mut plain = Plain { from: &document, to: Document::empty(), copied: HashMap::new() };
        let copies = arrays.map(|id| plain.copy(id));
        let text = |id: Id| {
            fn text(document: &Document, id: Id) -> String {
                match document.node(id) {
                    Node::List(items) => {
                        let items: Vec<String> = items.iter().map(|item| text(document, *item)).collect();
                        format!("[{}]", items.join(","))
                    }
                    Node::Int(x) => x.to_string(),
                    Node::BigInt(span) => format!("{:?}", document.bytes(*span)),
                    node => node.kind().to_owned(),
                }
            }
            text(&plain.to, id)
        };
        assert_eq!(text(copies[0]), "[1700000000123456789,[255, 255, 255, 255, 255, 255, 255, 255, 0]]");
        assert_eq!(text(copies[1]), "[[0,1,2],[3,4,5]]");
        assert_eq!(text(copies[2]), "[[[0,1],[2,3]]]");
        assert_eq!(text(copies[3]), "[]");
    }

    #[test]
    fn every_scene_belongs_to_one_shard() {
        // The check value of CRC-32.
        assert_eq!(crc32fast::hash(b"123456789"), 0xcbf4_3926);
        for of in [1, 2, 7] {
            for scene in (0..100).map(|k| k.to_string()) {
                let holders = (1..=of).filter(|number| Shard { number: *number, of }.holds(&scene)).count();
                assert_eq!(holders, 1);
            }
        }
    }

    #[test]
    fn shards_out_of_range_are_refused() {
        assert_eq!("2/8".parse(), Ok(Shard { number: 2, of: 8 }));
        for wrong in ["", "1", "0/2", "3/2", "1/0", "-1/2", "1/2/3", "a/b", "1/99999999"] {
            assert!(wrong.parse::<Shard>().unwrap_err().contains("1 <= K <= N"), "{wrong}");
        }
    }
}
