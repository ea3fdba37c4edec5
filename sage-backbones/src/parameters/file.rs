//! Weights in safetensors files: the tensors by name, and one JSON header that describes them.

use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
};

use candle_core::{Device, Tensor};
use safetensors::{SafeTensors, View};
use sage_core::{
    content_hash::{HashedTensor, check_hash, content_hash, with_hash},
    files::{self, Existing},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Parameters;
use crate::Error;

/// Size limit of a weights file, bytes.
pub const LIMIT: u64 = 1 << 30;

/// Size limit of the header of a weights file, bytes. It suffices for thousands of tensors.
const HEADER_LIMIT: u64 = 4 << 20;

/// Key of the header in the file's metadata. There is a single key, so that equal weights give equal bytes.
const KEY: &str = "sage";

/// Header of a weights file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// Registered name of the backbone.
    pub backbone: String,
    /// Its options.
    pub options: Value,
    /// Seed of the order of training.
    pub seed: u64,
    /// What it was trained on: scenes and their hash.
    pub data: String,
    /// The command that trained it.
    pub command: String,
    /// Licence and notice.
    pub license: String,
    /// Further notes by name.
    pub notes: BTreeMap<String, String>,
}

impl Parameters {
    /// The file's bytes, with a hash of its content in the header; equal for equal weights and header.
    ///
    /// *Errors*: those of the file format's library, for tensors on another device.
    pub fn to_bytes(&self, header: &Header) -> Result<Vec<u8>, Error> {
        let json = serde_json::to_string(header).map_err(|e| Error::Write(e.to_string()))?;
        let contiguous: Vec<(&str, Tensor)> = self
            .iter()
            .map(|(name, tensor)| Ok((name, tensor.contiguous()?)))
            .collect::<candle_core::Result<_>>()?;
        let views: Vec<(&str, &Tensor)> = contiguous.iter().map(|(name, tensor)| (*name, tensor)).collect();
        let data: Vec<_> = views.iter().map(|(_, tensor)| tensor.data()).collect();
        let hashed = views.iter().zip(&data).map(|((name, tensor), bytes)| {
            let dtype = format!("{:?}", View::dtype(tensor));
            (*name, HashedTensor { dtype, shape: tensor.dims().to_vec(), bytes })
        });
        let metadata = HashMap::from([(KEY.to_owned(), with_hash(&json, &content_hash(&json, hashed)))]);
        safetensors::serialize(views, Some(metadata))
            .map_err(|e| Error::Write(format!("cannot serialise weights: {e}")))
    }

    /// Reads the bytes of [`Parameters::to_bytes`]; `path` is for messages.
    ///
    /// *Errors*: [`Error::NoNetwork`]; [`Error::Format`], also for content that does not match its hash or has none, and for a
    /// number that is not finite, with its tensor.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<(Self, Header), Error> {
        let fail = |problem: String| Error::Format { path: path.to_owned(), problem };
        let broken = |e: safetensors::SafeTensorError| {
            fail(format!("is no whole file of weights ({e}); copy or train it again"))
        };
        let header = bytes.first_chunk::<8>().map_or(0, |length| u64::from_le_bytes(*length));
        if (HEADER_LIMIT..=bytes.len() as u64).contains(&header) {
            return Err(fail(format!(
                "has a header of {header} bytes; the largest that is read has {HEADER_LIMIT}"
            )));
        }
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(broken)?;
        let json = metadata.metadata().as_ref().and_then(|m| m.get(KEY));
        let json = json.ok_or_else(|| Error::NoNetwork { path: path.to_owned() })?;
        let file = SafeTensors::deserialize(bytes).map_err(broken)?;
        let hashed = file.iter().map(|(name, view)| {
            let dtype = format!("{:?}", view.dtype());
            (name, HashedTensor { dtype, shape: view.shape().to_vec(), bytes: view.data() })
        });
        let json = check_hash(json, hashed).map_err(|e| fail(format!("cannot be used: {e}")))?;
        let header: Header =
            serde_json::from_str(&json).map_err(|e| fail(format!("has a broken `sage` header: {e}")))?;
        let mut parameters = Self::default();
        for (name, view) in file.iter() {
            let of_type = |problem: String| fail(format!("tensor `{}` {problem}", name.escape_debug()));
            let tensor = match view.dtype() {
                safetensors::Dtype::F32 => numbers(view.data(), f32::from_le_bytes),
                safetensors::Dtype::F64 => numbers(view.data(), f64::from_le_bytes),
                other => return Err(of_type(format!("holds {other:?}; expected F32 or F64"))),
            };
            let tensor = tensor.map_err(of_type)?;
            parameters.insert(name, tensor.reshape(view.shape())?);
        }
        Ok((parameters, header))
    }

    /// Writes the file completely or not at all; replaces an existing file.
    ///
    /// *Errors*: [`Error::Io`].
    pub fn save(&self, header: &Header, path: &Path) -> Result<(), Error> {
        let io = |source| Error::Io { verb: "write", path: path.to_owned(), source };
        files::write(path, &self.to_bytes(header)?, Existing::Replace).map_err(io)
    }

    /// Reads a file.
    ///
    /// *Errors*: [`Error::Io`], and those of [`Parameters::from_bytes`].
    pub fn load(path: &Path) -> Result<(Self, Header), Error> {
        let io = |source| Error::Io { verb: "read", path: path.to_owned(), source };
        Self::from_bytes(&files::read(path, LIMIT).map_err(io)?, path)
    }
}

/// A tensor of finite numbers.
fn numbers<const N: usize, T: candle_core::WithDType + Into<f64>>(
    bytes: &[u8],
    read: impl Fn([u8; N]) -> T,
) -> Result<Tensor, String> {
    let (chunks, _) = bytes.as_chunks::<N>();
    let values: Vec<T> = chunks.iter().map(|chunk| read(*chunk)).collect();
    if let Some(index) = values.iter().position(|x| !Into::<f64>::into(*x).is_finite()) {
        let value: f64 = values[index].into();
        return Err(format!(
            "holds {value} at index {index}; expected finite numbers: train or copy it again"
        ));
    }
    let count = values.len();
    Tensor::from_vec(values, count, &Device::Cpu).map_err(|error| error.to_string())
}
