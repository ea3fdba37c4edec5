//! Weights in safetensors files: the tensors by name, and one JSON header that says what they are.

use std::{
    collections::{BTreeMap, HashMap},
    io::{Read, Write},
    path::Path,
};

use candle_core::{Device, Tensor};
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Parameters;
use crate::Error;

/// Largest file of weights that is read, bytes.
pub const LIMIT: u64 = 1 << 30;

/// Key of the header among the file's metadata: a single one, so that equal weights are equal bytes.
const KEY: &str = "sage";

/// What a file of weights says of itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// Registered name of the backbone.
    pub backbone: String,
    /// Its options.
    pub options: Value,
    /// Seed of the order of training.
    #[serde(default)]
    pub seed: u64,
    /// What it was trained on: scenes and their hash.
    #[serde(default)]
    pub data: String,
    /// The command that made it.
    #[serde(default)]
    pub command: String,
    /// Licence and notice.
    #[serde(default)]
    pub license: String,
    /// Anything else worth keeping, by name.
    #[serde(default)]
    pub notes: BTreeMap<String, String>,
}

impl Parameters {
    /// The file's bytes; equal for equal weights and header.
    ///
    /// *Errors*: none that a caller can cause.
    pub fn to_bytes(&self, header: &Header) -> Result<Vec<u8>, Error> {
        let json = serde_json::to_string(header).map_err(|e| Error::Training(e.to_string()))?;
        let metadata = HashMap::from([(KEY.to_owned(), json)]);
        let contiguous: Vec<(&str, Tensor)> = self
            .iter()
            .map(|(name, tensor)| Ok((name, tensor.contiguous()?)))
            .collect::<candle_core::Result<_>>()?;
        let views = contiguous.iter().map(|(name, tensor)| (*name, tensor));
        safetensors::serialize(views, Some(metadata))
            .map_err(|e| Error::Training(format!("cannot keep weights: {e}")))
    }

    /// Reads what [`Parameters::to_bytes`] makes; `path` is for messages.
    ///
    /// *Errors*: [`Error::Format`].
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<(Self, Header), Error> {
        let fail = |problem: String| Error::Format { path: path.to_owned(), problem };
        let broken = |e: safetensors::SafeTensorError| {
            fail(format!("is no whole file of weights ({e}); copy or train it again"))
        };
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(broken)?;
        let json = metadata.metadata().as_ref().and_then(|m| m.get(KEY)).ok_or_else(|| {
            fail("has no `sage` header, which says what network its tensors belong to".to_owned())
        })?;
        let header =
            serde_json::from_str(json).map_err(|e| fail(format!("has a broken `sage` header: {e}")))?;
        let file = SafeTensors::deserialize(bytes).map_err(broken)?;
        let mut parameters = Self::default();
        for (name, view) in file.iter() {
            let tensor = match view.dtype() {
                safetensors::Dtype::F32 => numbers(view.data(), f32::from_le_bytes),
                safetensors::Dtype::F64 => numbers(view.data(), f64::from_le_bytes),
                other => {
                    let name = name.escape_debug();
                    return Err(fail(format!("tensor `{name}` holds {other:?}; expected F32 or F64")));
                }
            };
            parameters.insert(name, tensor?.reshape(view.shape())?);
        }
        Ok((parameters, header))
    }

    /// Writes the file: under a temporary name first, so that no half of one is ever found.
    ///
    /// *Errors*: [`Error::Io`].
    pub fn save(&self, header: &Header, path: &Path) -> Result<(), Error> {
        write_whole(path, &self.to_bytes(header)?)
    }

    /// Reads a file.
    ///
    /// *Errors*: [`Error::Io`], [`Error::Format`].
    pub fn load(path: &Path) -> Result<(Self, Header), Error> {
        Self::from_bytes(&read_whole(path, LIMIT)?, path)
    }
}

fn numbers<const N: usize, T: candle_core::WithDType>(
    bytes: &[u8],
    read: impl Fn([u8; N]) -> T,
) -> candle_core::Result<Tensor> {
    let (chunks, _) = bytes.as_chunks::<N>();
    let values: Vec<T> = chunks.iter().map(|chunk| read(*chunk)).collect();
    let count = values.len();
    Tensor::from_vec(values, count, &Device::Cpu)
}

/// Reads a file of at most `limit` bytes.
pub(crate) fn read_whole(path: &Path, limit: u64) -> Result<Vec<u8>, Error> {
    let io = |source| Error::Io { verb: "read", path: path.to_owned(), source };
    let mut bytes = Vec::new();
    std::fs::File::open(path).map_err(io)?.take(limit + 1).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > limit {
        let problem = format!("is larger than {limit} bytes");
        return Err(Error::Format { path: path.to_owned(), problem });
    }
    Ok(bytes)
}

/// Writes a file under a temporary name beside it, then renames it.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let io = |source| Error::Io { verb: "write", path: path.to_owned(), source };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let temporary = path.with_file_name(format!(".{name}.{}", std::process::id()));
    let write = || {
        let mut file = std::fs::File::create(&temporary)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&temporary, path)
    };
    write().map_err(|source| {
        // What is left of it is of no use to anyone.
        let _ = std::fs::remove_file(&temporary);
        io(source)
    })
}
