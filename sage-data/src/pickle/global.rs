//! The functions and classes that a scene file may name. All others are refused, and none is executed.

/// Globals that scene files use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Global {
    /// `numpy.core.multiarray._reconstruct` and its `_core` twin.
    Reconstruct,
    /// `numpy.core.numeric._frombuffer` and its `_core` twin (protocol 5).
    FromBuffer,
    /// `numpy.core.multiarray.scalar` and its `_core` twin.
    Scalar,
    /// `numpy.ndarray`.
    NdArray,
    /// `numpy.dtype`.
    Dtype,
    /// `_codecs.encode`, by which protocol 2 writes bytes.
    Encode,
    /// `collections.defaultdict`.
    DefaultDict,
    /// `builtins.int`, a defaultdict's factory.
    Int,
    /// `builtins.set`.
    Set,
    /// `__builtin__.bytes` without arguments, by which protocol 2 writes empty bytes.
    Bytes,
}

impl Global {
    /// Parses the name of a global. `__builtin__` is Python 2's module; Python 3 accepts it only in
    /// protocol 2.
    pub(super) fn from_name(module: &[u8], name: &[u8], protocol: u8) -> Option<Self> {
        if module == b"__builtin__" && protocol > 2 {
            return None;
        }
        Some(match (module, name) {
            (b"numpy.core.multiarray" | b"numpy._core.multiarray", b"_reconstruct") => Self::Reconstruct,
            (b"numpy.core.numeric" | b"numpy._core.numeric", b"_frombuffer") => Self::FromBuffer,
            (b"numpy.core.multiarray" | b"numpy._core.multiarray", b"scalar") => Self::Scalar,
            (b"numpy", b"ndarray") => Self::NdArray,
            (b"numpy", b"dtype") => Self::Dtype,
            (b"_codecs", b"encode") => Self::Encode,
            (b"collections", b"defaultdict") => Self::DefaultDict,
            // In protocol 2, Python 3 writes `int` as Python 2's `long`.
            (b"builtins" | b"__builtin__", b"int") | (b"__builtin__", b"long") => Self::Int,
            (b"builtins" | b"__builtin__", b"set") => Self::Set,
            (b"__builtin__", b"bytes") => Self::Bytes,
            _ => return None,
        })
    }
}
