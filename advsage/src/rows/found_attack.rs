//! A row that is read back: to resume, to print its line, and for table and page of a run.

use std::path::Path;

use sage_core::{
    files,
    generator::Note,
    motion::Trajectory,
    objective::{Reason, Scores},
    selection_outcome::{CandidateCounts, SelectionOutcome},
    text::escaped_name,
};
use sage_sim::{avoidable::Avoidable, reference::Answer};
use serde::Deserialize;

use super::{ROW_LIMIT, attack::VariantRow};

/// A row holds all but its candidates within this many bytes.
const HEAD: u64 = 1 << 16;

/// An attack without the candidates that were not selected.
#[derive(Debug, Deserialize)]
pub struct FoundRow {
    /// Hash of the run's identity.
    pub run_hash: String,
    /// Name of the input file without its ending.
    pub scene: String,
    /// Name of the operating point, as in file names.
    pub variant: String,
    /// Hash of the input file.
    pub source_hash: String,
    /// The scene files of this attack.
    pub files: Vec<String>,
    /// Track of the adversary.
    pub adversary: String,
    /// The adversary's plan.
    pub trajectory: Trajectory,
    /// What came of the selection.
    pub outcome: SelectionOutcome,
    /// What its candidates do.
    pub counts: CandidateCounts,
    /// What the generator says of it.
    pub note: Option<String>,
    /// Scores of the selected candidate.
    pub scores: FoundScores,
}

/// Scores of the selected candidate that are printed and drawn.
#[derive(Debug, Deserialize)]
pub struct FoundScores {
    /// Step of the contact, after *now*.
    pub collision_step: Option<usize>,
    /// Adversarial reward of the paper.
    pub adversarial_reward: f64,
    /// Kinematic penalty of the paper.
    pub kinematic_penalty: f64,
    /// Behaviour penalty of the paper.
    pub behavior_penalty: f64,
    /// Why not.
    #[serde(default)]
    pub unbelievable: Vec<Reason>,
    /// Relative speed at the contact, m/s.
    pub impact_speed: Option<f64>,
    /// Whether an evasive manoeuvre exists.
    #[serde(flatten)]
    pub avoidable: Avoidable,
    /// Whether reference drivers prevent the contact.
    #[serde(default)]
    pub references: Vec<Answer>,
}

impl FoundRow {
    /// Reads a whole row; `None` if the file is missing, incomplete, or says that its scene is left out.
    pub fn read(path: &Path) -> Option<Self> {
        serde_json::from_slice(&files::read(path, ROW_LIMIT).ok()?).ok()
    }

    /// The same without looking at the candidates, which are nine tenths of a row.
    pub fn read_head(path: &Path) -> Option<Self> {
        let head = files::read_start(path, HEAD).ok()?;
        // No text holds this: a quotation mark in it is escaped.
        let head = std::str::from_utf8(&head).ok().and_then(|head| head.split_once(",\"candidates\":["));
        match head {
            Some((head, _)) => serde_json::from_str(&format!("{head}}}")).ok(),
            None => Self::read(path),
        }
    }

    /// What came of the attack, in words.
    pub fn words(&self) -> String {
        words(self.outcome, &self.counts, self.scores.collision_step, &self.scores.unbelievable)
    }

    /// The printed line.
    pub fn line(&self) -> String {
        let FoundScores { adversarial_reward, kinematic_penalty, behavior_penalty, .. } = self.scores;
        let penalties = [adversarial_reward, kinematic_penalty, behavior_penalty];
        line(
            [&self.scene, &self.variant],
            self.outcome,
            [&self.words(), own_note(&self.note)],
            penalties,
            None,
        )
    }
}

impl VariantRow<'_> {
    /// The printed line; `seconds` is the time of the attack.
    pub fn line(&self, seconds: f64) -> String {
        let Scores {
            collision_step,
            unbelievable,
            adversarial_reward,
            kinematic_penalty,
            behavior_penalty,
            ..
        } = self.scores.scores;
        let words = words(self.outcome, self.counts, *collision_step, unbelievable);
        let penalties = [*adversarial_reward, *kinematic_penalty, *behavior_penalty];
        line(
            [self.scene, self.variant],
            self.outcome,
            [&words, own_note(&self.note)],
            penalties,
            Some(seconds),
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

fn line(
    [scene, variant]: [&str; 2],
    outcome: SelectionOutcome,
    [words, note]: [&str; 2],
    [reward, kinematic, behavior]: [f64; 3],
    seconds: Option<f64>,
) -> String {
    let note = if note.is_empty() { String::new() } else { format!("; {note}") };
    let values = match outcome.is_attack() {
        true => format!("; R_adv {reward:.2}, P_kin {kinematic:.2}, P_beh {behavior:.2}"),
        false => String::new(),
    };
    format!(
        "{} {}: {words}{values}{note} ({})",
        escaped_name(scene),
        escaped_name(variant),
        seconds.map_or("finished before".to_owned(), |s| format!("{:.0} ms", 1e3 * s)),
    )
}
