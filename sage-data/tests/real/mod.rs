//! Locations of the real scenes and fixtures, if they are available.

#![allow(dead_code)] // Each test binary uses some of it.

use std::{io::Write, path::PathBuf};

fn folder(variable: &str) -> Option<PathBuf> {
    let found = std::env::var_os(variable).map(PathBuf::from).filter(|path| path.exists());
    if found.is_none() {
        // Written past the test runner, which captures the output of passing tests.
        let _ = writeln!(std::io::stderr(), "left out: `{variable}` names no folder");
    }
    found
}

/// The folder with `pretrain`, `dev` and `val`.
pub fn data() -> Option<PathBuf> {
    folder("SAGE_DATA")
}

/// A fixture by name.
pub fn reference(name: &str) -> Option<PathBuf> {
    folder("SAGE_REFERENCE").map(|folder| folder.join("fixtures").join(name))
}

/// The folder with `scenarionet/` and `womd_cat500_stats.csv`.
pub fn samples() -> Option<PathBuf> {
    folder("SAGE_SAMPLES")
}

/// A Python that has numpy and `waymo_open_dataset.protos`.
pub fn waymo_python() -> Option<PathBuf> {
    let found = std::env::var_os("SAGE_WAYMO_PYTHON").map(PathBuf::from);
    if found.is_none() {
        let _ = writeln!(std::io::stderr(), "left out: `SAGE_WAYMO_PYTHON` names no Python");
    }
    found
}
