//! A study: what is measured, over which axes, and what its report shows. A study is a file (YAML).

mod report;
mod search;

use std::collections::BTreeMap;

use advsage::{
    driver_spec::DriverSpec,
    operating_point::{Values, check_exclusive},
};
use sage_sim::{avoidable::AvoidanceOptions, search::SearchOptions};
use serde::{Deserialize, Deserializer, Serialize};

pub use report::{ChartSpec, Claim, CurveQuantity, Family, Guard, Limit, PairSpec, ReportSpec, VerdictSpec};

use crate::{
    Error, Result,
    context::{Context as _, require},
    rows::Subject,
};

/// Studies that are part of the program: name and file.
pub const SHIPPED: [(&str, &str); 29] = [
    ("open-loop", include_str!("../studies/open-loop.yaml")),
    ("drivers", include_str!("../studies/drivers.yaml")),
    ("admit", include_str!("../studies/admit.yaml")),
    ("front", include_str!("../studies/front.yaml")),
    ("pareto", include_str!("../studies/pareto.yaml")),
    ("dial", include_str!("../studies/dial.yaml")),
    ("mixtures", include_str!("../studies/mixtures.yaml")),
    ("prediction", include_str!("../studies/prediction.yaml")),
    ("closed-loop", include_str!("../studies/closed-loop.yaml")),
    ("ablation", include_str!("../studies/ablation.yaml")),
    ("experts", include_str!("../studies/experts.yaml")),
    ("latest-start", include_str!("../studies/latest-start.yaml")),
    ("connectivity", include_str!("../studies/connectivity.yaml")),
    ("search", include_str!("../studies/search.yaml")),
    ("rate", include_str!("../studies/rate.yaml")),
    ("people", include_str!("../studies/people.yaml")),
    ("threshold", include_str!("../studies/threshold.yaml")),
    ("transfer", include_str!("../studies/transfer.yaml")),
    ("learned-selection", include_str!("../studies/learned-selection.yaml")),
    ("learned-experts", include_str!("../studies/learned-experts.yaml")),
    ("paper-table-replay", include_str!("../studies/paper-table-replay.yaml")),
    ("paper-table-rl", include_str!("../studies/paper-table-rl.yaml")),
    ("paper-table-expert", include_str!("../studies/paper-table-expert.yaml")),
    ("paper-table-idm", include_str!("../studies/paper-table-idm.yaml")),
    ("paper-ablation", include_str!("../studies/paper-ablation.yaml")),
    ("paper-parts", include_str!("../studies/paper-parts.yaml")),
    ("paper-pareto", include_str!("../studies/paper-pareto.yaml")),
    ("paper-extrapolation", include_str!("../studies/paper-extrapolation.yaml")),
    ("paper-cases", include_str!("../studies/paper-cases.yaml")),
];
/// Most shares along an axis of a plane.
const MOST_SHARES: usize = 101;
/// Size limit of a file, bytes.
pub const MAX_STUDY_FILE: u64 = 1 << 20;

/// A study.
///
/// ```
/// use sage_bench::study::Study;
///
/// let text = "
/// study: drivers
/// summary: how often idm touches the adversary
/// measure: [drive]
/// ego: [idm]
/// selection: natural
/// metrics: {drive: ['*']}
/// ";
/// let mut study = Study::parse(text, "drivers.yaml")?;
/// // An axis is replaced as on the command line.
/// study.set("ego=idm,replay")?;
/// assert_eq!(study.ego, ["idm", "replay"]);
/// assert!(study.set("driver=idm").is_err());
/// # Ok::<(), sage_bench::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Study {
    /// Its name.
    pub study: String,
    /// One line for `sage bench list`.
    pub summary: String,
    /// What is measured.
    pub measure: Vec<Subject>,
    /// Generators, with options as `NAME{"option": value}`.
    #[serde(deserialize_with = "parts")]
    pub method: Vec<String>,
    /// Drivers under test. Without any, the ego is its recording.
    #[serde(deserialize_with = "parts")]
    pub ego: Vec<String>,
    /// People who are placed in each scene as the adversary of searches: `pedestrian`, `cyclist`, with options of the place as
    /// `pedestrian{"beyond": 1}`. Without any, the adversary of the scene attacks.
    #[serde(deserialize_with = "parts", skip_serializing_if = "Vec::is_empty")]
    pub adversary: Vec<String>,
    /// Paths of the ego that attacks on drivers are planned against; by default the drive before the attack.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub planned_against: Vec<PlannedAgainst>,
    /// Mergers of the experts.
    #[serde(deserialize_with = "parts")]
    pub merger: Vec<String>,
    /// Weights: a name or a folder, or `ARM=FOLDER`; several folders of one arm are its training seeds.
    #[serde(deserialize_with = "words")]
    pub weights: Vec<String>,
    /// Objective that selects one of the candidates.
    pub selection: String,
    /// Feasibility rule in place of that of the selection.
    pub feasibility: Option<String>,
    /// λ: a list, or `FROM:TO:STEP`.
    #[serde(deserialize_with = "numbers")]
    pub lambda: Vec<f64>,
    /// μ at every λ; by default λ.
    pub mu: Option<f64>,
    /// λ and μ as pairs, in addition to `lambda`: every λ of the first list with every μ of the second.
    pub grid: Option<[Vec<f64>; 2]>,
    /// Aggression in place of λ.
    #[serde(deserialize_with = "numbers")]
    pub aggression: Vec<f64>,
    /// Weights of named experts in place of λ.
    pub mix: Vec<BTreeMap<String, f64>>,
    /// All mixtures of three experts with weights that are multiples of `1 / steps`, in place of λ.
    pub triangle: Option<TriangleAxis>,
    /// Points of the plane through the prior and two experts, in addition to `lambda`.
    pub plane: Option<PlaneAxis>,
    /// Targets of the latest start of an evasive manoeuvre, s before the contact: the selection chooses the candidate that is
    /// nearest to each.
    #[serde(deserialize_with = "numbers")]
    pub latest_start: Vec<f64>,
    /// Options of the search for evasive manoeuvres; without them it is made only for metrics that need it.
    pub avoidable: Option<AvoidanceOptions>,
    /// How searches are made: budget, clauses that are required, order of the plans.
    pub search: SearchOptions,
    /// Radii of the suppression among predictions, metres.
    #[serde(deserialize_with = "numbers")]
    pub radius: Vec<f64>,
    /// Runs of `sage train-ego` as `NAME=FOLDER`.
    #[serde(deserialize_with = "words")]
    pub runs: Vec<String>,
    /// What learned policies do in the simulators of their authors, as `DRIVER=FILE` ([`crate::report::OwnWorld`]).
    #[serde(deserialize_with = "words")]
    pub own_world: Vec<String>,
    /// Number of untrained policies, the floor.
    pub untrained: u64,
    /// Seed of random numbers.
    pub seed: u64,
    /// Seed of procedural scenes.
    pub scene_seed: u64,
    /// Number of procedural scenes if no scenes are given; 0 if scenes must be given.
    pub procedural: u64,
    /// Metrics by what they are of; `*` stands for all others.
    pub metrics: BTreeMap<Subject, Vec<String>>,
    /// The report.
    pub report: ReportSpec,
}

/// Most procedural scenes that a command generates for training or measurement.
pub const MOST_PROCEDURAL: u64 = 100_000;
/// Most untrained policies of a study.
const MOST_UNTRAINED: u64 = 1000;
/// Most drives of a search in a scene.
const MOST_DRIVES: u64 = 100_000;

/// A path of the ego that attacks on a driver are planned against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlannedAgainst {
    /// The driver's drive in the unchanged scene, as in the paper's text.
    Drive,
    /// The recording, as in the published code.
    Log,
}

/// Mixtures of three experts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TriangleAxis {
    /// Names of the experts, at the lower left, the lower right and on top.
    pub experts: [String; 3],
    /// Steps along each side.
    pub steps: u32,
}

/// The plane `prior + a (θ_a − prior) + b (θ_b − prior)` of two experts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaneAxis {
    /// Names of the experts, along the horizontal and the vertical axis.
    pub experts: [String; 2],
    /// Shares a and b.
    #[serde(deserialize_with = "numbers")]
    pub shares: Vec<f64>,
}

/// The first line of a YAML parser's message, which shows the place in further lines.
pub fn yaml_error(error: serde_saphyr::Error) -> Error {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    Error::Value(line.trim_start_matches("error: ").to_owned())
}

impl Study {
    /// A shipped study by its name, or the study of a file's text.
    ///
    /// *Errors*: the text is no study; the study is not complete.
    pub fn parse(text: &str, name: &str) -> Result<Self> {
        let study: Self =
            serde_saphyr::from_str(text).map_err(yaml_error).with_context(|| format!("study `{name}`"))?;
        study.check().with_context(|| format!("study `{name}`"))?;
        study.refuse_programs().with_context(|| format!("study `{name}`"))?;
        Ok(study)
    }

    /// Refuses drivers that are programs: a study may come from anywhere, and what it names would be run.
    fn refuse_programs(&self) -> Result<()> {
        for text in &self.ego {
            let is_program = text.parse::<DriverSpec>().is_ok_and(|part| part.names_program());
            require(!is_program, || {
                format!(
                    "`ego` names the program `{text}`; a file names no program, so give it as --ego on the command line"
                )
            })?;
        }
        Ok(())
    }

    /// A shipped study.
    pub fn shipped(name: &str) -> Option<Result<Self>> {
        let (name, text) = SHIPPED.iter().find(|(known, _)| *known == name)?;
        Some(Self::parse(text, name))
    }

    /// Replaces an axis or another field: `lambda=0:1:0.1`, `method=sage,cat`, `selection=natural`.
    ///
    /// *Errors*: no such field, or a value that it cannot have.
    pub fn set(&mut self, assignment: &str) -> Result<()> {
        let (name, value) = assignment
            .split_once('=')
            .with_context(|| format!("`{assignment}` is not AXIS=VALUE, such as lambda=0,0.5,1"))?;
        let mut fields = serde_json::to_value(&*self)?;
        require(fields.get(name).is_some(), || {
            format!(
                "the study has no axis `{name}`; known: {}",
                fields
                    .as_object()
                    .map(|f| f.keys().cloned().collect::<Vec<_>>().join(", "))
                    .unwrap_or_default()
            )
        })?;
        // Lists and options are YAML; a plain text is a list of parts, a number or a word.
        // Other operating points take the place of those of the study.
        if ["aggression", "mix", "triangle"].contains(&name) {
            fields["lambda"] = serde_json::json!([]);
        }
        fields[name] = match serde_saphyr::from_str::<serde_json::Value>(value) {
            Ok(parsed) if !parsed.is_null() || value.trim() == "null" => parsed,
            _ => value.into(),
        };
        // A part with options, such as king{"apart": 2}, is a text, and so is an objective.
        if fields[name].is_object() && (!value.trim_start().starts_with('{') || name == "selection") {
            fields[name] = value.into();
        }
        let changed = serde_json::from_value::<Self>(fields);
        *self = changed.with_context(|| format!("`{assignment}`"))?;
        Ok(())
    }

    /// Checks that the study is complete, after fields were replaced.
    ///
    /// *Errors*: what is missing, or what excludes what.
    pub fn check(&self) -> Result<()> {
        let counts = [
            ("procedural", self.procedural, MOST_PROCEDURAL),
            ("untrained", self.untrained, MOST_UNTRAINED),
            ("search: budget", self.search.budget as u64, MOST_DRIVES),
        ];
        for (field, count, most) in counts {
            require(count <= most, || format!("`{field}` is {count}; expected at most {most}"))?;
        }
        let is_searched = self.measure.iter().all(|subject| *subject == Subject::Search);
        require(
            self.adversary.is_empty() || is_searched,
            || "`adversary` is of searches alone: `measure: [search]`",
        )?;
        require(!self.measure.is_empty(), || format!("`measure` names nothing; known: {}", names()))?;
        for subject in &self.measure {
            require(self.metrics.get(subject).is_some_and(|names| !names.is_empty()), || {
                format!("`metrics` lists none for `{subject}`; `[\"*\"]` stands for all")
            })?;
        }
        if let Some(other) = self.metrics.keys().find(|subject| !self.measure.contains(subject)) {
            return Err(Error::Value(format!(
                "`metrics` lists some for `{other}`, which `measure` does not name"
            )));
        }
        let axes = [
            ("`aggression`", !self.aggression.is_empty()),
            ("`mix`", !self.mix.is_empty()),
            ("`triangle`", self.triangle.is_some()),
        ];
        check_exclusive(&axes).map_err(Error::Value)?;
        if let Some(TriangleAxis { steps, experts }) = &self.triangle {
            require((1..=50).contains(steps), || format!("`triangle` has {steps} steps; expected 1 to 50"))?;
            let [a, b, c] = experts;
            require(a != b && b != c && a != c, || "`triangle` names an expert twice")?;
        }
        let files: Vec<&str> = self.report.charts.iter().map(|chart| &*chart.file).collect();
        for (k, file) in files.iter().enumerate() {
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
            require(file.ends_with(".svg") && file.len() > 4 && file.chars().all(is_plain), || {
                format!("the chart `{file}` is no name of a file such as `attack.svg`")
            })?;
            require(!files[..k].contains(file), || format!("two charts are named `{file}`"))?;
        }
        let is_without_claims = self.report.tests.iter().any(|family| family.claims.is_none());
        require(
            !is_without_claims || self.report.published.is_some(),
            || "`tests` has neither `claims` nor `published` numbers, which say what is expected",
        )?;
        if let Some(PlaneAxis { shares, experts: [a, b] }) = &self.plane {
            let count = shares.len();
            require((2..=MOST_SHARES).contains(&count), || {
                format!("`plane` has {count} shares; expected 2 to {MOST_SHARES}")
            })?;
            require(a != b, || "`plane` names an expert twice")?;
        }
        Ok(())
    }

    /// Whether something is measured.
    pub fn measures(&self, subject: Subject) -> bool {
        self.measure.contains(&subject)
    }
}

fn names() -> String {
    Subject::ALL.map(Subject::name).join(", ")
}

/// A list, or one text with commas between its parts; commas within options do not separate.
fn parts<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    Ok(match ListOrText::deserialize(deserializer)? {
        ListOrText::List(list) => list,
        ListOrText::Text(text) => advsage::part::split(&text),
    })
}

/// A list, or one text with commas between its words.
fn words<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    Ok(match ListOrText::deserialize(deserializer)? {
        ListOrText::List(list) => list,
        ListOrText::Text(text) => text.split(',').map(|word| word.trim().to_owned()).collect(),
    })
}

#[derive(Deserialize)]
#[serde(untagged)]
enum ListOrText {
    List(Vec<String>),
    Text(String),
}

/// A number, a list of numbers, `0,0.5,1`, or `FROM:TO:STEP`.
fn numbers<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    Ok(Values::deserialize(deserializer)?.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::in_one_line;

    #[test]
    fn shipped_studies_are_complete_and_short() {
        for (name, text) in SHIPPED {
            let study = Study::parse(text, name).unwrap();
            assert_eq!(study.study, name);
            assert!(text.lines().count() <= 40, "{name} has {} lines", text.lines().count());
        }
    }

    #[test]
    fn claims_of_shipped_studies_do_not_contradict_the_published_numbers() {
        use crate::published::{orderings, published};
        for (name, text) in SHIPPED {
            let report = Study::parse(text, name).unwrap().report;
            let Some(rows) = report.published.as_ref().map(|name| published(name).unwrap()) else { continue };
            for family in &report.tests {
                for claim in family.claims.iter().flatten() {
                    let same = |other: &Claim| other.attack == claim.attack && other.metric == claim.metric;
                    let others = ["none", "cat", "rule"].map(|arm| orderings(&rows, &family.tested, arm));
                    let contradicts =
                        others.iter().flatten().any(|other| same(other) && other.larger != claim.larger);
                    assert!(!contradicts, "{name}: {claim:?}");
                }
            }
        }
    }

    #[test]
    fn a_study_from_anywhere_cannot_ask_for_any_number() {
        for (field, most) in [("procedural", MOST_PROCEDURAL), ("untrained", MOST_UNTRAINED)] {
            for count in [most + 1, 5_000_000, 100_000_000, 1 << 32, u64::MAX] {
                let mut study = Study::shipped("open-loop").unwrap().unwrap();
                study.set(&format!("{field}={count}")).unwrap();
                let error = in_one_line(&study.check().unwrap_err());
                let expected = format!("`{field}` is {count}; expected at most {most}");
                assert!(error.contains(&expected), "{error}");
            }
        }
    }

    #[test]
    fn an_axis_is_replaced_by_its_name() {
        let mut study = Study::shipped("open-loop").unwrap().unwrap();
        study.set("lambda=0:1:0.25").unwrap();
        assert_eq!(study.lambda, [0.0, 0.25, 0.5, 0.75, 1.0]);
        study.set("lambda=1").unwrap();
        study.set("method=sage{\"candidates\": 64, \"apart\": 2},cat").unwrap();
        assert_eq!((study.lambda.len(), study.method.len()), (1, 2), "{:?}", study.method);
        study.set("method=rule").unwrap();
        study.set("ego=idm{\"limits\":[-3,1],\"curves\":3}").unwrap();
        assert_eq!((&study.method[..], study.ego.len()), (&["rule".to_owned()][..], 1));
        study.set("seed=7").unwrap();
        assert_eq!(study.seed, 7);
        let error =
            |text: &str| in_one_line(&Study::shipped("open-loop").unwrap().unwrap().set(text).unwrap_err());
        let wrong = ["lamda=1", "lambda=0:1:0", "lambda"];
        let said = wrong.map(|text| format!("{text} -> {}", error(text)));
        insta::assert_snapshot!("wrong_axes", said.join("\n"));
    }

    #[test]
    fn a_study_that_is_not_complete_says_what_is_missing() {
        let error = |text: &str| in_one_line(&Study::parse(text, "x").unwrap_err());
        let wrong =
            ["study: x", "measure: [trajectory]", "measure: [trajectories]", "measures: [trajectory]"];
        let said = wrong.map(|text| format!("{text} -> {}", error(text)));
        insta::assert_snapshot!("incomplete_studies", said.join("\n"));
    }
}
