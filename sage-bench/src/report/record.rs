//! The record of a study in its folder, and results read back from it.

use std::collections::{BTreeMap, HashMap};

use serde::{Deserialize, Serialize};

use crate::{
    Error, Result,
    context::{Context as _, foreign, require},
    csv_text::{csv, text},
    rows::{Cell, Key, MetricRecord, Results, Subject},
    study::Study,
};

/// What `rows.csv` does not say: the study, its methods, metrics and scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StudyRecord {
    /// The study as it was run.
    pub study: Study,
    /// Keys of all results.
    pub keys: Vec<Key>,
    /// Metrics by what they are of.
    pub metrics: BTreeMap<Subject, Vec<MetricRecord>>,
    /// Names of the scenes in their order.
    pub scenes: Vec<String>,
}

impl StudyRecord {
    /// The record of results.
    pub fn new(study: &Study, results: &Results) -> Self {
        Self {
            study: study.clone(),
            keys: results.keys.clone(),
            metrics: results.metrics.clone(),
            scenes: results.scenes.clone(),
        }
    }
}

/// `rows.csv`.
pub fn rows_csv(results: &Results) -> String {
    csv(std::iter::once(results.heads()).chain(results.rows()))
}

/// Results from the text of `rows.csv` and their record.
///
/// *Errors*: a row that is none of the record's, with its number.
pub fn read(record: &StudyRecord, rows: &str) -> Result<Results> {
    let mut results = Results {
        methods: Default::default(),
        study: record.study.study.clone(),
        keys: record.keys.clone(),
        metrics: record.metrics.clone(),
        scenes: record.scenes.clone(),
        cells: vec![Vec::new(); record.scenes.len()],
    };
    let scenes: HashMap<String, usize> =
        record.scenes.iter().enumerate().map(|(k, name)| (sage_core::text::escaped_name(name), k)).collect();
    let mut reader = csv::Reader::from_reader(rows.as_bytes());
    let heads = reader.headers().map_err(foreign)?.clone();
    let column = |name: &str| {
        heads.iter().position(|head| head == name).with_context(|| format!("no column `{name}`"))
    };
    let [scene, agent, metric, value, note, error, key] =
        ["scene", "agent", "metric", "value", "note", "error", "key"].map(column);
    let [scene, agent, metric, value, note, error, key] =
        [scene?, agent?, metric?, value?, note?, error?, key?];
    for (number, row) in reader.records().enumerate() {
        let row = row.map_err(foreign)?;
        let at = || format!("row {}", number + 2);
        let key: usize = row[key].parse().map_err(foreign).with_context(at)?;
        require(key < results.keys.len(), || format!("{}: key {key} is not in the record", at()))?;
        let scene = *scenes
            .get(text(&row[scene]))
            .with_context(|| format!("{}: scene `{}` is not in the record", at(), &row[scene]))?;
        let cells = &mut results.cells[scene];
        if !row[error].is_empty() {
            cells.push(Cell::failed(key, text(&row[error])));
            continue;
        }
        let metrics = record.metrics.get(&results.keys[key].subject).map_or(&[][..], |all| all);
        let number = metrics.iter().position(|known| known.name == row[metric]);
        let number =
            number.with_context(|| format!("{}: metric `{}` is not in the record", at(), &row[metric]))?;
        if cells.last().is_none_or(|cell| cell.key != key || cell.agent != text(&row[agent])) {
            let values = vec![None; metrics.len()];
            cells.push(Cell {
                key,
                agent: text(&row[agent]).to_owned(),
                values,
                notes: Vec::new(),
                error: String::new(),
            });
        }
        let Some(cell) = cells.last_mut() else { continue };
        if !row[value].is_empty() {
            cell.values[number] = Some(row[value].parse().map_err(foreign).with_context(at)?);
        }
        if !row[note].is_empty() {
            cell.notes.push((number, text(&row[note]).to_owned()));
        }
    }
    Ok(results)
}

/// Results of several folders as one, the scenes of one after those of another.
///
/// *Errors*: folders of different studies, or a scene that is in two of them.
pub fn join(all: Vec<(StudyRecord, Results)>) -> Result<(StudyRecord, Results)> {
    let Some((first, _)) = all.first() else { return Err(Error::Value("no folder is given".to_owned())) };
    let (keys, metrics, study) = (first.keys.clone(), first.metrics.clone(), first.study.clone());
    for (k, (record, _)) in all.iter().enumerate() {
        require(record.keys == keys && record.metrics == metrics, || {
            format!("folder {} is of other methods or metrics than folder 1", k + 1)
        })?;
    }
    let mut joined = Results { study: study.study.clone(), keys, metrics, ..Results::default() };
    for (_, results) in all {
        joined.scenes.extend(results.scenes);
        joined.cells.extend(results.cells);
    }
    let mut names: Vec<&String> = joined.scenes.iter().collect();
    names.sort();
    if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(Error::Value(format!("scene `{}` is in two folders", twice[0])));
    }
    Ok((StudyRecord::new(&study, &joined), joined))
}
