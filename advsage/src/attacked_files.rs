//! The files of an attacked scene: pickle, native file, JSON of GPUDrive, OpenSCENARIO.

use sage_core::{motion::Trajectory, scene::Scene};
use sage_data::{
    Recording, VariantWriter, dataset,
    openscenario::{Export, License, Options, Provenance},
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

/// Which files are written.
#[derive(Clone, Debug)]
pub struct Formats {
    /// Pickles.
    pub pickle: bool,
    /// Native files.
    pub native: bool,
    /// JSON of GPUDrive.
    pub gpudrive: bool,
    /// Choices for OpenSCENARIO files, without the licence; `None` if none are written.
    pub scenario: Option<Options>,
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
pub struct Facts<'a> {
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

impl Facts<'_> {
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
    formats: Formats,
    writer: VariantWriter,
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
    pub fn new(recording: &Recording, scene: &'s str, formats: Formats) -> Result<Self> {
        let writer = VariantWriter::new(recording)?;
        let origin = match formats.scenario {
            Some(_) => Some((scenario_files::license(recording)?, scenario_files::provenance(recording)?)),
            None => None,
        };
        Ok(Self { scene, formats, writer, origin })
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
        let (options, (license, origin)) = self.formats.scenario.clone().zip(self.origin.as_ref())?;
        Some(Scenarios {
            export: Export::new(scene, Options { license: license.clone(), ..options }),
            origin,
        })
    }

    /// Pickle, native file and JSON of an attack, as file names and contents.
    ///
    /// *Errors*: an attack that the scene cannot hold.
    pub fn files(&self, scene: &Scene, attack: &Attack) -> Result<Vec<(String, Vec<u8>)>> {
        let mut all = Vec::with_capacity(2);
        let Formats { pickle, native, gpudrive, .. } = self.formats;
        if !pickle && !native && !gpudrive {
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
        let provenance = Value::Object(provenance).to_string();
        let files = self.writer.variant(&attacked, &provenance)?;
        let name = format!("{}-{}", self.scene, attack.variant);
        if pickle {
            let (dataset, version) = (self.writer.dataset(), self.writer.version());
            all.push((dataset::file_name(dataset, version, &name), files.to_pickle()));
        }
        if native {
            all.push((format!("{name}.safetensors"), files.to_native()?));
        }
        if gpudrive {
            // Rows end in .json alone.
            all.push((format!("{name}.gpudrive.json"), files.to_gpudrive()?.json));
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
            (format!("{}-{}.xosc", self.scene, attack.variant), scenario.into_bytes()),
        ])
    }
}
