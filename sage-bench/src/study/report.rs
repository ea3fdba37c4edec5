//! What the report of a study shows.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::rows::Subject;

/// What a report shows besides the table of each subject.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReportSpec {
    /// Title of the table of each subject.
    pub titles: BTreeMap<Subject, String>,
    /// Metrics in the table of each subject; by default all that the study lists.
    pub columns: BTreeMap<Subject, Vec<String>>,
    /// Differences, paired by scene.
    pub pairs: Vec<PairSpec>,
    /// Quantities of the curve of each method over its operating points.
    pub curves: Vec<CurveQuantity>,
    /// Whether the evenness of sweeps and the shares of λ and μ are shown.
    pub sweeps: bool,
    /// Charts.
    pub charts: Vec<ChartSpec>,
    /// Name of the published numbers that stand below the study's own.
    pub published: Option<String>,
    /// Verdicts on the published numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verdicts: Option<VerdictSpec>,
    /// Limits on metrics of drives in unchanged scenes, by which drivers are admitted.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub limits: Vec<Limit>,
    /// Families of tests between trained policies.
    pub tests: Vec<Family>,
    /// Whether the strongest and the failed attacks of each method are drawn.
    pub pictures: bool,
    /// Beside `pictures`: number of scenes in which all methods are drawn side by side, and of the least realistic
    /// trajectories of each method.
    #[serde(skip_serializing_if = "is_zero")]
    pub cases: usize,
    /// Explanation below the tables.
    pub notes: String,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// How the study's numbers are compared with the published ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VerdictSpec {
    /// By metric: the largest half-width of the interval of a difference that still tells something.
    pub within: BTreeMap<String, f64>,
    /// Why a metric may differ: by `GENERATOR METRIC`, by generator, or by metric.
    pub because: BTreeMap<String, String>,
    /// Metrics that are this number times a share of scenes.
    pub share_times: BTreeMap<String, f64>,
    /// Method that the others are ordered against, with its operating point.
    pub reference: Option<String>,
    /// Metrics of the orderings.
    pub ordered: Vec<String>,
}

/// A limit on a metric of drives: at most, or at least.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limit {
    /// The metric.
    pub metric: String,
    /// Its largest value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_most: Option<f64>,
    /// Its least value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_least: Option<f64>,
}

impl Limit {
    /// The limit in words.
    pub fn words(&self) -> String {
        let bound = |sign: &str, value: Option<f64>| value.map(|value| format!(" {sign} {value}"));
        let bounds = [bound("≤", self.at_most), bound("≥", self.at_least)];
        self.metric.clone() + &bounds.into_iter().flatten().collect::<String>()
    }
}

/// What is compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PairSpec {
    /// What is compared.
    pub of: Subject,
    /// A generator that the others are compared with; `arms` for all pairs of arms; `first` for the first arm;
    /// `first-point` for the first operating point of the same arm.
    pub with: String,
    /// Metrics.
    pub metrics: Vec<String>,
}

/// Differences that are tested together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Family {
    /// Title.
    pub title: String,
    /// Arm that is tested.
    pub tested: String,
    /// Arms that it is tested against; by default all other runs.
    #[serde(default)]
    pub against: Vec<String>,
    /// Verdict on a difference as expected, and on the opposite.
    pub verdicts: [String; 2],
    /// What is expected; by default each difference between the published numbers of the two arms, with its sign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub claims: Option<Vec<Claim>>,
    /// By metric: a difference that is not resolved is bounded if its whole interval is at most this far from 0.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub bounded: BTreeMap<String, f64>,
    /// When a difference as expected does not count.
    #[serde(default)]
    pub unless: Option<Guard>,
}

/// What is expected of the tested arm less another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    /// Generator that attacks; empty for unchanged scenes.
    pub attack: String,
    /// Metric.
    pub metric: String,
    /// Whether its difference is expected above 0.
    pub larger: bool,
}

/// A metric in which the tested arm must not be lower.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Guard {
    /// Metric.
    pub metric: String,
    /// By how much it may be lower.
    pub lower_by: f64,
    /// Verdict on a difference as expected that is bought so.
    pub verdict: String,
}

/// A quantity of the curve of R_adv and P_real over the operating points of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CurveQuantity {
    /// Area that the means dominate in the plane of R_adv and P_real.
    Hypervolume,
    /// The same less that of the first method.
    HypervolumeMinusFirst,
    /// Share of the steps at which R_adv does not fall.
    Monotone,
    /// Deviation of the attack rate from a straight line.
    Unevenness,
    /// The best of the first method at no more P_real, less each point of the others.
    EqualRealism,
    /// Heights of rewards above the chord between the ends, and where they are concave.
    AboveChord,
    /// λ at which a weighted sum of R_adv and P_real is largest.
    BestLambda,
}

/// A chart of the means of two metrics over the operating points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChartSpec {
    /// File name.
    pub file: String,
    /// What the metrics are of.
    pub of: Subject,
    /// Metric of the horizontal axis; `lambda` or `aggression` for the operating point; `operating-point` for sweeps of
    /// aggression and of λ = μ; `triangle` for mixtures of three experts; `plane` for the plane of two experts; `series` for the numbers at the
    /// end of the names of metrics, such as 16 in `failure in 16`.
    pub x: String,
    /// Metric of the vertical axis. In a triangle: of the first picture. On a plane: of the colour. Of a series: the names of
    /// its metrics without the numbers.
    pub y: String,
    /// Further metrics of a triangle, one picture each.
    #[serde(default)]
    pub more: Vec<String>,
    /// Label of the horizontal axis of a `series`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<String>,
}
