//! Files of named tensors with a JSON text and its content hash in the header: policies and checkpoints.

use std::{borrow::Cow, collections::HashMap, io, path::Path};

use safetensors::{Dtype, SafeTensors, View};
use sage_core::{
    content_hash::{HashedTensor, content_hash, with_hash},
    files::{self, Existing},
};

use super::Network;

/// A tensor to be written.
pub struct TensorBytes {
    /// Type of its numbers.
    pub dtype: Dtype,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its numbers, little-endian.
    pub bytes: Vec<u8>,
}

impl TensorBytes {
    /// A tensor of 32-bit numbers.
    pub fn singles(shape: Vec<usize>, numbers: &[f32]) -> Self {
        Self { dtype: Dtype::F32, shape, bytes: numbers.iter().flat_map(|x| x.to_le_bytes()).collect() }
    }
}

impl View for &TensorBytes {
    fn dtype(&self) -> Dtype {
        self.dtype
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }
    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

/// Tensors of an actor, with names that start with `prefix`.
pub fn actor_tensors(prefix: &str, actor: &Network<f32>) -> Vec<(String, TensorBytes)> {
    let mut all = Vec::new();
    for ((name, shape), range) in actor.shape().tensors().into_iter().zip(actor.shape().ranges()) {
        all.push((format!("{prefix}{name}"), TensorBytes::singles(shape, &actor.parameters()[range])));
    }
    all
}

/// Writes a file completely or not at all, with a JSON object and its hash under a key of the header.
///
/// *Errors*: as the system.
pub fn write_tensors(
    path: &Path,
    tensors: &[(String, TensorBytes)],
    key: &str,
    json: &str,
) -> io::Result<()> {
    let hashed = tensors.iter().map(|(name, tensor)| {
        let TensorBytes { dtype, shape, bytes } = tensor;
        (&name[..], HashedTensor { dtype: format!("{dtype:?}"), shape: shape.clone(), bytes })
    });
    let header = HashMap::from([(key.to_owned(), with_hash(json, &content_hash(json, hashed)))]);
    let views = tensors.iter().map(|(name, tensor)| (name, tensor));
    let bytes = safetensors::serialize(views, Some(header)).map_err(io::Error::other)?;
    files::write(path, &bytes, Existing::Replace)
}

/// The tensors of a file, as its hash covers them.
pub fn hashed_tensors<'a>(file: &'a SafeTensors<'a>) -> impl Iterator<Item = (&'a str, HashedTensor<'a>)> {
    file.iter().map(|(name, view)| {
        let dtype = format!("{:?}", view.dtype());
        (name, HashedTensor { dtype, shape: view.shape().to_vec(), bytes: view.data() })
    })
}
