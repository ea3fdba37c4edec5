//! `sage suite`: keeps failures of searches as tests.

use std::collections::{HashMap, HashSet};

use advsage::{
    attacked_files::{Attack, AttackedFiles, names_of_file},
    rows::{
        failure::FailureRow,
        search::{SceneRow, failure_name},
    },
};
use anyhow::{Context as _, Result, ensure};
use rayon::prelude::*;
use sage_data::{Format, Recording, dataset, openscenario::Options};
use sage_run::{
    Outcome,
    outcome::{caught, without_defects},
    output::{self, Folder},
    progress,
};
use sage_sim::search::{
    Features,
    features::{Spread, diverse},
    suite::{FILE, Found as Origin, MOST_TESTS, SCENES, Suite, SuiteTest, VERSION, is_plain, plan_hash},
};

use super::search::found::{FailureScene, Found, json, without_folders};
use crate::cli::{Keep, SuiteArgs};

/// Clusters that are printed.
const SHOWN: usize = 10;

/// A suite that grows.
struct Maker<'a> {
    args: &'a SuiteArgs,
    folder: Folder,
    suite: Suite,
    /// File of each scene by the hash of its content.
    scenes: HashMap<String, String>,
    /// Names of the tests.
    names: HashSet<String>,
    /// What each test is: a failure that two searches have found is one test.
    known: HashSet<KnownTest>,
}

/// What makes two tests the same.
#[derive(PartialEq, Eq, Hash)]
struct KnownTest {
    scene_hash: String,
    plan_hash: String,
    adversary: String,
}

/// A scene of the suite.
struct StoredScene<'a> {
    file: &'a str,
    hash: &'a str,
}

/// Where a failure stands.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    /// Number of its search.
    search: usize,
    /// Number of the row of its scene.
    row: usize,
    /// Its own, 1 the first found.
    failure: usize,
}

/// A failure that may become a test.
struct Candidate {
    place: Place,
    reward: f64,
    features: Features,
}

pub(crate) fn run(args: &SuiteArgs) -> Result<Outcome> {
    let mut searches: Vec<Found> =
        args.searches.iter().map(|folder| Found::read(folder)).collect::<Result<_>>()?;
    searches.iter_mut().for_each(|search| search.rows.retain(|row| row.failures() > 0));
    ensure!(
        searches.iter().any(|search| !search.rows.is_empty()),
        "the searches hold no failure; search more scenes, or with a larger --budget (`sage report` says what they found, and errors of the driver)"
    );
    searches.iter().try_for_each(|search| {
        check(search, &searches[0]).with_context(|| format!("`{}`", search.folder.display()))
    })?;
    let mut candidates = candidates(&searches, args)?;
    let all = Spread::of(candidates.iter().map(|candidate| candidate.features.cluster()));
    if let Some(count) = args.diverse {
        let features: Vec<Features> = candidates.iter().map(|candidate| candidate.features).collect();
        let reward = |k: usize| candidates[k].reward;
        let worst = (0..candidates.len()).reduce(|a, b| if reward(b) > reward(a) { b } else { a });
        let chosen: HashSet<usize> = diverse(&features, worst.unwrap_or(0), count).into_iter().collect();
        let mut number = 0..;
        candidates.retain(|_| number.next().is_some_and(|number| chosen.contains(&number)));
    }
    ensure!(
        candidates.len() <= MOST_TESTS,
        "the searches hold {} failures; a suite has at most {MOST_TESTS} tests, so give --diverse N or --keep mildest",
        candidates.len()
    );
    let folder = Folder::make(&args.folder.out, args.folder.force)?;
    remove_old(&folder)?;
    folder.inner(SCENES.as_ref())?;
    let record = &searches[0].record;
    let suite = Suite {
        suite: VERSION,
        require: record.search.require,
        feasibility: record.feasibility.clone(),
        avoidable: record.search.avoidable,
        references: record.references.clone(),
        fault: record.fault,
        tests: Vec::new(),
    };
    let mut maker =
        Maker { args, folder, suite, scenes: HashMap::new(), names: HashSet::new(), known: HashSet::new() };
    let of_scene =
        |a: &Candidate, b: &Candidate| (a.place.search, a.place.row) == (b.place.search, b.place.row);
    for candidates in candidates.chunk_by(of_scene) {
        let Place { search, row, .. } = candidates[0].place;
        let (search, row) = (&searches[search], &searches[search].rows[row]);
        maker.add_scene(search, row, candidates).with_context(|| of_row(search, row))?;
    }
    let Maker { folder, suite, .. } = maker;
    suite.check()?;
    if args.format.has(Format::Pickle) {
        dataset::write_tables(folder.path())?;
    }
    folder.write(FILE, &serde_json::to_vec(&suite)?)?;
    folder.finish()?;
    let out = folder.path().display();
    let kept = Spread::of(candidates.iter().map(|candidate| candidate.features.cluster()));
    progress::say_lines(&format!(
        "`{out}`: {} of {}\n{}\nto drive against them: sage test {out} --ego POLICY",
        progress::count(suite.tests.len(), "test"),
        progress::count(args.searches.len(), "search"),
        spread_words(&kept, &all, args.diverse.is_some()),
    ));
    Ok(Outcome::Done)
}

/// How the tests spread over clusters; with a diverse choice, also how the failures to choose from do.
fn spread_words(kept: &Spread, all: &Spread, is_diverse: bool) -> String {
    let (clusters, entropy) = (kept.clusters.len(), kept.entropy());
    let mut lines = vec![if is_diverse {
        format!(
            "{clusters} of {}, entropy {entropy:.2} bits, {:.2} before the choice; the largest:",
            progress::count(all.clusters.len(), "cluster"),
            all.entropy()
        )
    } else {
        format!("{}, entropy {entropy:.2} bits; the largest:", progress::count(clusters, "cluster"))
    }];
    lines.extend(kept.largest().take(SHOWN).map(|(name, count)| format!("  {count:3}  {name}")));
    lines.join("\n")
}

fn of_row(search: &Found, row: &SceneRow) -> String {
    format!("`{}`, scene `{}`", search.folder.display(), row.scene())
}

/// Checks that a search can be in one suite with the first.
///
/// *Errors*: it requires something else, or its unchanged scenes are missing.
fn check(search: &Found, first: &Found) -> Result<()> {
    let [own, other] = [&search.record, &first.record];
    ensure!(
        own.search.require == other.search.require
            && own.feasibility == other.feasibility
            && own.references == other.references
            && own.fault == other.fault
            && own.search.avoidable == other.search.avoidable,
        "it requires other clauses than the first search, or by other rules; make a suite of its own"
    );
    search.rows.iter().try_for_each(|row| search.unchanged(row).map(drop))
}

/// All failures that --keep leaves, with their features, in the order of their searches, scenes and numbers.
fn candidates(searches: &[Found], args: &SuiteArgs) -> Result<Vec<Candidate>> {
    let keep = args.keep.unwrap_or(if args.diverse.is_some() { Keep::All } else { Keep::Mildest });
    let places =
        searches.iter().enumerate().flat_map(|(s, search)| (0..search.rows.len()).map(move |r| [s, r]));
    let places: Vec<[usize; 2]> = places.collect();
    let of_scene = |&[s, r]: &[usize; 2]| -> Result<Vec<Candidate>> {
        let (search, row) = (&searches[s], &searches[s].rows[r]);
        let of_scene = || -> Result<Vec<Candidate>> {
            let recording = Recording::read(&search.unchanged(row)?)?;
            let scene = FailureScene::new(&recording, row.adversary())?;
            let candidate = |number: usize| {
                let failure = search.failure(row, number)?;
                let features = scene.driven(&failure).and_then(|driven| driven.features(&failure));
                let features = features.with_context(|| failure_name(number))?;
                Ok(Candidate {
                    place: Place { search: s, row: r, failure: number },
                    reward: failure.evaluated.reward,
                    features,
                })
            };
            keep.numbers(row).into_iter().map(candidate).collect()
        };
        caught(of_scene).with_context(|| of_row(search, row))
    };
    let all: Vec<Result<Vec<Candidate>>> = places.par_iter().map(of_scene).collect();
    Ok(without_defects(all)?.into_iter().flatten().collect())
}

impl Maker<'_> {
    fn add_scene(&mut self, search: &Found, row: &SceneRow, candidates: &[Candidate]) -> Result<()> {
        let source = search.unchanged(row)?;
        let bytes = sage_data::read_bytes(&source)?;
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
        for Candidate { place, features, .. } in candidates {
            let failure = search.failure(row, place.failure)?;
            let stored = StoredScene { file: &file, hash: &scene_hash };
            self.add_test(&recording, &name, stored, place.failure, features, failure)?;
        }
        Ok(())
    }

    fn add_test(
        &mut self,
        recording: &Recording,
        scene: &str,
        stored: StoredScene,
        number: usize,
        features: &Features,
        failure: FailureRow,
    ) -> Result<()> {
        let plan_hash = plan_hash(&failure.trajectory);
        let known = KnownTest {
            scene_hash: stored.hash.to_owned(),
            plan_hash: plan_hash.clone(),
            adversary: failure.head.adversary.clone(),
        };
        if !self.known.insert(known) {
            return Ok(());
        }
        let driver = without_folders(&failure.head.ego);
        let ego = plain(&driver);
        let named = |k: usize| {
            let more = if k == 0 { String::new() } else { format!("-{k}") };
            format!("{ego}-{}{more}", failure_name(number))
        };
        let is_free = |variant: &String| !self.names.contains(&format!("{scene}-{variant}"));
        let variant = (0..).map(named).find(is_free).unwrap_or_default();
        self.names.insert(format!("{scene}-{variant}"));
        let files = AttackedFiles::new(recording, scene, self.args.format, Options::default())?;
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
        for (name, bytes) in &written {
            self.folder.write(name, bytes)?;
        }
        self.suite.tests.push(SuiteTest {
            name: format!("{scene}-{variant}"),
            scene: stored.file.to_owned(),
            scene_hash: stored.hash.to_owned(),
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
