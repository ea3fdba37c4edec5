//! Errors of what users name, grouped by how a caller can react. Functions of this crate return `anyhow::Error`, so that
//! messages gather causes; the cause is one of these, or the error of a crate below.

/// An error of `sage-bench`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A name that nothing has: of weights, of a selection.
    #[error("{0}")]
    Unknown(String),
    /// A value that is out of range, or given twice.
    #[error("{0}")]
    Value(String),
}
