//! `sage suite`: keeps failures of searches as tests.

use std::{
    collections::{HashMap, HashSet},
    path::Path,
};

use anyhow::{Context as _, Result, anyhow, bail, ensure};
use sage_core::{files, motion::Trajectory, objective::PartSpec};
use sage_data::{Recording, dataset};
use sage_sim::search::{
    Clauses, Met, SearchOptions,
    suite::{Found, MOST_TESTS, SCENES, Suite, SuiteTest, VERSION, is_plain, plan_hash},
};
use serde::Deserialize;
use serde_json::{Map, Value};

use super::search::{SceneRow, failure_name, row_file, unchanged_file};
use crate::{
    Outcome,
    attacked_files::{Attack, AttackedFiles, Formats},
    cli::{Keep, SearchFormat, SuiteArgs},
    output::{self, Folder, RECORD},
    progress,
    scene_queue::{ROW_LIMIT, is_row_of},
};

/// File of a suite.
pub(super) const FILE: &str = "suite.json";

/// What a suite needs of the row of a failure.
#[derive(Deserialize)]
struct FailureFile {
    ego: String,
    adversary: String,
    seed: u64,
    trajectory: Trajectory,
    plan: Map<String, Value>,
    contact: Option<Met>,
    clauses: Clauses,
    #[serde(flatten)]
    described: Map<String, Value>,
}

/// What a suite needs of the record of a search.
#[derive(Deserialize)]
struct SearchRecord {
    search: SearchOptions,
    feasibility: PartSpec,
}

/// A suite that grows.
struct Maker<'a> {
    args: &'a SuiteArgs,
    folder: Folder,
    suite: Option<Suite>,
    /// File of each scene by the hash of its content.
    scenes: HashMap<String, String>,
    /// Names of the tests.
    names: HashSet<String>,
}

/// A search as a suite reads it.
struct Search<'a> {
    folder: &'a Path,
    record: SearchRecord,
    rows: Vec<SceneRow>,
}

impl<'a> Search<'a> {
    /// Reads the record of a search and the rows of its scenes with a failure.
    ///
    /// *Errors*: it is no search, or cannot be read.
    fn read(folder: &'a Path) -> Result<Self> {
        let record: Value = json(&folder.join(RECORD)).context("it is no output of `sage search`")?;
        let hash = output::run_hash(&record["run"]);
        if record["seconds"].is_null() {
            progress::say(&format!("note: the search in `{}` is not complete", folder.display()));
        }
        let record: SearchRecord =
            serde_json::from_value(record["run"].clone()).context("it is no output of `sage search`")?;
        let mut rows: Vec<SceneRow> = Vec::new();
        for entry in std::fs::read_dir(folder)? {
            let name = entry?.file_name().to_string_lossy().into_owned();
            if name.ends_with(".json") && name != RECORD {
                // Rows of another run remain after --force with fewer scenes.
                let path = folder.join(&name);
                let row = if is_row_of(&path, &hash) { SceneRow::read(&path) } else { None };
                let row = row.filter(|row| row_file(row.scene()) == name);
                rows.extend(row.filter(|row| row.failures() > 0));
            }
        }
        rows.sort_by(|a, b| sage_data::folder::natural_order(a.scene(), b.scene()));
        Ok(Self { folder, record, rows })
    }

    /// Checks that it can be in one suite with another search.
    ///
    /// *Errors*: it requires something else, or its unchanged scenes are missing.
    fn check(&self, first: &Self) -> Result<()> {
        let [own, other] = [&self.record, &first.record];
        ensure!(
            own.search.require == other.search.require
                && own.feasibility == other.feasibility
                && own.search.avoidable == other.search.avoidable,
            "it requires other clauses than the first search, or by other rules; make a suite of its own"
        );
        for row in &self.rows {
            let file = unchanged_file(row.scene());
            ensure!(
                self.folder.join(&file).is_file(),
                "`{file}` is missing; search again without --format none"
            );
        }
        Ok(())
    }
}

pub(crate) fn run(args: &SuiteArgs) -> Result<Outcome> {
    let read = |folder| Search::read(folder).with_context(|| format!("`{}`", folder.display()));
    let searches: Vec<Search> = args.searches.iter().map(|folder| read(folder)).collect::<Result<_>>()?;
    ensure!(searches.iter().any(|search| !search.rows.is_empty()), "the searches hold no failure");
    searches.iter().try_for_each(|search| {
        search.check(&searches[0]).with_context(|| format!("`{}`", search.folder.display()))
    })?;
    let folder = Folder::make(&args.folder.out, args.folder.force)?;
    remove_old(&folder)?;
    folder.inner(SCENES.as_ref())?;
    let mut maker = Maker { args, folder, suite: None, scenes: HashMap::new(), names: HashSet::new() };
    for search in &searches {
        maker.add_search(search).with_context(|| format!("`{}`", search.folder.display()))?;
    }
    let Maker { folder, suite, .. } = maker;
    let suite = suite.context("a search was added")?;
    suite.check().map_err(|problem| anyhow!(problem))?;
    if matches!(args.format, SearchFormat::Pickle | SearchFormat::Both) {
        dataset::write_tables(folder.path())?;
    }
    folder.write(FILE, &serde_json::to_vec(&suite)?)?;
    progress::say(&format!(
        "{} of {} are in `{}`; to drive against them: sage test {} --ego POLICY",
        progress::count(suite.tests.len(), "test"),
        progress::count(args.searches.len(), "search"),
        folder.path().display(),
        folder.path().display()
    ));
    Ok(Outcome::Done)
}

impl Maker<'_> {
    fn add_search(&mut self, Search { folder, record, rows }: &Search) -> Result<()> {
        self.suite.get_or_insert_with(|| Suite {
            suite: VERSION,
            require: record.search.require,
            feasibility: record.feasibility.clone(),
            avoidable: record.search.avoidable,
            tests: Vec::new(),
        });
        rows.iter().try_for_each(|row| {
            self.add_scene(folder, row).with_context(|| format!("scene `{}`", row.scene()))
        })
    }

    fn add_scene(&mut self, search: &Path, row: &SceneRow) -> Result<()> {
        let source = search.join(unchanged_file(row.scene()));
        let bytes = sage_data::read_bytes(&source).with_context(|| {
            format!("`{}` is missing; search again without --format none", source.display())
        })?;
        let scene_hash = blake3::hash(&bytes).to_hex().to_string();
        let name = plain(row.scene());
        let taken = |file: &String| self.scenes.values().any(|known| known == file);
        let file = self.scenes.get(&scene_hash).cloned().unwrap_or_else(|| {
            let named = |k: usize| if k == 0 { format!("{name}.scene") } else { format!("{name}-{k}.scene") };
            (0..).map(named).find(|file| !taken(file)).unwrap_or_default()
        });
        self.folder.write(&format!("{SCENES}/{file}"), &bytes)?;
        self.scenes.insert(scene_hash.clone(), file.clone());
        let recording = Recording::from_bytes(&source, bytes)?;
        ensure!(row.failures() <= MOST_TESTS, "its row counts {} failures", row.failures());
        let numbers: Vec<usize> = match self.args.keep {
            Keep::All => (1..=row.failures()).collect(),
            Keep::Worst => row.worst().into_iter().collect(),
            Keep::Mildest => row.mildest().into_iter().collect(),
        };
        for number in numbers {
            let failure: FailureFile =
                json(&search.join(row_file(&format!("{}-{}", row.scene(), failure_name(number)))))?;
            self.add_test(&recording, &name, number, [&file, &scene_hash], failure)?;
        }
        Ok(())
    }

    fn add_test(
        &mut self,
        recording: &Recording,
        scene: &str,
        number: usize,
        [file, scene_hash]: [&String; 2],
        failure: FailureFile,
    ) -> Result<()> {
        let tests = self.suite.as_mut().map(|suite| &mut suite.tests).context("a search was added")?;
        ensure!(tests.len() < MOST_TESTS, "a suite has at most {MOST_TESTS} tests");
        let driver = without_folders(&failure.ego);
        let ego = plain(&driver);
        let named = |k: usize| {
            let more = if k == 0 { String::new() } else { format!("-{k}") };
            format!("{ego}-{}{more}", failure_name(number))
        };
        let is_free = |variant: &String| !self.names.contains(&format!("{scene}-{variant}"));
        let variant = (0..).map(named).find(is_free).unwrap_or_default();
        self.names.insert(format!("{scene}-{variant}"));
        let formats = Formats {
            pickle: matches!(self.args.format, SearchFormat::Pickle | SearchFormat::Both),
            native: matches!(self.args.format, SearchFormat::Native | SearchFormat::Both),
            scenario: (self.args.format == SearchFormat::Openscenario).then(Default::default),
        };
        let files = AttackedFiles::new(recording, scene, formats)?;
        let mut described = failure.described.clone();
        described.retain(|key, _| DESCRIPTION.contains(&&**key));
        files.check_names(std::iter::once(&*variant))?;
        let attacked = recording.scene.clone().with_roles(None, Some(&failure.adversary))?;
        let attack = Attack {
            trajectory: &failure.trajectory,
            variant: &variant,
            described: &described,
            weights: None,
            seed: failure.seed,
        };
        let mut written = files.files(&attacked, &attack)?;
        if let Some(scenarios) = files.scenarios(&attacked) {
            let mut facts = described.clone();
            facts.insert("seed".to_owned(), failure.seed.into());
            facts.insert("adversary".to_owned(), failure.adversary.clone().into());
            let after = failure.contact.as_ref().map(|met| met.step as f64 / 10.0);
            facts.insert("contact_after_seconds".to_owned(), after.into());
            written.extend(files.scenario(&scenarios, &attacked, &attack, &facts)?);
        }
        for (name, bytes) in &written {
            self.folder.write(name, bytes)?;
        }
        tests.push(SuiteTest {
            name: format!("{scene}-{variant}"),
            scene: file.clone(),
            scene_hash: scene_hash.clone(),
            adversary: failure.adversary,
            seed: failure.seed,
            plan_hash: plan_hash(&failure.trajectory),
            plan: failure.trajectory,
            found: Found {
                ego: driver,
                plan: failure.plan,
                contact: failure.contact,
                clauses: failure.clauses,
            },
        });
        Ok(())
    }
}

/// Removes the suite that a folder holds: what it says first, then what it is made of.
///
/// *Errors*: a system error.
fn remove_old(folder: &Folder) -> Result<()> {
    let old: Option<Suite> = json(&folder.path().join(FILE)).ok();
    folder.remove(FILE)?;
    let Some(old) = old.filter(|old| old.check().is_ok()) else { return Ok(()) };
    for test in &old.tests {
        folder.remove(&format!("{SCENES}/{}", test.scene))?;
    }
    let names: HashSet<&str> = old.tests.iter().map(|test| &*test.name).collect();
    for entry in std::fs::read_dir(folder.path())? {
        let file = entry?.file_name().to_string_lossy().into_owned();
        let (stem, ending) = file.rsplit_once('.').unwrap_or((&file, ""));
        let is_of_test = match ending {
            "safetensors" | "xosc" => names.contains(stem),
            // `sd_<dataset>_<version>_<test>.pkl`
            "pkl" => stem.match_indices('_').any(|(k, _)| names.contains(&stem[k + 1..])),
            _ => false,
        };
        if is_of_test || [dataset::SUMMARY, dataset::MAPPING].contains(&&*file) {
            folder.remove(&file)?;
        }
    }
    Ok(())
}

/// What describes how a plan was generated, of all that the row of a failure holds.
const DESCRIPTION: [&str; 8] = ["method", "options", "lambda", "mu", "aggression", "mix", "merger", "search"];

/// The words of a driver without the folders of its files: a suite is passed on, and folders are nobody's business.
fn without_folders(ego: &str) -> String {
    let Some((kind, rest)) = ego.split_once(':').filter(|(kind, _)| ["cmd", "path", "td3"].contains(kind))
    else {
        return ego.to_owned();
    };
    let name = |word: &str| word.rsplit('/').next().unwrap_or_default().to_owned();
    format!("{kind}:{}", rest.split(' ').map(name).collect::<Vec<_>>().join(" "))
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

fn json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let shown = || format!("cannot read `{}`", path.display());
    let bytes = files::read(path, ROW_LIMIT).with_context(shown)?;
    match serde_json::from_slice(&bytes) {
        Ok(value) => Ok(value),
        Err(error) => bail!("`{}` is not as `sage search` writes it: {error}", path.display()),
    }
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
