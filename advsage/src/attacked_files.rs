//! The files of an attacked scene: pickle, native file, JSON of GPUDrive, OpenSCENARIO.

use std::str::FromStr;

use sage_core::{motion::Trajectory, scene::Scene};
use sage_data::{
    ADDED, Format, Recording, VariantWriter, added_tracks, dataset,
    openscenario::{EgoMode, Export, License, Options, Provenance, Standard},
};
use sage_generators::attacked;
use serde_json::{Map, Value, json};

use crate::{
    Error, Result,
    rows::GeneratedBy,
    scenario_files::{self, with_facts},
};

/// Length limit of a file name on common file systems, bytes.
pub const LONGEST_FILE_NAME: usize = 255;

/// Which scene files are written of an attack.
///
/// ```
/// use advsage::attacked_files::{AttackFormats, names_of_file};
/// use sage_data::Format;
///
/// let formats: AttackFormats = "both".parse()?;
/// assert_eq!(formats.formats(), [Format::Pickle, Format::Native]);
/// // Names are `SCENE-VARIANT`; a scene may have hyphens too.
/// assert!(names_of_file("sd_waymo_v1.2_crossing-lambda1.pkl").contains(&"crossing-lambda1"));
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AttackFormats {
    /// Files of one format.
    One(Format),
    /// Pickles and native files.
    Both,
    /// No scene files: the rows alone hold the plans.
    Rows,
}

impl AttackFormats {
    /// All choices: each format that scenes are written in one by one, both that the simulation reads, and none.
    pub fn all() -> Vec<Self> {
        let single = Format::all_written().filter(|format| *format != Format::TfRecord).map(Self::One);
        let mut all: Vec<Self> = single.collect();
        all.insert(2, Self::Both);
        all.push(Self::Rows);
        all
    }

    /// Name of the choice.
    pub fn name(self) -> &'static str {
        match self {
            Self::One(format) => format.name(),
            Self::Both => "both",
            Self::Rows => "rows",
        }
    }

    /// What is written.
    pub fn about(self) -> &'static str {
        match self {
            Self::One(format) => format.about(),
            Self::Both => "Pickles and native files",
            Self::Rows => "No scene files: the rows alone hold the plans",
        }
    }

    /// The formats, in the order in which files are listed.
    pub fn formats(self) -> Vec<Format> {
        match self {
            Self::One(format) => vec![format],
            Self::Both => vec![Format::Pickle, Format::Native],
            Self::Rows => Vec::new(),
        }
    }

    /// Whether a format is among them.
    pub fn has(self, format: Format) -> bool {
        self.formats().contains(&format)
    }

    /// Refuses options of OpenSCENARIO where it is not written.
    ///
    /// *Errors*: one of them is given.
    pub fn check_scenario(self, standard: Option<Standard>, ego: Option<EgoMode>) -> Result<()> {
        if !self.has(Format::OpenScenario) && (standard.is_some() || ego.is_some()) {
            let problem = "--standard and --scenario-ego need --format openscenario";
            return Err(Error::Value(problem.to_owned()));
        }
        Ok(())
    }
}

impl FromStr for AttackFormats {
    type Err = String;

    fn from_str(name: &str) -> std::result::Result<Self, String> {
        // Searches called it so.
        let name = if name == "none" { "rows" } else { name };
        let all = Self::all();
        let found = all.iter().copied().find(|choice| choice.name() == name);
        found.ok_or_else(|| {
            let known: Vec<&str> = all.iter().map(|choice| choice.name()).collect();
            format!("unknown format `{name}`; known: {}", known.join(", "))
        })
    }
}

/// The names of attacks, `SCENE-VARIANT`, that a file may be of by its name.
pub fn names_of_file(file: &str) -> Vec<&str> {
    let stem = |format: Format| file.strip_suffix(format.ending_beside_rows())?.strip_suffix('.');
    let mut names: Vec<&str> =
        Format::all_written().filter(|format| *format != Format::Pickle).filter_map(stem).collect();
    // `sd_<dataset>_<version>_<name>.pkl`
    if let Some(stem) = stem(Format::Pickle).filter(|stem| stem.starts_with("sd_")) {
        names.extend(stem.match_indices('_').map(|(k, _)| &stem[k + 1..]));
    }
    names
}

/// What an attacked scene is made from, beside the scene and the plan.
pub struct Attack<'a> {
    /// The adversary's plan.
    pub trajectory: &'a Trajectory,
    /// Name of the attack, as part of file names.
    pub variant: &'a str,
    /// How it was generated.
    pub generated: &'a GeneratedBy,
    /// Name of the weights; `None` without.
    pub weights: Option<&'a str>,
    /// Seed of the run.
    pub seed: u64,
    /// The command that generated it.
    pub command: &'a str,
}

/// What an OpenSCENARIO file says about its attack.
pub struct AttackSummary<'a> {
    /// Seed of the run.
    pub seed: u64,
    /// Track of the adversary.
    pub adversary: &'a str,
    /// Whether the plan is feasible.
    pub feasible: bool,
    /// Step of the contact, after *now*.
    pub collision_step: Option<usize>,
    /// Adversarial reward of the paper.
    pub adversarial_reward: f64,
    /// Kinematic penalty of the paper.
    pub kinematic_penalty: f64,
    /// Behaviour penalty of the paper.
    pub behavior_penalty: f64,
}

impl AttackSummary<'_> {
    /// The facts and how the attack was generated.
    pub fn and(&self, generated: &GeneratedBy) -> Map<String, Value> {
        let mut facts = generated.to_map();
        for (key, value) in [
            ("seed", json!(self.seed)),
            ("adversary", json!(self.adversary)),
            ("feasible", json!(self.feasible)),
            ("contact_after_seconds", json!(self.collision_step.map(|step| step as f64 / 10.0))),
            ("adversarial_reward", json!(self.adversarial_reward)),
            ("kinematic_penalty", json!(self.kinematic_penalty)),
            ("behavior_penalty", json!(self.behavior_penalty)),
        ] {
            facts.insert(key.to_owned(), value);
        }
        facts
    }
}

/// Writes attacks into one recorded scene.
pub struct AttackedFiles<'s> {
    scene: &'s str,
    formats: AttackFormats,
    scenario: Options,
    writer: VariantWriter,
    /// Ids of road users who were added to the recording.
    added: Vec<String>,
    origin: Option<(Option<License>, Provenance)>,
}

/// The OpenSCENARIO files of one scene: their map is made once.
pub struct Scenarios<'f> {
    export: Export,
    origin: &'f Provenance,
}

impl<'s> AttackedFiles<'s> {
    /// A writer for a recording, whose files have names that begin with `scene`.
    ///
    /// *Errors*: the recording cannot be written, or has no licence or origin that OpenSCENARIO could state.
    pub fn new(
        recording: &Recording,
        scene: &'s str,
        formats: AttackFormats,
        scenario: Options,
    ) -> Result<Self> {
        let writer = VariantWriter::new(recording)?;
        let origin = match formats.has(Format::OpenScenario) {
            true => Some((scenario_files::license(recording)?, scenario_files::provenance(recording)?)),
            false => None,
        };
        let added = recording.provenance()?.as_deref().map(added_tracks).unwrap_or_default();
        Ok(Self { scene, formats, scenario, writer, added, origin })
    }

    /// Refuses a scene whose outputs would have names that no file can have.
    ///
    /// *Errors*: the name of a variant is too long.
    pub fn check_names<'v>(&self, variants: impl Iterator<Item = &'v str>) -> Result<()> {
        for variant in variants {
            let (dataset, version) = (self.writer.dataset(), self.writer.version());
            let name = dataset::file_name(dataset, version, &format!("{}-{variant}", self.scene));
            if name.len() > LONGEST_FILE_NAME {
                return Err(Error::Value(format!(
                    "an output would have a name of {} bytes, more than {LONGEST_FILE_NAME}; rename the scene file",
                    name.len()
                )));
            }
        }
        Ok(())
    }

    /// The OpenSCENARIO files of a scene; `None` if none are written.
    pub fn scenarios(&self, scene: &Scene) -> Option<Scenarios<'_>> {
        let (license, origin) = self.origin.as_ref()?;
        Some(Scenarios {
            export: Export::new(scene, Options { license: license.clone(), ..self.scenario.clone() }),
            origin,
        })
    }

    /// Pickle, native file and JSON of an attack, as file names and contents.
    ///
    /// *Errors*: an attack that the scene cannot hold.
    pub fn files(&self, scene: &Scene, attack: &Attack) -> Result<Vec<(String, Vec<u8>)>> {
        let mut all = Vec::with_capacity(2);
        if self.formats.formats().iter().all(|format| *format == Format::OpenScenario) {
            return Ok(all);
        }
        let mut provenance = attack.generated.to_map();
        for (key, value) in [
            ("by", json!(concat!("sage ", env!("CARGO_PKG_VERSION")))),
            ("command", json!(attack.command)),
            ("weights", json!(attack.weights)),
            ("seed", json!(attack.seed)),
        ] {
            provenance.insert(key.to_owned(), value);
        }
        let attacked = attacked(scene, attack.trajectory)?;
        let adversary = attacked.adversary.map(|track| attacked.tracks[track].id.as_str());
        provenance.insert("adversary".to_owned(), json!(adversary));
        if !self.added.is_empty() {
            provenance.insert(ADDED.to_owned(), json!(self.added));
        }
        let provenance = Value::Object(provenance).to_string();
        let files = self.writer.variant(&attacked, &provenance)?;
        let name = format!("{}-{}", self.scene, attack.variant);
        for format in self.formats.formats() {
            let Some(bytes) = files.encode(format)? else { continue };
            let file = match format {
                Format::Pickle => dataset::file_name(self.writer.dataset(), self.writer.version(), &name),
                other => format!("{name}.{}", other.ending_beside_rows()),
            };
            all.push((file, bytes));
        }
        Ok(all)
    }

    /// Map and scenario of an attack. The scenario goes after its map.
    ///
    /// *Errors*: as [`AttackedFiles::files`].
    pub fn scenario(
        &self,
        scenarios: &Scenarios,
        scene: &Scene,
        attack: &Attack,
        facts: &Map<String, Value>,
    ) -> Result<[(String, Vec<u8>); 2]> {
        let attacked = attacked(scene, attack.trajectory)?;
        let scenario = scenarios.export.scenario(&attacked, &with_facts(scenarios.origin.clone(), facts));
        let network = scenarios.export.network();
        Ok([
            (network.file_name(), network.xml.clone().into_bytes()),
            (
                format!("{}-{}.{}", self.scene, attack.variant, Format::OpenScenario.ending()),
                scenario.into_bytes(),
            ),
        ])
    }
}
