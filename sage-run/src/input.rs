//! Input files that the user names on the command line.

use std::path::{Path, PathBuf};

use advsage::WithContext as _;
use sage_core::files;
use sage_data::{folder, womd};

use crate::Result;

/// Size limit of a configuration file, bytes.
const CONFIG_LIMIT: u64 = 1 << 20;

/// Reads a configuration file as text.
///
/// *Errors*: the file cannot be read, or exceeds the size limit.
pub fn read_config(path: &Path) -> Result<String> {
    let text = files::read_argument_text(path, CONFIG_LIMIT);
    Ok(text.with_context(|| format!("cannot read `{}`", path.display()))?)
}

/// Name of a scene for its outputs: that of its file, the id of a record, or `stdin` for standard input.
///
/// *Errors*: a record that cannot be read.
pub fn scene_name(file: &Path) -> Result<String, sage_data::Error> {
    if file.to_str() == Some("-") { Ok("stdin".to_owned()) } else { folder::scene_name(file) }
}

/// Checks that the only scene of a command is there, before the command starts.
///
/// *Errors*: there is no such file.
pub fn check_single(scenes: &[PathBuf]) -> Result<()> {
    if let [file] = scenes
        && file.to_str() != Some("-")
        && !womd::is_record_path(file)
    {
        std::fs::metadata(file).with_context(|| format!("cannot read `{}`", file.display()))?;
    }
    Ok(())
}
