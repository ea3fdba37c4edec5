//! Rows: results as files hold them, and in words.

pub mod attack;
pub mod contact;
pub mod drive;
mod drive_panel;
pub mod found_attack;
pub mod plan;
pub mod search;

/// Size limit of a row, bytes. A thousand candidates take 4 MB.
pub const ROW_LIMIT: u64 = 1 << 30;
