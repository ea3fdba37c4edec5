//! Arguments of `sage convert`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use sage_data::{
    Format,
    dataset::Shard,
    openscenario::{EgoMode, Standard},
};

use super::{
    FolderArgs,
    formats::{ego_modes, scene_formats, standards},
    help::{OUTPUT, RUN, SCENE},
    reading::ReadingArgs,
};

/// Default number of scenes of a TFRecord file: about 0.5 GB.
const SCENES_PER_FILE: usize = 500;

/// Convert scenes between formats, on all cores.
///
/// PATH is a scene file (MetaDrive or ScenarioNet pickle, native file, JSON of GPUDrive, scenario of Argoverse 2), a TFRecord
/// file of the Waymo Open Motion Dataset (also gzip), a record of it (FILE#3 or FILE#ID), a pipe (-), or a folder of such files.
///
/// A converted file keeps its name and the folder structure; a record becomes a file named by the id of its
/// scene. With --to pickle, records become a data set that MetaDrive opens. The same command resumes an
/// interrupted run. docs/formats.md lists what each format keeps.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  sage convert scenes/ --to native --out native/
  sage convert validation.tfrecord-00000-of-00150 --to pickle --out dataset/
  sage convert scenes/ --to womd --out tfrecords/
  sage convert attacked/ --to gpudrive --out maps/
  sage convert scenes/0.pkl --to openscenario --ego controller --out scenarios/
  sage convert attacked/ --of scenes/ --to pickle --out dataset/")]
pub(crate) struct ConvertArgs {
    /// Scene files, TFRecord files, records and folders.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Output format.
    #[arg(long, alias = "format", help_heading = OUTPUT, value_name = "TO", value_parser = scene_formats(&[]))]
    pub to: Format,
    /// Version of OpenSCENARIO with --to openscenario (default: 1.2).
    #[arg(long, help_heading = OUTPUT, value_name = "VERSION", value_parser = standards())]
    pub standard: Option<Standard>,
    /// Who drives the ego with --to openscenario: the recording, or an external controller that gets a start
    /// speed and a route (default: replay).
    #[arg(long, help_heading = OUTPUT, value_name = "WHO", value_parser = ego_modes())]
    pub ego: Option<EgoMode>,
    /// Scenes that the rows of PATH attack, a file or a folder: PATH is then a row of `sage generate`, or the folder of its
    /// rows, and each row becomes an attacked scene.
    #[arg(long, help_heading = SCENE, value_name = "SCENES")]
    pub of: Option<PathBuf>,
    /// Scenes in each TFRecord file with --to womd (default: 500).
    #[arg(long, help_heading = OUTPUT, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    scenes_per_file: Option<u32>,
    /// Convert only the scenes of shard K of N; with --to womd write only its files. Several machines can write all
    /// shards into one folder, which `sage join` completes.
    #[arg(long, help_heading = RUN, value_name = "K/N", conflicts_with = "force")]
    pub shard: Option<Shard>,
    #[command(flatten)]
    pub reading: ReadingArgs,
    #[command(flatten)]
    pub folder: FolderArgs,
}

impl ConvertArgs {
    /// Scenes in each TFRecord file.
    pub(crate) fn scenes_per_file(&self) -> usize {
        self.scenes_per_file.map_or(SCENES_PER_FILE, |count| count as usize)
    }

    /// Refuses options that the output format does not have.
    ///
    /// *Errors*: the first such option.
    pub(crate) fn check(&self) -> Result<()> {
        let is_womd = self.to == Format::TfRecord;
        if self.scenes_per_file.is_some() && !is_womd {
            bail!("--scenes-per-file needs --to womd");
        }
        let is_scenario = self.to == Format::OpenScenario;
        let given = [("--standard", self.standard.is_some()), ("--ego", self.ego.is_some())];
        match given.into_iter().find(|(_, is_given)| *is_given) {
            Some((name, _)) if !is_scenario => bail!("{name} needs --to openscenario"),
            _ => Ok(()),
        }
    }
}
