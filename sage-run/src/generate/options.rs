//! What `sage generate` is asked for.

use std::path::PathBuf;

use advsage::{
    AdversarySpec, attacked_files::AttackFormats, driver_spec::DriverSpec, named_generator::GeneratorSpec,
};
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
    /// Who is the adversary.
    pub adversary: AdversarySpec,
    /// Drives the ego before the attack.
    pub ego: DriverSpec,
    /// Seconds that a driver that is a program has for its first message, that of a drive, and that of a step.
    pub ego_timeout: Option<[f64; 3]>,
    /// Seconds before the contact at which the latest evasive manoeuvre of the chosen candidate should begin.
    pub latest_start: Option<f64>,
    /// The search for evasive manoeuvres, if it is not the default one.
    pub avoidable: Option<AvoidanceOptions>,
    /// Format of the written scenes.
    pub format: AttackFormats,
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
