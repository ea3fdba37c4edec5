//! A study with all its parts built: checked before any scene is read.

use std::{collections::BTreeMap, path::Path};

use advsage::{
    driver_spec::DriverSpec,
    ego::{self, Ego},
    generators::weight_hashes,
    operating_point::OperatingPointSpec,
    part::Part,
    search::{ONE_SHOT, POOL},
    selection::Selection,
};
use sage_core::{generator::Attack, objective::ObjectiveSpec, scene::SceneData};
use sage_sim::policy::StepTimes;
use serde::Serialize;
use serde_json::{Map, Value};

use crate::{
    Error, Registries, Result,
    context::require,
    measure::{
        Attacks, Episodes, ExpertSource, Group, Measurement, Policies, Predictions, Rates, SceneResult,
        Searches, Transfers,
    },
    report::{KINDS, Report},
    rows::{Cell, Key, MetricRecord, Results, Subject},
    study::{PairSpec, Study},
};

/// What identifies the results of a study besides its scenes.
#[derive(Clone, Debug, Serialize)]
pub struct Identity {
    study: Study,
    selection: ObjectiveSpec,
    /// Hashes of the networks of each group.
    experts: Vec<Map<String, Value>>,
    points: Vec<Vec<OperatingPointSpec>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    contents: Option<Contents>,
    ego: Vec<Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    policies: Option<Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    densities: Option<Value>,
}

/// Hashes of files that generators were built from, and of those that the objective reads.
#[derive(Clone, Debug, Serialize)]
struct Contents(Vec<Map<String, Value>>, Vec<String>);

/// A study with all its parts.
pub struct PreparedStudy {
    /// The study.
    pub study: Study,
    /// Keys of all results.
    pub keys: Vec<Key>,
    /// Metrics by what they are of.
    pub metrics: BTreeMap<Subject, Vec<MetricRecord>>,
    /// What identifies the results besides the scenes.
    pub identity: Identity,
    /// What the user should know of the parts.
    pub notes: Vec<String>,
    /// Whether a driver is a program, which keeps a log.
    pub has_programs: bool,
    measurements: Vec<Box<dyn Measurement>>,
}

/// Checks what the report names, before anything is measured: it is rendered without results.
fn check_report(
    study: &Study,
    registries: &Registries,
    keys: &[Key],
    metrics: &BTreeMap<Subject, Vec<MetricRecord>>,
) -> Result<()> {
    for PairSpec { with, .. } in &study.report.pairs {
        let is_known = KINDS.contains(&&**with)
            || [POOL, ONE_SHOT].contains(&&**with)
            || registries.parts.generators.get(with).is_ok();
        require(is_known, || {
            format!(
                "`pairs` has `with: {with}`, which is neither a generator nor one of {}",
                KINDS.join(", ")
            )
        })?;
    }
    for (subject, names) in &study.report.columns {
        let known = metrics.get(subject).map_or(&[][..], |all| all);
        let missing = names.iter().find(|name| !known.iter().any(|metric| metric.name == **name));
        if let Some(name) = missing.filter(|_| study.measures(*subject)) {
            return Err(Error::Value(format!(
                "`columns` names `{name}`, which is no metric of `{subject}` in this study"
            )));
        }
    }
    let (keys, metrics) = (keys.to_vec(), metrics.clone());
    let empty = Results { study: study.study.clone(), keys, metrics, ..Results::default() };
    Report::new(study, &empty).map(drop)
}

/// Parts of a report that show nothing, because the study does not measure what they are of. Shipped studies have such
/// parts for their options.
fn unused(study: &Study) -> Vec<String> {
    let report = &study.report;
    if Study::shipped(&study.study).is_some_and(|shipped| shipped.is_ok_and(|s| s.report == *report)) {
        return Vec::new();
    }
    let pairs = report.pairs.iter().map(|pair| ("pairs", pair.of));
    let charts = report.charts.iter().map(|chart| ("charts", chart.of));
    let titles = report.titles.keys().map(|subject| ("titles", *subject));
    let columns = report.columns.keys().map(|subject| ("columns", *subject));
    let all = pairs.chain(charts).chain(titles).chain(columns);
    let all = all.filter(|(_, subject)| !study.measures(*subject));
    all.map(|(what, subject)| format!("`{what}` of `{subject}` show nothing: `measure` does not name it"))
        .collect()
}

impl PreparedStudy {
    /// Builds all parts of a study.
    ///
    /// *Errors*: a part or a metric that is not registered, options that a part refuses, or weights that cannot be used.
    pub fn new(study: Study, registries: &Registries, source: &dyn ExpertSource) -> Result<Self> {
        let rule = study.feasibility.as_deref().map(str::parse::<Part>).transpose().map_err(Error::Value)?;
        // A study without attacks selects nothing.
        let name = if study.selection.is_empty() { "natural" } else { &study.selection };
        let selection = Selection::of(&registries.parts, name, rule.as_ref())?;
        let parts: Vec<DriverSpec> =
            study.ego.iter().map(|text| text.parse().map_err(Error::Value)).collect::<Result<_>>()?;
        let egos = Ego::all(&parts, &registries.parts)?;
        let measures_any = |subjects: &[Subject]| subjects.iter().any(|subject| study.measures(*subject));
        let drives = measures_any(&[Subject::Drive, Subject::AttackedDrive]);
        let searches = measures_any(&[Subject::Search, Subject::Threshold]);
        let transfers = study.measures(Subject::Transfer);
        let rates = study.measures(Subject::Rate);
        require(
            !drives && !searches && !transfers && !rates || !egos.is_empty(),
            || "the study drives, but `ego` names no driver",
        )?;
        require(
            !searches || study.measure.iter().all(|s| [Subject::Search, Subject::Threshold].contains(s)),
            || "`measure` names `search` or `threshold` beside other subjects; they need a study of their own",
        )?;
        require(
            !transfers || study.measure.len() == 1,
            || "`measure` names `transfer` beside other subjects; it needs a study of its own",
        )?;
        require(
            !rates || study.measure.len() == 1,
            || "`measure` names `rate` beside other subjects; it needs a study of its own",
        )?;
        let has_programs = egos.iter().any(|ego| ego.is_program);
        let mut notes = unused(&study);
        let is_attacked = study.measures(Subject::Trajectory) || study.measures(Subject::AttackedDrive);
        let is_episodic = study.measures(Subject::Episode);
        let groups = if is_attacked || is_episodic || searches || transfers || study.measures(Subject::Policy)
        {
            Group::all(&study, registries, source, &selection)?
        } else {
            Vec::new()
        };
        let hashes = groups.iter().map(|group| weight_hashes(&group.experts)).collect::<Result<Vec<_>>>()?;
        let built = groups.iter().flat_map(|group| &group.built);
        let files: Vec<_> =
            built.map(|built| &built.files).filter(|files| !files.is_empty()).cloned().collect();
        let contents = selection.objective.contents();
        let mut identity = Identity {
            study: study.clone(),
            selection: selection.objective.spec().clone(),
            experts: hashes,
            points: groups.iter().map(|group| group.points.clone()).collect(),
            contents: (!files.is_empty() || !contents.is_empty()).then_some(Contents(files, contents)),
            ego: parts.iter().map(ego::identity).collect::<advsage::Result<_>>()?,
            policies: None,
            densities: None,
        };
        let mut measurements: Vec<Box<dyn Measurement>> = Vec::new();
        // Without generators that use networks, policies say nothing.
        let has_network = groups.iter().flat_map(|group| &group.built).any(|built| built.facts.needs_experts);
        let shows_policies = study.measures(Subject::Policy) && (has_network || !is_attacked);
        let of_policies: Option<Vec<Group>> =
            shows_policies.then(|| groups.iter().map(Group::without_generators).collect());
        if study.measures(Subject::Prediction) {
            measurements.push(Box::new(Predictions::new(&study, registries, source)?));
        }
        if is_episodic {
            let episodes = Episodes::new(&study, registries, egos, groups)?;
            identity.policies = Some(episodes.identity());
            measurements.push(Box::new(episodes));
        } else if searches {
            measurements.push(Box::new(Searches::new(&study, registries, egos, &groups, &selection)?));
        } else if rates {
            let rates = Rates::new(&study, registries, egos)?;
            identity.densities = Some(rates.identity()?);
            notes.extend(rates.notes());
            measurements.push(Box::new(rates));
        } else if transfers {
            measurements.push(Box::new(Transfers::new(&study, registries, egos, &groups, &selection)?));
        } else if is_attacked || drives {
            let objective = selection.objective;
            measurements.push(Box::new(Attacks::new(&study, registries, egos, groups, objective)?));
        }
        if let Some(groups) = of_policies {
            measurements.push(Box::new(Policies::new(&study, registries, groups)?));
        }
        let mut keys: Vec<Key> = Vec::new();
        let mut metrics = BTreeMap::new();
        for measurement in &measurements {
            keys.extend(measurement.keys().iter().cloned());
            for (subject, infos) in measurement.metrics() {
                metrics.insert(subject, infos.iter().map(MetricRecord::from).collect());
            }
        }
        require(!keys.is_empty(), || "the study measures nothing")?;
        check_report(&study, registries, &keys, &metrics)?;
        Ok(Self { study, keys, metrics, identity, notes, has_programs, measurements })
    }

    /// Whether scenes without an adversary are left out.
    pub fn needs_adversary(&self) -> bool {
        !self.study.measures(Subject::Drive) && !self.study.measures(Subject::Prediction)
    }

    /// Names the folder of a run for logs of drivers.
    pub fn write_logs_to(&self, folder: &Path) {
        self.measurements.iter().for_each(|measurement| measurement.write_logs_to(folder));
    }

    /// Times of the steps of the drivers that were measured so far, by their names. They are no part of the results, which
    /// are the same at any speed.
    pub fn step_times(&self) -> Vec<(&str, &StepTimes)> {
        self.measurements.iter().flat_map(|measurement| measurement.step_times()).collect()
    }

    /// The attack of a key on the recorded ego, computed again for a picture; `None` if the key has none.
    ///
    /// *Errors*: those of the generator.
    pub fn attack(&self, key: usize, data: &SceneData) -> Result<Option<Attack>> {
        let mut first = 0;
        for measurement in &self.measurements {
            let end = first + measurement.keys().len();
            if key < end {
                return measurement.attack(key - first, data);
            }
            first = end;
        }
        Ok(None)
    }

    /// Measures a scene.
    pub fn measure(&self, data: &SceneData) -> SceneResult {
        let mut all = SceneResult::default();
        let mut first = 0;
        for measurement in &self.measurements {
            let SceneResult { cells, left_out } = measurement.measure(data);
            all.cells.extend(cells.into_iter().map(|cell| Cell { key: first + cell.key, ..cell }));
            all.left_out.extend(left_out);
            first += measurement.keys().len();
        }
        all
    }
}
