//! Rows: results as files hold them, and in words.

pub mod attack;
pub mod contact;
pub mod drive;
mod drive_panel;
pub mod evaluated;
pub mod failure;
mod generated_by;
pub mod plan;
pub mod rate;
pub mod search;

pub use generated_by::GeneratedBy;

/// Size limit of a row, bytes. A thousand candidates take 4 MB.
pub const ROW_LIMIT: u64 = 1 << 30;
