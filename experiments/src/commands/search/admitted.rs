//! Whether the driver of a search was admitted by `sage bench admit`.

use std::path::Path;

use advsage::driver_spec::DriverSpec;
use anyhow::{Context as _, Result};
use sage_bench::report::verdict_of;
use sage_run::progress;

/// Says what `sage bench admit` found of a driver, or that it was never asked of a planner of the user's.
///
/// *Errors*: a folder without verdicts, or without one on this driver.
pub(super) fn say(folder: Option<&Path>, driver: &DriverSpec) -> Result<()> {
    let Some(folder) = folder else {
        if driver.is_program() {
            progress::say(
                "note: whether this planner drives well enough without attacks for its failures to say something was not asked: \
                 `sage bench admit SCENES --ego … --out DIR`, then `--admitted DIR` here",
            );
        }
        return Ok(());
    };
    let name = driver.to_string();
    match verdict_of(folder, &name).context("--admitted")?.as_str() {
        "admitted" => {}
        "refused" => progress::say(&format!(
            "warning: `{name}` was refused by `sage bench admit` (`{}`): what it fails at says little",
            folder.display()
        )),
        _ => progress::say(&format!(
            "warning: whether `{name}` is admitted cannot be told yet (`{}`)",
            folder.display()
        )),
    }
    Ok(())
}
