//! A suite to which failures are added.

use std::collections::{HashMap, HashSet};

use advsage::{
    attacked_files::{Attack, AttackFormats, AttackedFiles, names_of_file},
    rows::{failure::FailureRow, search::failure_name},
};
use anyhow::Result;
use sage_data::{Format, Recording, dataset, openscenario::Options};
use sage_run::output::{self, Folder};
use sage_sim::search::{
    Features,
    suite::{FILE, Found as Origin, SCENES, Suite, SuiteTest, is_plain, plan_hash},
};

use crate::commands::search::found::{json, without_folders};

/// A suite in its folder.
pub(in crate::commands) struct GrowingSuite {
    folder: Folder,
    suite: Suite,
    /// Formats of the attacked scenes.
    format: AttackFormats,
    /// File of each scene by the hash of its content.
    scenes: HashMap<String, String>,
    /// Names of the tests.
    names: HashSet<String>,
    /// Name of the test of each failure: one that two searches have found is one test.
    known: HashMap<KnownTest, String>,
}

/// What makes two tests the same.
#[derive(PartialEq, Eq, Hash)]
struct KnownTest {
    scene_hash: String,
    plan_hash: String,
    adversary: String,
}

/// A scene of the suite.
pub(in crate::commands) struct StoredScene {
    /// Its name, as part of the names of tests.
    name: String,
    file: String,
    hash: String,
}

impl GrowingSuite {
    /// A suite that grows from the one that its folder holds, or from one without tests.
    ///
    /// *Errors*: a system error.
    pub(in crate::commands) fn new(folder: Folder, suite: Suite, format: AttackFormats) -> Result<Self> {
        folder.inner(SCENES.as_ref())?;
        let of_test = |test: &SuiteTest| KnownTest {
            scene_hash: test.scene_hash.clone(),
            plan_hash: test.plan_hash.clone(),
            adversary: test.adversary.clone(),
        };
        let tests = || suite.tests.iter();
        Ok(Self {
            scenes: tests().map(|test| (test.scene_hash.clone(), test.scene.clone())).collect(),
            names: tests().map(|test| test.name.clone()).collect(),
            known: tests().map(|test| (of_test(test), test.name.clone())).collect(),
            folder,
            suite,
            format,
        })
    }

    /// Stores an unchanged scene, in the native format.
    ///
    /// *Errors*: a system error.
    pub(in crate::commands) fn store(&mut self, scene: &str, bytes: &[u8]) -> Result<StoredScene> {
        let (name, hash) = (plain(scene), blake3::hash(bytes).to_hex().to_string());
        let taken = |file: &String| self.scenes.values().any(|known| known == file);
        let file = self.scenes.get(&hash).cloned().unwrap_or_else(|| {
            let named = |k: usize| if k == 0 { format!("{name}.scene") } else { format!("{name}-{k}.scene") };
            (0..).map(named).find(|file| !taken(file)).unwrap_or_default()
        });
        self.folder.write(&format!("{SCENES}/{file}"), bytes)?;
        self.scenes.insert(hash.clone(), file.clone());
        Ok(StoredScene { name, file, hash })
    }

    /// Adds a failure of a stored scene, of which `recording` is the content; `number` is its number in its search. Returns the name of the
    /// test that holds it: of an earlier one, if the suite has it already.
    ///
    /// *Errors*: a system error, or a format that cannot hold the scene.
    pub(in crate::commands) fn add(
        &mut self,
        recording: &Recording,
        stored: &StoredScene,
        number: usize,
        features: &Features,
        failure: FailureRow,
    ) -> Result<String> {
        let scene = &*stored.name;
        let plan_hash = plan_hash(&failure.trajectory);
        let known = KnownTest {
            scene_hash: stored.hash.clone(),
            plan_hash: plan_hash.clone(),
            adversary: failure.head.adversary.clone(),
        };
        if let Some(name) = self.known.get(&known) {
            return Ok(name.clone());
        }
        let driver = without_folders(&failure.head.ego);
        let ego = plain(&driver);
        let named = |k: usize| {
            let more = if k == 0 { String::new() } else { format!("-{k}") };
            format!("{ego}-{}{more}", failure_name(number))
        };
        let is_free = |variant: &String| !self.names.contains(&format!("{scene}-{variant}"));
        let variant = (0..).map(named).find(is_free).unwrap_or_default();
        let name = format!("{scene}-{variant}");
        let files = AttackedFiles::new(recording, scene, self.format, Options::default())?;
        let generated = failure.generated.unwrap_or_default();
        let FailureRow { head, evaluated, plan, trajectory, sentence, .. } = failure;
        files.check_names(std::iter::once(&*variant))?;
        let attacked = recording.scene.clone().with_roles(None, Some(&head.adversary))?;
        let attack = Attack {
            trajectory: &trajectory,
            variant: &variant,
            generated: &generated,
            weights: None,
            seed: head.seed,
            command: &output::command(),
        };
        let mut written = files.files(&attacked, &attack)?;
        if let Some(scenarios) = files.scenarios(&attacked) {
            let mut facts = generated.to_map();
            facts.insert("seed".to_owned(), head.seed.into());
            facts.insert("adversary".to_owned(), head.adversary.clone().into());
            let after = evaluated.contact.as_ref().map(|met| met.step as f64 / 10.0);
            facts.insert("contact_after_seconds".to_owned(), after.into());
            written.extend(files.scenario(&scenarios, &attacked, &attack, &facts)?);
        }
        self.folder.write_all(&written)?;
        self.names.insert(name.clone());
        self.known.insert(known, name.clone());
        self.suite.tests.push(SuiteTest {
            name: name.clone(),
            scene: stored.file.clone(),
            scene_hash: stored.hash.clone(),
            adversary: head.adversary,
            seed: head.seed,
            plan_hash,
            plan: trajectory,
            found: Origin {
                sentence,
                ego: driver,
                plan: plan.to_map(),
                contact: evaluated.contact,
                clauses: evaluated.clauses,
                cluster: features.cluster(),
            },
        });
        Ok(name)
    }

    /// Writes what the suite says of itself.
    ///
    /// *Errors*: a system error.
    pub(in crate::commands) fn write(&self) -> Result<()> {
        self.suite.check()?;
        if self.format.has(Format::Pickle) {
            dataset::write_tables(self.folder.path())?;
        }
        self.folder.write(FILE, &serde_json::to_vec(&self.suite)?)?;
        Ok(self.folder.finish()?)
    }

    /// The suite.
    pub(in crate::commands) fn suite(&self) -> &Suite {
        &self.suite
    }
}

/// Removes the suite that a folder holds: what it says first, then what it is made of.
///
/// *Errors*: a system error.
pub(super) fn remove_old(folder: &Folder) -> Result<()> {
    let old: Option<Suite> = json(&folder.path().join(FILE)).ok();
    folder.remove(FILE)?;
    let Some(old) = old.filter(|old| old.check().is_ok()) else { return Ok(()) };
    for test in &old.tests {
        folder.remove(&format!("{SCENES}/{}", test.scene))?;
    }
    let names: HashSet<&str> = old.tests.iter().map(|test| &*test.name).collect();
    for entry in std::fs::read_dir(folder.path())? {
        let file = entry?.file_name().to_string_lossy().into_owned();
        let is_of_test = names_of_file(&file).iter().any(|name| names.contains(name));
        if is_of_test || [dataset::SUMMARY, dataset::MAPPING].contains(&&*file) {
            folder.remove(&file)?;
        }
    }
    Ok(())
}

/// A name as that of a file of a suite.
fn plain(name: &str) -> String {
    let all: String = name
        .chars()
        .map(|c| if c.is_alphanumeric() || "._-".contains(c) { c } else { '-' })
        .take(80)
        .collect();
    let name = all.trim_start_matches(['.', '-']).to_owned();
    if is_plain(&name) { name } else { "scene".to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_a_driver_are_left_out_and_names_are_plain() {
        let short = |ego: &str| (without_folders(ego), plain(&without_folders(ego)));
        let expected = |words: &str, name: &str| (words.to_owned(), name.to_owned());
        assert_eq!(short("idm"), expected("idm", "idm"));
        assert_eq!(
            short("cmd:/usr/bin/python3 /home/me/p.py"),
            expected("cmd:python3 p.py", "cmd-python3-p.py")
        );
        assert_eq!(short("td3:weights/a.safetensors"), expected("td3:a.safetensors", "td3-a.safetensors"));
        assert_eq!(short(r#"idm{"curves":3}"#), expected(r#"idm{"curves":3}"#, "idm--curves--3-"));
        assert_eq!(plain("../x"), "x");
        assert_eq!(plain(".."), "scene");
    }
}
