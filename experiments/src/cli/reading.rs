//! How scene files are read.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sage_data::ReadOptions;
use sage_run::scenes::Filter;

use super::help::SCENE;

/// Place of these options in their section: after those of the command.
const LAST: usize = 800;

/// Options of reading scene files.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = SCENE)]
pub(crate) struct ReadingArgs {
    /// Frame that becomes now (at 10 Hz, from 0): reads 10 frames before it to 80 after it. Written scenes hold these
    /// frames, and their names end in -nowFRAME. Default: now is 1.0 s after the first frame, and all frames are kept.
    #[arg(long, display_order = LAST, value_name = "FRAME")]
    pub now: Option<usize>,
    /// Also resample recordings below 5 Hz to 10 Hz, down to 0.5 Hz; the motion between frames is then a guess.
    #[arg(long, display_order = LAST)]
    pub resample: bool,
    /// Frames per second of a file without times, such as JSON of GPUDrive; the scene is resampled to 10 Hz.
    #[arg(long, display_order = LAST, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// Trust these values of a file, and recompute those that contradict them.
    #[arg(long, display_order = LAST, value_name = "WHAT", value_enum)]
    pub trust: Option<Trust>,
    /// Read this road user as the ego, in place of the one that the file names; some files of GPUDrive name none.
    #[arg(long, display_order = LAST, value_name = "ID")]
    pub ego_track: Option<String>,
    /// Leave out these road users, by comma-separated ids; written scenes are without them. If one is the adversary, another is
    /// selected.
    #[arg(long, display_order = LAST, value_name = "IDS", value_delimiter = ',')]
    pub without: Vec<String>,
    /// Refuse a scene in which any road user has an unusable value, instead of leaving that road user out.
    #[arg(long, display_order = LAST)]
    pub strict: bool,
}

/// A number of frames per second.
fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse::<f64>().ok().filter(|rate| (0.5..=1000.0).contains(rate));
    rate.ok_or_else(|| "expected frames per second, such as 20".to_owned())
}

/// What is trusted where values of a file contradict each other.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Trust {
    /// Velocities and headings are recomputed from the positions.
    Positions,
}

impl ReadingArgs {
    /// The options of the reader.
    pub(crate) fn options(&self) -> ReadOptions {
        let Self { now, resample, rate, trust, strict, ego_track, without } = self.clone();
        ReadOptions { now, resample, rate, trust_positions: trust.is_some(), ego_track, without, strict }
    }
}

/// Filters of the given scenes.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = SCENE)]
pub(crate) struct SplitArgs {
    /// JSON file of splits: an object of split names with lists of scene names.
    #[arg(long, value_name = "FILE")]
    pub splits: Option<PathBuf>,
    /// Use only the scenes of this split.
    #[arg(long, value_name = "NAME", requires = "splits")]
    pub split: Option<String>,
    /// Leave out the scenes of this split.
    #[arg(long, value_name = "NAME", requires = "splits")]
    pub without_split: Option<String>,
    /// Use only the scenes with these comma-separated names.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub scenes: Vec<String>,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

impl SplitArgs {
    /// The scenes that are chosen.
    pub(crate) fn filter(&self) -> Filter {
        Filter {
            splits: self.splits.clone(),
            split: self.split.clone(),
            without_split: self.without_split.clone(),
            scenes: self.scenes.clone(),
            reading: self.reading.options(),
        }
    }
}
