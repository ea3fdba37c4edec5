//! What `sage generate` is asked for.

use std::{path::PathBuf, str::FromStr};

use advsage::{named_generator::GeneratorSpec, part::PolicyPart};
use sage_data::{
    ReadOptions,
    openscenario::{EgoMode, Standard},
};
use sage_sim::avoidable::AvoidanceOptions;

/// The options of a run.
#[derive(Clone, Debug)]
pub struct GenerateOptions {
    /// Scene file, TFRecord file, record, or folder of them.
    pub scene: PathBuf,
    /// What attacks.
    pub generator: GeneratorSpec,
    /// Track of the adversary, in place of that of the scene.
    pub adversary: Option<String>,
    /// Drives the ego before the attack.
    pub ego: PolicyPart,
    /// Seconds that a driver that is a program has for its first message, that of a drive, and that of a step.
    pub ego_timeout: Option<[f64; 3]>,
    /// Seconds before the contact at which the latest evasive manoeuvre of the chosen candidate should begin.
    pub latest_start: Option<f64>,
    /// The search for evasive manoeuvres, if it is not the default one.
    pub avoidable: Option<AvoidanceOptions>,
    /// Format of the written scenes.
    pub format: DatasetFormat,
    /// Version of OpenSCENARIO.
    pub standard: Option<Standard>,
    /// Who drives the ego of a scenario.
    pub scenario_ego: Option<EgoMode>,
    /// How scenes are read.
    pub reading: ReadOptions,
    /// The output folder.
    pub out: PathBuf,
    /// Whether a folder that is not empty is written into.
    pub force: bool,
    /// Whether results are printed as JSON.
    pub json: bool,
    /// Whether only the table at the end is printed.
    pub quiet: bool,
    /// Whether pages and pictures are left out.
    pub no_pages: bool,
    /// Whether candidates that were not selected are left out of the rows.
    pub no_candidates: bool,
}

/// Formats of the scene files of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DatasetFormat {
    /// MetaDrive pickles, with `dataset_summary.pkl` and `dataset_mapping.pkl`.
    Pickle,
    /// Pickles and native files.
    Both,
    /// No scene files: rows, pages and pictures alone.
    Rows,
    /// Native files (safetensors).
    Native,
    /// JSON of GPUDrive, in which simulators drive the attack and their policy the ego.
    Gpudrive,
    /// OpenSCENARIO files and their OpenDRIVE maps, for simulators.
    Openscenario,
}

impl DatasetFormat {
    /// All formats with their names and what they are.
    pub const ALL: [(Self, &str, &str); 6] = [
        (Self::Pickle, "pickle", "MetaDrive pickles, with `dataset_summary.pkl` and `dataset_mapping.pkl`"),
        (Self::Both, "both", "Pickles and native files"),
        (Self::Rows, "rows", "No scene files: rows, pages and pictures alone"),
        (Self::Native, "native", "Native files (safetensors)"),
        (
            Self::Gpudrive,
            "gpudrive",
            "JSON of GPUDrive, in which simulators drive the attack and their policy the ego",
        ),
        (Self::Openscenario, "openscenario", "OpenSCENARIO files and their OpenDRIVE maps, for simulators"),
    ];
}

impl FromStr for DatasetFormat {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|(_, own, _)| *own == name);
        let known = || Self::ALL.map(|(_, name, _)| name).join(", ");
        Ok(found.ok_or_else(|| format!("unknown format `{name}`; known: {}", known()))?.0)
    }
}
