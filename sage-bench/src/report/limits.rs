//! Whether drivers keep to the limits of a study, and are admitted.

use std::path::Path;

use sage_core::{
    files,
    statistics::{Estimate, wilson},
    text::table::Table,
};
use serde::{Deserialize, Serialize};

use super::{Estimates, cell};
use crate::{
    Error, Result,
    context::{Context as _, require},
    csv_text::{csv, text as unquoted},
    rows::{Results, Subject},
    study::{Limit, Study},
};

/// Verdicts of each driver, as a file: `driver`, `limit`, `value`, `low`, `high`, `verdict`, and a row `all` with the verdict of all limits.
pub const VERDICTS: &str = "admitted.csv";
/// Largest file of verdicts, bytes.
const MAX_VERDICTS: u64 = 1 << 22;
/// Largest file of a test in the author's own world, bytes.
const MAX_OWN_WORLD: u64 = 1 << 20;
/// Share of the scenes of its own world in which a learned policy has to succeed.
const OWN_WORLD: f64 = 0.9;
/// Name of that limit.
const OWN_WORLD_NAME: &str = "own world";

/// What a learned policy does in the simulator of its author, as a file (JSON): in how many scenes it does what it was trained for.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnWorld {
    /// The simulator, with its version.
    pub simulator: String,
    /// What counts as a success, such as "reaches its goal".
    pub success: String,
    /// Number of scenes.
    pub scenes: usize,
    /// Number of them in which it succeeds.
    pub succeeded: usize,
}

/// Whether a driver keeps to a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
enum Verdict {
    Kept,
    /// The estimate is beyond it, but the interval is not: more scenes may tell.
    CannotBeTold,
    Exceeded,
}

impl Verdict {
    fn of(limit: &Limit, estimate: &Estimate) -> Self {
        let is_beyond = |value: f64| {
            limit.at_most.is_some_and(|most| value > most)
                || limit.at_least.is_some_and(|least| value < least)
        };
        let nearest = if limit.at_most.is_some() { estimate.low } else { estimate.high };
        match (is_beyond(estimate.value), is_beyond(nearest)) {
            (false, _) => Self::Kept,
            (true, false) => Self::CannotBeTold,
            (true, true) => Self::Exceeded,
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Kept => "kept",
            Self::CannotBeTold => "cannot be told",
            Self::Exceeded => "exceeded",
        }
    }

    /// The verdict of all limits.
    fn of_all(self) -> &'static str {
        match self {
            Self::Kept => "admitted",
            Self::CannotBeTold => "cannot be told",
            Self::Exceeded => "refused",
        }
    }
}

/// The table of limits and their file; none unless the study has limits.
///
/// *Errors*: a limit on a metric that is not measured; a file of a test in an own world that cannot be read, or names another driver.
pub(super) fn tables(study: &Study, results: &Results, all: &Estimates) -> Result<Option<(Table, String)>> {
    let limits = &study.report.limits;
    if limits.is_empty() {
        return Ok(None);
    }
    let own_worlds = study.own_world.iter().map(|entry| own_world(entry)).collect::<Result<Vec<_>>>()?;
    let subject = Subject::Drive;
    let methods = results.methods(subject);
    for (arm, _) in &own_worlds {
        let is_known = methods.iter().any(|method| results.keys[*method].arm == *arm);
        require(is_known, || format!("`own_world` names `{arm}`, which is no driver of the study"))?;
    }
    let columns: Vec<(usize, &Limit)> = limits
        .iter()
        .map(|limit| {
            let metric = results.metric(subject, &limit.metric);
            metric.map(|metric| (metric, limit)).with_context(|| {
                format!("`limits` has `{}`, which is no metric of drives of this study", limit.metric)
            })
        })
        .collect::<Result<_>>()?;
    let mut heads = vec!["driver".to_owned(), "verdict".to_owned()];
    heads.extend(columns.iter().map(|(_, limit)| limit.words()));
    heads.extend((!own_worlds.is_empty()).then(|| format!("{OWN_WORLD_NAME} ≥ {OWN_WORLD}")));
    let mut file = vec![["driver", "limit", "value", "low", "high", "verdict"].map(str::to_owned).to_vec()];
    let mut rows = Vec::new();
    for method in methods {
        let arm = &results.keys[method].arm;
        let (mut worst, mut cells, mut missed) = (Verdict::Kept, Vec::new(), Vec::new());
        let mut answer = |limit: &Limit, estimate: Option<Estimate>, shown: String| {
            let Some(estimate) = estimate else { return cells.push("-".to_owned()) };
            let verdict = Verdict::of(limit, &estimate);
            worst = worst.max(verdict);
            let numbers = [estimate.value, estimate.low, estimate.high].map(|x| x.to_string());
            let head = [arm.clone(), limit.metric.clone()];
            file.push(head.into_iter().chain(numbers).chain([verdict.words().to_owned()]).collect());
            if verdict == Verdict::Kept {
                return cells.push(shown);
            }
            cells.push(format!("{shown}: {}", verdict.words()));
            missed.push(limit.metric.clone());
        };
        for (metric, limit) in &columns {
            let (_, estimate) = all.get(method, *metric);
            answer(limit, estimate, cell(&results.metrics_of(subject)[*metric], estimate, None));
        }
        if !own_worlds.is_empty() {
            let own = own_worlds.iter().find(|(name, _)| name == arm);
            let limit = Limit { metric: OWN_WORLD_NAME.to_owned(), at_most: None, at_least: Some(OWN_WORLD) };
            let shown = own.map(|(_, own)| {
                format!("{} of {}: {} ({})", own.succeeded, own.scenes, own.success, own.simulator)
            });
            let estimate = own.and_then(|(_, own)| wilson(own.succeeded, own.scenes));
            answer(&limit, estimate, shown.unwrap_or_default());
        }
        let failed = results.failure_count(method);
        if failed > 0 {
            worst = worst.max(Verdict::CannotBeTold);
        }
        let verdict = worst.of_all().to_owned();
        let whole = ["", "", ""].map(str::to_owned);
        file.push(
            [arm.clone(), "all".to_owned()].into_iter().chain(whole).chain([verdict.clone()]).collect(),
        );
        let of = if missed.is_empty() { String::new() } else { format!(": {}", missed.join(", ")) };
        rows.push([arm.clone(), verdict + &of].into_iter().chain(cells).collect());
    }
    let title = "Limits. *Refused*: an interval lies wholly beyond a limit; *cannot be told*: an estimate does, or a drive failed:";
    Ok(Some((Table { title: title.to_owned(), heads, rows, names: 1 }, csv(file))))
}

/// The verdict of all limits on a driver, from the folder of a study with limits: `admitted`, `refused` or `cannot be told`.
///
/// *Errors*: no such folder, or no verdict on this driver.
pub fn verdict_of(folder: &Path, driver: &str) -> Result<String> {
    let path = folder.join(VERDICTS);
    let read = files::read(&path, MAX_VERDICTS);
    let text = read.with_context(|| format!("`{}` is no folder of `sage bench admit`", folder.display()))?;
    let mut rows = csv::Reader::from_reader(&text[..]);
    let mut found =
        rows.records().filter_map(std::result::Result::ok).filter(|row| row.get(1) == Some("all"));
    let of_driver = found.find(|row| row.get(0).is_some_and(|cell| unquoted(cell) == driver));
    let verdict = of_driver.and_then(|row| Some(row.get(5)?.to_owned()));
    verdict.with_context(|| {
        format!("`{}` has no verdict on `{driver}`; name the driver there as here: NAME=…", path.display())
    })
}

/// `ARM=FILE`, read.
fn own_world(entry: &str) -> Result<(String, OwnWorld)> {
    let (arm, file) = entry.split_once('=').with_context(|| {
        format!("`own_world` is `{entry}`; expected DRIVER=FILE, such as policy=own.json")
    })?;
    let path = Path::new(file);
    let read = || -> Result<OwnWorld> {
        let own: OwnWorld = serde_json::from_slice(&files::read(path, MAX_OWN_WORLD)?)?;
        require(own.scenes > 0 && own.succeeded <= own.scenes, || {
            format!(
                "{} of {} scenes; expected at least one scene and no more successes",
                own.succeeded, own.scenes
            )
        })?;
        Ok(own)
    };
    let own = read().map_err(|error| Error::Value(format!("own world `{file}`: {error}")))?;
    Ok((arm.to_owned(), own))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_is_exceeded_where_the_whole_interval_is_beyond_it() {
        let limit = |at_most, at_least| Limit { metric: "contact".to_owned(), at_most, at_least };
        let verdict = |limit: &Limit, k: usize| Verdict::of(limit, &wilson(k, 30).unwrap());
        let [most, least] = [limit(Some(0.1), None), limit(None, Some(0.9))];
        assert_eq!(
            [0, 4, 14].map(|k| verdict(&most, k)),
            [Verdict::Kept, Verdict::CannotBeTold, Verdict::Exceeded]
        );
        assert_eq!(
            [30, 26, 1].map(|k| verdict(&least, k)),
            [Verdict::Kept, Verdict::CannotBeTold, Verdict::Exceeded]
        );
        assert_eq!((&*most.words(), &*least.words()), ("contact ≤ 0.1", "contact ≥ 0.9"));
    }

    #[test]
    fn verdicts_and_own_worlds_are_read_from_files() {
        let folder = tempfile::tempdir().unwrap();
        let rows = "driver,limit,value,low,high,verdict\nmine,contact,0,0,0.1,kept\nmine,all,,,,refused\n";
        std::fs::write(folder.path().join(VERDICTS), rows).unwrap();
        assert_eq!(verdict_of(folder.path(), "mine").unwrap(), "refused");
        assert!(
            verdict_of(folder.path(), "other").unwrap_err().to_string().contains("no verdict on `other`")
        );
        assert!(verdict_of(&folder.path().join("none"), "mine").is_err());
        let file = folder.path().join("own.json");
        let entry = format!("mine={}", file.display());
        for (scenes, succeeded, is_right) in [(30, 1, true), (30, 31, false), (0, 0, false)] {
            let text = format!(
                r#"{{"simulator": "s", "success": "reaches its goal", "scenes": {scenes}, "succeeded": {succeeded}}}"#
            );
            std::fs::write(&file, text).unwrap();
            assert_eq!(own_world(&entry).is_ok(), is_right, "{scenes} {succeeded}");
        }
        assert!(own_world("no file").is_err());
    }
}
