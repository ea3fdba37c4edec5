//! Tensors of a native file before writing.

use safetensors::Dtype;

/// A tensor to be written.
pub(super) struct Packed {
    pub(super) name: &'static str,
    pub(super) dtype: Dtype,
    pub(super) shape: Vec<usize>,
    pub(super) data: Vec<u8>,
}

/// 32-bit floats if they represent every value exactly, 64-bit floats otherwise.
pub(super) fn floats(name: &'static str, shape: Vec<usize>, values: Vec<f64>) -> Packed {
    let exact = values.iter().all(|x| f64::from(*x as f32).to_bits() == x.to_bits());
    let (dtype, data) = if exact {
        (Dtype::F32, values.iter().flat_map(|x| (*x as f32).to_le_bytes()).collect())
    } else {
        (Dtype::F64, values.iter().flat_map(|x| x.to_le_bytes()).collect())
    };
    Packed { name, dtype, shape, data }
}

/// 64-bit integers in rows of a given width.
pub(super) fn integers(name: &'static str, width: usize, values: Vec<i64>) -> Packed {
    let shape = vec![values.len() / width, width];
    Packed { name, dtype: Dtype::I64, shape, data: values.iter().flat_map(|x| x.to_le_bytes()).collect() }
}
