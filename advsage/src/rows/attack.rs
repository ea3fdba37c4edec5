//! The row of one attack, as its JSON file holds it.

use std::{fmt, path::Path};

use sage_core::{
    files,
    generator::{Extension, Note},
    motion::Trajectory,
    objective::{Reason, Scores, Violation},
    selection_outcome::{CandidateCounts, SelectionOutcome},
    text::escaped_name,
};
use sage_sim::{avoidable::Avoidable, reference::Answer};
use serde::{
    Deserialize, Deserializer, Serialize,
    de::{IgnoredAny, MapAccess, Visitor},
};
use serde_json::{Map, Value};

use super::{GeneratedBy, ROW_LIMIT};

/// A row holds all but its candidates within this many bytes.
const HEAD: u64 = 1 << 16;

/// One attack, as its file records it (`docs/formats.md` lists the fields, `sage generate` fills them in `sage-run`); `C` are its candidates, or [`IgnoredAny`] to read it without them.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AttackRow<C = IgnoredAny> {
    /// Hash of the run's identity. The first field, so that it can be checked without reading the row.
    pub run_hash: String,
    /// Name of the input file without its ending.
    pub scene: String,
    /// Name of the operating point, as in file names.
    pub variant: String,
    /// Hash of the input file.
    pub source_hash: String,
    /// The scene files of this attack.
    pub files: Vec<String>,
    /// Seed of the run.
    pub seed: u64,
    /// Track of the adversary.
    pub adversary: String,
    /// How it was generated.
    #[serde(flatten)]
    pub generated: GeneratedBy,
    /// The adversary's plan.
    pub trajectory: Trajectory,
    /// Number of the candidate that is selected.
    pub chosen: usize,
    /// Feasibility by the rule of the selection, like `violations`.
    pub feasible: bool,
    /// Violations of that rule.
    pub violations: Vec<Violation>,
    /// What came of the selection.
    pub outcome: SelectionOutcome,
    /// What its candidates do.
    pub counts: CandidateCounts,
    /// What the generator says of it.
    pub note: Option<String>,
    /// What the generator adds, as a field of its own. Readers do not need it.
    #[serde(flatten, skip_deserializing)]
    pub extension: Option<Extension>,
    /// Scores of the selected candidate.
    pub scores: ChosenScores,
    /// The last field, so that the others can be read without it. Empty if the run wrote none.
    pub candidates: C,
}

/// Scores of the selected candidate, and whether a driver could have avoided it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ChosenScores {
    /// Its scores.
    #[serde(flatten)]
    pub scores: Scores,
    /// Whether an evasive manoeuvre exists.
    #[serde(flatten)]
    pub avoidable: Avoidable,
    /// Whether the reference driver `r157` prevents the contact; empty without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub references: Vec<Answer>,
}

/// One candidate of an attack; `T` is its trajectory and `S` its scores, which are written as they were printed once and read as needed.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CandidateRow<T, S = IgnoredAny> {
    /// Log-probability under the network, if it has one.
    pub log_prob: Option<f64>,
    /// Negative log-likelihood under the prior, nats, if the selection needs it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nll: Option<f64>,
    /// Goal, metres.
    pub goal: Option<[f64; 2]>,
    /// The adversary's plan.
    pub trajectory: T,
    /// Its scores.
    pub scores: S,
}

/// The row of a scene in which no attack can be measured: the cars touch *now*, or a person has no place.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LeftOutRow {
    /// Hash of the run's identity.
    pub run_hash: String,
    /// Name of the input file without its ending.
    pub scene: String,
    /// Name of the operating point, as in file names.
    pub variant: String,
    /// Hash of the input file.
    pub source_hash: String,
    /// None.
    pub files: [String; 0],
    /// Why.
    pub left_out: String,
}

impl LeftOutRow {
    /// The printed line.
    pub fn line(&self) -> String {
        let [scene, variant] = [&self.scene, &self.variant].map(|name| escaped_name(name));
        let why = if self.left_out.contains("no_place") { "no place" } else { "contact now" };
        format!("{scene} {variant}: left out, {why}")
    }
}

/// Whether the only reference prevents a contact; `None` without one, or if it cannot drive.
pub fn is_prevented(answers: &[Answer]) -> Option<bool> {
    answers.last()?.prevents
}

impl AttackRow {
    /// Reads a row; `None` if the file is missing, incomplete, or says that its scene is left out.
    pub fn read(path: &Path) -> Option<Self> {
        serde_json::from_slice(&files::read(path, ROW_LIMIT).ok()?).ok()
    }

    /// The same without reading the candidates, which are nine tenths of a file.
    pub fn read_head(path: &Path) -> Option<Self> {
        let bytes = files::read_start(path, HEAD).ok()?;
        let mut fields = Fields(Map::new());
        // The reader stops at the candidates, which is an error to the parser.
        let _ = serde_json::Deserializer::from_slice(&bytes).deserialize_map(&mut fields);
        let head = serde_json::from_value(Value::Object(fields.0)).ok();
        head.or_else(|| Self::read(path))
    }
}

/// The fields of a row up to its candidates.
struct Fields(Map<String, Value>);

impl<'de> Visitor<'de> for &mut Fields {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a row")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<String>()? {
            if key == "candidates" {
                self.0.insert(key, Value::Null);
                break;
            }
            self.0.insert(key, map.next_value()?);
        }
        Ok(())
    }
}

impl<C> AttackRow<C> {
    /// What came of the attack, in words.
    pub fn words(&self) -> String {
        let scores = &self.scores.scores;
        words(self.outcome, &self.counts, scores.collision_step, &scores.unbelievable)
    }

    /// The printed line; `seconds` is the time of the attack, `None` if an earlier run made it.
    pub fn line(&self, seconds: Option<f64>) -> String {
        let Scores { adversarial_reward, kinematic_penalty, behavior_penalty, .. } = &self.scores.scores;
        let note = own_note(&self.note);
        let note = if note.is_empty() { String::new() } else { format!("; {note}") };
        let values = match self.outcome.is_attack() {
            true => format!(
                "; R_adv {adversarial_reward:.2}, P_kin {kinematic_penalty:.2}, P_beh {behavior_penalty:.2}"
            ),
            false => String::new(),
        };
        format!(
            "{} {}: {}{values}{note} ({})",
            escaped_name(&self.scene),
            escaped_name(&self.variant),
            self.words(),
            seconds.map_or("finished before".to_owned(), |s| format!("{:.0} ms", 1e3 * s)),
        )
    }
}

/// What came of an attack, in words.
pub fn words(
    outcome: SelectionOutcome,
    counts: &CandidateCounts,
    contact: Option<usize>,
    unbelievable: &[Reason],
) -> String {
    let after = contact.map_or(String::new(), |step| format!(" after {:.1} s", step as f64 / 10.0));
    let reasons = || unbelievable.iter().map(Reason::words).collect::<Vec<_>>().join(", ");
    match outcome {
        SelectionOutcome::Attack => format!("attack{after}, believable"),
        SelectionOutcome::NotBelievable => format!("attack{after}, not believable ({})", reasons()),
        other => counts.outcome_words(other),
    }
}

/// A note that says more than the outcome does.
fn own_note(note: &Option<String>) -> &str {
    let is_said =
        |text: &str| [Note::NoneFeasible, Note::NoContact].iter().any(|said| said.to_string() == text);
    note.as_deref().filter(|text| !is_said(text)).unwrap_or_default()
}
