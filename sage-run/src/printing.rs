//! Tables at the end of a run.

use anyhow::Result;
use sage_core::text::table::Table;

use crate::{output::print, progress};

/// Prints the table at the end of a run: to standard output, or to standard error if that holds JSON rows.
///
/// *Errors*: standard output is closed or full.
pub fn print_table(table: &Table, beside_json: bool) -> Result<()> {
    let text = table.terminal();
    if beside_json {
        progress::say_lines(&text);
        return Ok(());
    }
    print(&format!("\n{text}"))
}
