//! The specification of an objective and its JSON form.
//!
//! ```json
//! {"terms": [{"name": "adversarial", "weight": {"mu0": 0, "mu1": 1}}, {"name": "realism", "weight": -0.5}],
//!  "feasibility": {"name": "paper"}}
//! ```

use serde::{Deserialize, Serialize, de::Error as _};
use serde_json::{Map, Value};

use super::reason::MIN_DEPTH;

/// Weighted terms, one feasibility rule, and the weight of violations.
///
/// ```
/// use sage_core::objective::ObjectiveSpec;
///
/// let spec: ObjectiveSpec = serde_json::from_str(
///     r#"{"terms": [{"name": "adversarial", "weight": {"mu0": 0, "mu1": 1}},
///                   {"name": "realism", "weight": -0.5}]}"#,
/// )?;
/// // A weight is a number, or linear in μ. What is left out has its default: the paper's rule.
/// assert_eq!((spec.terms[0].weight.at(0.25), spec.terms[1].weight.at(0.25)), (0.25, -0.5));
/// assert_eq!(spec.feasibility.name, "paper");
/// // The shipped objectives are specifications too.
/// assert!(ObjectiveSpec::preset("natural").is_some_and(|natural| natural.believable_first));
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectiveSpec {
    /// The weighted rewards.
    pub terms: Vec<TermSpec>,
    /// The feasibility rule; the paper's rule by default.
    #[serde(default)]
    pub feasibility: PartSpec,
    /// Weight of the costs of violations in the value, ≥ 0. The default 0 is for selections that rank
    /// feasibility first.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub violation_weight: f64,
    /// Whether a selection that would take a hit which a person would not believe takes the best believable one instead, if
    /// there is any.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub believable_first: bool,
}

/// One weighted reward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TermSpec {
    /// Name in the registry of rewards.
    pub name: String,
    /// Weight; negative for a penalty.
    pub weight: Weight,
    /// Options; omitted ones keep their defaults.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub options: Map<String, Value>,
    /// Whether it is measured only for feasible candidates, as lane distance and time against the traffic are in `natural`.
    /// This saves the slowest term where nothing is feasible.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub only_feasible: bool,
}

impl ObjectiveSpec {
    /// Whether μ changes what it selects.
    pub fn depends_on_mu(&self) -> bool {
        self.terms.iter().any(|term| !term.weight.is_constant())
    }
}

impl TermSpec {
    /// Whether another term has the same value for every candidate, regardless of its weight.
    pub(super) fn measures_as(&self, other: &Self) -> bool {
        self.name == other.name && self.options == other.options && self.only_feasible == other.only_feasible
    }
}

/// A part of a registry by name, with options.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartSpec {
    /// Name in the registry.
    pub name: String,
    /// Options; omitted ones keep their defaults.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub options: Map<String, Value>,
}

impl Default for PartSpec {
    /// The paper's feasibility rule.
    fn default() -> Self {
        Self::named("paper")
    }
}

impl PartSpec {
    /// A part with its default options.
    pub fn named(name: &str) -> Self {
        Self { name: name.to_owned(), options: Map::new() }
    }
}

/// Largest weight of a term and of violations. Larger ones only hide the other terms, and their sums could overflow.
pub const MAX_WEIGHT: f64 = 1e9;

/// Largest number of terms of an objective: each takes time for every candidate.
pub const MOST_TERMS: usize = 64;

/// A weight: one number, or two numbers, at μ = 0 and μ = 1, with linear interpolation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Weight {
    /// Constant in μ.
    Constant(f64),
    /// Linear in μ.
    Linear {
        /// At μ = 0.
        mu0: f64,
        /// At μ = 1.
        mu1: f64,
    },
}

impl Weight {
    /// Value at a μ.
    pub fn at(self, mu: f64) -> f64 {
        match self {
            Self::Constant(weight) => weight,
            Self::Linear { mu0, mu1 } => (1.0 - mu) * mu0 + mu * mu1,
        }
    }

    /// Whether it is the same at every μ.
    pub fn is_constant(self) -> bool {
        self.at(0.0) == self.at(1.0)
    }

    /// The value at μ = 0 or 1 that is beyond ±[`MAX_WEIGHT`] or no number, if there is one.
    pub(super) fn out_of_range(self) -> Option<f64> {
        let ends = [self.at(0.0), self.at(1.0)];
        ends.into_iter().find(|weight| !(weight.abs() <= MAX_WEIGHT))
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    mu0: f64,
    mu1: f64,
}

impl Serialize for Weight {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match *self {
            Self::Constant(weight) => serializer.serialize_f64(weight),
            Self::Linear { mu0, mu1 } => Line { mu0, mu1 }.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Weight {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match Value::deserialize(deserializer)? {
            Value::Number(number) => Ok(Self::Constant(number.as_f64().unwrap_or(f64::NAN))),
            line @ Value::Object(_) => {
                let Line { mu0, mu1 } = Line::deserialize(line).map_err(D::Error::custom)?;
                Ok(Self::Linear { mu0, mu1 })
            }
            other => Err(D::Error::custom(format!(
                r#"weight is `{other}`; expected a number or {{"mu0": number, "mu1": number}}"#
            ))),
        }
    }
}

fn is_zero(weight: &f64) -> bool {
    *weight == 0.0
}

/// The shipped objectives: name and description.
pub const PRESETS: [(&str, &str); 8] = [
    ("natural", "believable attacks: (1 − mu) · natural-realistic + mu · natural-adversarial"),
    ("natural-adversarial", "the shipped adversarial expert: early solid contact, realism, lanes, traffic"),
    ("natural-realistic", "the shipped realistic expert: realism, lanes, traffic"),
    (
        "lawful",
        "the shipped lawful expert: lanes, direction of traffic, speed limits; medians by the rule `drivable`",
    ),
    ("paper-selection", "the paper's selection: mu · adversarial − (1 − mu) · realism"),
    ("paper-adversarial", "the paper's adversarial expert: 0.9 · adversarial − 0.1 · realism"),
    ("paper-realistic", "the paper's realistic expert: 0.1 · adversarial − 0.9 · realism"),
    ("realistic", "realism alone: the realistic expert of `waymo-paper`"),
];

/// Weights of a natural objective.
struct Natural {
    /// A contact of at least [`MIN_DEPTH`], and one of any depth: a graze is better than none.
    adversarial: [f64; 2],
    realism: f64,
    /// A metre of mean lane distance before the contact, and after it.
    lanes: [f64; 2],
    /// A second against the traffic before the contact, and after it.
    against: [f64; 2],
}

/// Small weights: at μ = 0 only their ratios matter, and at μ = 0.5 they should not suppress attacks.
const NATURAL_REALISTIC: Natural =
    Natural { adversarial: [0.0, 0.0], realism: -0.3, lanes: [-0.1, -0.1], against: [-0.5, -0.15] };
const NATURAL_ADVERSARIAL: Natural =
    Natural { adversarial: [0.9, 0.1], realism: -0.35, lanes: [-0.3, -0.1], against: [-1.5, -0.2] };

impl ObjectiveSpec {
    /// The preset of a name; [`PRESETS`] lists them. `paper` is short for `paper-selection`.
    pub fn preset(name: &str) -> Option<Self> {
        let constant = Weight::Constant;
        let paper = |adversarial, realism| {
            let terms = vec![term("adversarial", adversarial), term("realism", realism)];
            Self { terms, feasibility: PartSpec::default(), violation_weight: 0.0, believable_first: false }
        };
        Some(match name {
            "natural" => {
                let weights = |weight: fn(&Natural) -> f64| {
                    let [mu0, mu1] = [&NATURAL_REALISTIC, &NATURAL_ADVERSARIAL].map(weight);
                    if mu0 == mu1 { constant(mu0) } else { Weight::Linear { mu0, mu1 } }
                };
                Self { believable_first: true, ..natural(&weights) }
            }
            "natural-adversarial" => natural(&|weight| constant(weight(&NATURAL_ADVERSARIAL))),
            "natural-realistic" => natural(&|weight| constant(weight(&NATURAL_REALISTIC))),
            "lawful" => lawful(),
            "paper-selection" | "paper" => {
                paper(Weight::Linear { mu0: 0.0, mu1: 1.0 }, Weight::Linear { mu0: -1.0, mu1: 0.0 })
            }
            "paper-adversarial" => paper(constant(0.9), constant(-0.1)),
            "paper-realistic" => paper(constant(0.1), constant(-0.9)),
            "realistic" => Self {
                terms: vec![term("realism", constant(-0.9))],
                feasibility: PartSpec::default(),
                violation_weight: 0.0,
                believable_first: false,
            },
            _ => return None,
        })
    }
}

/// A natural objective; `weight` gives the weight of a term from its field.
fn natural(weight: &dyn Fn(fn(&Natural) -> f64) -> Weight) -> ObjectiveSpec {
    let with = |name: &str, weight, key: &str, value: Value| TermSpec {
        options: Map::from_iter([(key.to_owned(), value)]),
        ..term(name, weight)
    };
    // If no candidate is feasible, lanes and traffic are not compared.
    let among_feasible = |term: TermSpec| TermSpec { only_feasible: true, ..term };
    let phase = |name, phase: &str, weight| among_feasible(with(name, weight, "phase", phase.into()));
    let terms = [
        with("adversarial", weight(|w| w.adversarial[0]), "min_depth", MIN_DEPTH.into()),
        term("adversarial", weight(|w| w.adversarial[1])),
        term("realism", weight(|w| w.realism)),
        phase("lane-distance", "before", weight(|w| w.lanes[0])),
        phase("lane-distance", "after", weight(|w| w.lanes[1])),
        phase("against-traffic", "before", weight(|w| w.against[0])),
        phase("against-traffic", "after", weight(|w| w.against[1])),
    ];
    // A term without weight at every μ costs time and changes nothing.
    let terms = terms.into_iter().filter(|term| term.weight != Weight::Constant(0.0)).collect();
    ObjectiveSpec {
        terms,
        feasibility: PartSpec::named("drivable"),
        violation_weight: 0.0,
        believable_first: false,
    }
}

/// The traffic rules that a map holds. The rule `drivable` adds the medians. A little of P_real keeps a car that
/// has no lane near it from any motion.
fn lawful() -> ObjectiveSpec {
    let whole = |name: &str, weight| TermSpec {
        options: Map::from_iter([("phase".to_owned(), "whole".into())]),
        ..term(name, Weight::Constant(weight))
    };
    let terms = vec![
        whole("lane-distance", -1.0),
        whole("against-traffic", -1.0),
        whole("above-speed-limit", -1.0),
        term("realism", Weight::Constant(-0.1)),
    ];
    ObjectiveSpec {
        terms,
        feasibility: PartSpec::named("drivable"),
        violation_weight: 0.0,
        believable_first: false,
    }
}

fn term(name: &str, weight: Weight) -> TermSpec {
    TermSpec { name: name.to_owned(), weight, options: Map::new(), only_feasible: false }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spec_parses_as_written_and_unknown_keys_are_named() {
        let text = r#"{"terms": [{"name": "adversarial", "weight": {"mu0": 0, "mu1": 1}}, {"name": "realism", "weight": -1}]}"#;
        let spec: ObjectiveSpec = serde_json::from_str(text).unwrap();
        assert_eq!(spec.feasibility.name, "paper");
        assert_eq!(spec.terms[0].weight.at(0.25), 0.25);
        assert_eq!(spec.terms[1].weight.at(0.25), -1.0);
        let again: ObjectiveSpec = serde_json::from_value(serde_json::to_value(&spec).unwrap()).unwrap();
        assert_eq!(again, spec);
        for (bad, expected) in [
            (r#"{"terms": [], "rule": "paper"}"#, "`rule`"),
            (r#"{"terms": [{"name": "a", "wieght": 1}]}"#, "`wieght`"),
            (r#"{"terms": [{"name": "a", "weight": {"mu0": 1, "mu2": 2}}]}"#, "`mu2`"),
            (r#"{"terms": [{"name": "a", "weight": "much"}]}"#, "expected a number or"),
        ] {
            let error = serde_json::from_str::<ObjectiveSpec>(bad).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn every_preset_exists_and_the_papers_selection_weighs_by_mu() {
        for (name, _) in PRESETS {
            assert!(ObjectiveSpec::preset(name).is_some(), "{name}");
        }
        assert_eq!(ObjectiveSpec::preset("none"), None);
        assert_eq!(ObjectiveSpec::preset("paper"), ObjectiveSpec::preset("paper-selection"));
        let terms = ObjectiveSpec::preset("paper-selection").unwrap().terms;
        for mu in [0.0, 0.3, 0.77, 1.0] {
            assert_eq!([terms[0].weight.at(mu), terms[1].weight.at(mu)], [mu, -(1.0 - mu)]);
        }
    }

    #[test]
    fn natural_is_the_mixture_of_its_experts_objectives() {
        let [natural, realistic, adversarial] = ["natural", "natural-realistic", "natural-adversarial"]
            .map(|name| ObjectiveSpec::preset(name).unwrap());
        let weight = |spec: &ObjectiveSpec, like: &TermSpec| {
            spec.terms.iter().find(|term| term.measures_as(like)).map_or(0.0, |term| term.weight.at(0.0))
        };
        for expert in [&realistic, &adversarial] {
            assert!(expert.terms.iter().all(|term| natural.terms.iter().any(|n| n.measures_as(term))));
            assert_eq!(expert.feasibility, natural.feasibility);
        }
        for term in &natural.terms {
            for mu in [0.0, 0.25, 1.0] {
                let mixed = (1.0 - mu) * weight(&realistic, term) + mu * weight(&adversarial, term);
                assert!((term.weight.at(mu) - mixed).abs() < 1e-12, "{term:?}");
            }
        }
    }
}
