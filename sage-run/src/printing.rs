//! Tables at the end of a run.

use sage_core::text::table::Table;
use sage_sim::policy::StepTimes;

use crate::{Result, output::print, progress};

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

/// Prints to standard error the time that each driver, by its name, took for a step; those without steps are left out.
pub fn print_step_times<'t>(drivers: impl IntoIterator<Item = (&'t str, &'t StepTimes)>) {
    let milliseconds = |time: Option<f64>| format!("{:.3} ms", time.unwrap_or(f64::NAN));
    let mut table =
        Table { names: 1, ..Table::new("", &["driver", "mean time of a step", "99 % take at most"]) };
    for (driver, times) in drivers {
        if let Some(mean) = times.mean() {
            table.row(driver, [Some(mean), times.quantile(0.99)].map(milliseconds));
        }
    }
    if !table.rows.is_empty() {
        progress::say_lines(&table.terminal());
    }
}
