//! `sage suite`: keeps failures of searches as tests.

pub(super) mod growing;

use std::collections::HashSet;

use advsage::rows::search::{SceneRow, failure_name};
use anyhow::{Context as _, Result, ensure};
use rayon::prelude::*;
use sage_data::Recording;
use sage_run::{
    Outcome,
    outcome::{caught, without_defects},
    output::Folder,
    progress,
};
use sage_sim::search::{
    Features,
    features::{Spread, diverse},
    suite::{MOST_TESTS, Suite, VERSION},
};

use super::search::found::{FailureScene, Found};
use crate::cli::{Keep, SuiteArgs};
use growing::{GrowingSuite, remove_old};

/// Clusters that are printed.
const SHOWN: usize = 10;

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
    let mut growing = GrowingSuite::new(folder, suite, args.format)?;
    let of_scene =
        |a: &Candidate, b: &Candidate| (a.place.search, a.place.row) == (b.place.search, b.place.row);
    for candidates in candidates.chunk_by(of_scene) {
        let Place { search, row, .. } = candidates[0].place;
        let (search, row) = (&searches[search], &searches[search].rows[row]);
        add_failures(&mut growing, search, row, candidates).with_context(|| of_row(search, row))?;
    }
    growing.write()?;
    let (out, suite) = (args.folder.out.display(), growing.suite());
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

/// Adds failures of a scene to a suite.
///
/// *Errors*: a file of the search cannot be read, or a system error.
fn add_failures(
    growing: &mut GrowingSuite,
    search: &Found,
    row: &SceneRow,
    candidates: &[Candidate],
) -> Result<()> {
    let source = search.unchanged(row)?;
    let bytes = sage_data::read_bytes(&source)?;
    let stored = growing.store(row.scene(), &bytes)?;
    let recording = Recording::from_bytes(&source, bytes)?;
    for Candidate { place, features, .. } in candidates {
        let failure = search.failure(row, place.failure)?;
        growing.add(&recording, &stored, place.failure, features, failure)?;
    }
    Ok(())
}
