//! Builds the driver under test from its name, with what is said of it in results.

use std::{path::Path, sync::Arc};

use sage_core::files;
use sage_data::MAX_SCENE_FILE;
use sage_sim::{
    SimScene, attack_test::AttackTest, fault::FaultRule, policy::EgoPolicy, reference::Reference,
};
use serde_json::{Value, json};

use crate::{Error, Registries, Result, WithContext as _, driver_spec::DriverSpec, references};

/// A driver under test.
///
/// ```
/// use std::{path::Path, sync::Arc};
///
/// use advsage::{DriverInScene, Ego, Recording, Registries};
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let registries = Registries::of_attacks()?;
/// let scene = Arc::new(Recording::read(file)?.scene);
/// let idm = Ego::named(r#"idm{"model": {"desired_speed": 8}}"#, &registries)?;
/// assert_eq!(idm.name, "idm");
/// // Four other drivers say whether its contacts are preventable; it is no reference for itself.
/// assert!(idm.references.iter().all(|reference| reference.name != "idm"));
/// let drive = DriverInScene::of(&scene, &idm, 0)?;
/// assert_eq!(drive.test.unattacked_drive().steps, 90);
/// # Ok::<(), advsage::Error>(())
/// ```
pub struct Ego {
    /// Its name.
    pub name: String,
    /// Its name and options, as tables show them.
    pub label: String,
    /// Name of its random streams: without red lights that of earlier versions, so that intervals keep their bits.
    pub stream: String,
    /// The policy.
    pub policy: Box<dyn EgoPolicy>,
    /// Whether it is a program, which keeps a log.
    pub is_program: bool,
    /// The drivers that say whether its contacts are preventable.
    pub references: Vec<Reference>,
    /// The rule that says whether it is at fault.
    pub fault: FaultRule,
}

impl Ego {
    /// Builds a policy from a name, such as `idm`, `td3{"file": "driver.safetensors"}` or `cmd:COMMAND`.
    ///
    /// *Errors*: as [`Ego::new`]; a text that is no name.
    pub fn named(name: &str, registries: &Registries) -> Result<Self> {
        Self::new(&name.parse().map_err(Error::Value)?, registries)
    }

    /// Builds the policy.
    ///
    /// *Errors*: the name is not registered, or the policy refuses the options.
    pub fn new(named: &DriverSpec, registries: &Registries) -> Result<Self> {
        let part = &named.part();
        let is_command = registries.policies.get(&part.name).is_err()
            && (part.name.contains([' ', '/']) || Path::new(&part.name).is_file());
        let hint = || format!("to run a program as the driver, write --ego 'cmd:{}'", part.name);
        let policy = part.build(&registries.policies);
        let policy = if is_command { policy.with_context(hint)? } else { policy? };
        let mut earlier = named.clone();
        earlier.options.retain(|key, value| key != "red_lights" || *value != json!(false));
        let references = references::references(&references::default_names(), &part.name, registries)?;
        let (label, stream) = (named.to_string(), earlier.without_name());
        Ok(Self {
            name: part.name.clone(),
            label,
            stream,
            policy,
            is_program: named.names_program(),
            references,
            fault: FaultRule::default(),
        })
    }

    /// Its test in a scene.
    ///
    /// *Errors*: as [`AttackTest::new`].
    pub fn test(&self, scene: &Arc<SimScene>, seed: u64) -> Result<AttackTest<'_>, sage_sim::Error> {
        self.test_of(&*self.policy, scene, seed)
    }

    /// The same of its policy in another one, such as one whose steps are timed.
    ///
    /// *Errors*: as [`AttackTest::new`].
    pub fn test_of<'e>(
        &'e self,
        policy: &'e dyn EgoPolicy,
        scene: &Arc<SimScene>,
        seed: u64,
    ) -> Result<AttackTest<'e>, sage_sim::Error> {
        Ok(AttackTest::new(policy, scene, seed)?.with_references(&self.references).with_fault(self.fault))
    }

    /// Its name as part of file names.
    pub fn file_name(&self) -> String {
        let keep = |c: char| if c.is_alphanumeric() || "._-".contains(c) { c } else { '-' };
        self.label.chars().map(keep).take(80).collect()
    }

    /// Takes other reference drivers than the default ones.
    ///
    /// *Errors*: as [`references::references`].
    pub fn with_references(mut self, names: &[String], registries: &Registries) -> Result<Self> {
        self.references = references::references(names, &self.name, registries)?;
        Ok(self)
    }

    /// Builds several policies.
    ///
    /// *Errors*: as [`Ego::new`]; one is given twice.
    pub fn all(parts: &[DriverSpec], registries: &Registries) -> Result<Vec<Self>> {
        let egos = parts.iter().map(|part| Self::new(part, registries)).collect::<Result<Vec<_>>>()?;
        match (1..egos.len()).find(|&k| egos[..k].iter().any(|ego| ego.label == egos[k].label)) {
            Some(twice) => Err(Error::Value(format!("the policy `{}` is given twice", egos[twice].label))),
            None => Ok(egos),
        }
    }
}

/// What identifies a policy in the record of a run. Another content of a file that describes it, or that its command names
/// or has beside it, is another run.
///
/// *Errors*: a file cannot be read.
pub fn identity(part: &DriverSpec) -> Result<Value> {
    let mut all = vec![json!(part.for_identity())];
    for file in part.files_and_beside() {
        let shown = file.display();
        let hash = if part.names_program() { file_hash(&file) } else { content_hash(&file) };
        let hash = hash.with_context(|| format!("cannot read `{shown}`"))?;
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        all.push(json!(format!("{name} {hash}")));
    }
    Ok(if all.len() == 1 { all.remove(0) } else { json!(all) })
}

fn content_hash(file: &Path) -> std::io::Result<String> {
    Ok(blake3::hash(&files::read(file, MAX_SCENE_FILE)?).to_hex()[..16].to_owned())
}

/// Hash of a file of any size, such as a program.
fn file_hash(file: &Path) -> std::io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(std::fs::File::open(file)?)?;
    Ok(hasher.finalize().to_hex()[..16].to_owned())
}
