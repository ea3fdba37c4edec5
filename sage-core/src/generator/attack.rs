//! Output of a generator for one scene.

use std::fmt;

use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

use super::Reaction;
use crate::{
    Error,
    geometry::Point,
    motion::{DT, HORIZON, NOW, Trajectory},
    scene::Scene,
};

/// A proposed trajectory of the adversary.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// The 80 positions, world frame.
    pub trajectory: Trajectory,
    /// Log-probability under the generator's model, if it has one. It is for comparing candidates of one
    /// scene: with several speed profiles the probabilities do not sum to 1.
    pub log_prob: Option<f64>,
    /// Goal of the trajectory, metres, world frame; `None` without a goal.
    pub goal: Option<Point>,
    /// Negative log-likelihood under the prior, nats, up to a constant that all proposals of a scene share;
    /// `None` if it was not requested.
    pub nll: Option<f64>,
}

impl Proposal {
    /// A proposal without log-probability, goal and negative log-likelihood.
    pub fn of(trajectory: Trajectory) -> Self {
        Self { trajectory, log_prob: None, goal: None, nll: None }
    }
}

/// Warning about an attack.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Note {
    /// No candidate is feasible.
    NoneFeasible,
    /// No candidate makes contact.
    NoContact,
    /// The generator's own test, at fewer frames, found no contact.
    Nearest,
    /// Message of a generator outside this project.
    Other(String),
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::NoneFeasible => "no candidate is feasible; the least violating one was selected",
            Self::NoContact => "no candidate makes contact; the nearest one was selected",
            Self::Nearest => "selected because it comes nearest at the frames that the generator compares",
            Self::Other(text) => text,
        })
    }
}

/// Candidates and the selected one.
///
/// ```
/// use sage_core::{
///     generator::{Attack, Note, Proposal},
///     motion::Trajectory,
/// };
///
/// let standing = Trajectory::new("standing", vec![[5.0, 0.0]; 80])?;
/// let moving = Trajectory::new("moving", (1..=80).map(|step| [f64::from(step), 0.0]).collect())?;
/// // An attack holds all candidates, and which of them was selected and why.
/// let candidates = vec![Proposal::of(standing), Proposal::of(moving.clone())];
/// let attack = Attack::of(candidates, 1, Some(Note::NoContact));
/// assert_eq!(*attack.trajectory(), moving);
/// assert_eq!(Note::NoContact.to_string(), "no candidate makes contact; the nearest one was selected");
/// # Ok::<(), sage_core::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Attack {
    /// All candidates, at least one.
    pub candidates: Vec<Proposal>,
    /// Index of the selected candidate.
    pub chosen: usize,
    /// Warning about the selection, if any.
    pub note: Option<Note>,
    /// What drives the adversary in place of the selected trajectory from a frame on; `None` if it follows it to the end.
    pub reaction: Option<Reaction>,
    /// What the generator adds, if anything.
    pub extension: Option<Extension>,
}

/// A value that a generator adds to its attacks, under a name of its own, which is a field of the attack's row. What it means, the
/// generator alone knows.
#[derive(Clone, Debug, PartialEq)]
pub struct Extension {
    /// Its name.
    pub name: String,
    /// The value.
    pub value: Value,
}

impl Serialize for Extension {
    /// As the field of a row.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map([(&self.name, &self.value)])
    }
}

impl Attack {
    /// An attack with a single candidate.
    pub fn only(candidate: Proposal) -> Self {
        Self::of(vec![candidate], 0, None)
    }

    /// An attack that follows the selected candidate to the end.
    pub fn of(candidates: Vec<Proposal>, chosen: usize, note: Option<Note>) -> Self {
        Self { candidates, chosen, note, reaction: None, extension: None }
    }

    /// The attack of an adversary that reacted, as it was driven against somebody: the path that it drove is a further
    /// candidate, and selected. An attack that does not react stays as it is.
    pub fn with_drive(mut self, path: Trajectory, against: &str) -> Self {
        let Some(reaction) = self.reaction.take() else { return self };
        let text = format!(
            "the adversary reacts from {:.1} s on; this is the path that it drove against {against}",
            reaction.from.saturating_sub(NOW) as f64 * DT
        );
        self.chosen = self.candidates.len();
        self.candidates.push(Proposal::of(path));
        let before = self.note.take().map_or(String::new(), |note| format!("{note}; "));
        self.note = Some(Note::Other(before + &text));
        self
    }

    /// Checks an attack: the selected index is among the candidates, every log-probability and goal is finite, and a
    /// reaction begins in the future. Trajectories are checked on construction.
    ///
    /// *Errors*: [`Error::Scene`] with the number of the invalid candidate.
    pub fn check(&self, scene: &Scene) -> Result<(), Error> {
        let fail = |problem: String| Err(Error::Scene { scene: scene.id.clone(), problem });
        if self.chosen >= self.candidates.len() {
            let (chosen, count) = (self.chosen, self.candidates.len());
            return fail(format!("the generator selected candidate {chosen} of {count}"));
        }
        for (k, candidate) in self.candidates.iter().enumerate() {
            let values = candidate.goal.into_iter().flatten().chain(candidate.log_prob);
            if let Some(value) = values.into_iter().find(|x| !x.is_finite()) {
                return fail(format!("candidate {k} has a goal or log-probability of {value}"));
            }
        }
        let from = self.reaction.as_ref().map(|reaction| reaction.from);
        if let Some(from) = from.filter(|from| !(NOW..=NOW + HORIZON).contains(from)) {
            let last = NOW + HORIZON;
            return fail(format!(
                "the adversary reacts from frame {from} on; expected a frame from {NOW} to {last}"
            ));
        }
        Ok(())
    }

    /// The selected trajectory.
    pub fn trajectory(&self) -> &Trajectory {
        &self.candidates[self.chosen].trajectory
    }
}
