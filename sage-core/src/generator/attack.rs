//! What a generator gives for one scene.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{Error, geometry::Point, motion::Trajectory, scene::Scene};

/// A trajectory that a generator thought of.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// The 80 positions, world frame.
    pub trajectory: Trajectory,
    /// Log-probability under the generator's model, if it has one: to compare candidates of one scene. Where
    /// speed profiles are tried these do not sum to 1.
    pub log_prob: Option<f64>,
    /// Where it was meant to end, metres, world frame, if it was aimed.
    pub goal: Option<Point>,
    /// Negative log-likelihood under the prior, nats, up to what the proposals of a scene share; `None`
    /// where nobody asked for it.
    pub nll: Option<f64>,
}

impl Proposal {
    /// A trajectory with nothing known of it.
    pub fn of(trajectory: Trajectory) -> Self {
        Self { trajectory, log_prob: None, goal: None, nll: None }
    }
}

/// Why an attack is not what it should be.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Note {
    /// No candidate is feasible.
    NoneFeasible,
    /// No candidate makes contact.
    NoContact,
    /// What a generator from elsewhere has to say.
    Other(String),
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::NoneFeasible => "no candidate is feasible; the one that breaks least was taken",
            Self::NoContact => "no candidate makes contact; the one that comes nearest was taken",
            Self::Other(text) => text,
        })
    }
}

/// Candidates, and the one that was chosen.
#[derive(Clone, Debug, PartialEq)]
pub struct Attack {
    /// What was thought of, at least one.
    pub candidates: Vec<Proposal>,
    /// Index of the one that was chosen.
    pub chosen: usize,
    /// Why the choice is not what it should be, if so.
    pub note: Option<Note>,
}

impl Attack {
    /// The only candidate.
    pub fn only(candidate: Proposal) -> Self {
        Self { candidates: vec![candidate], chosen: 0, note: None }
    }

    /// Refuses an attack that means nothing: a choice that is not among the candidates, or a
    /// log-probability or goal that is not finite. Trajectories are checked when they are made.
    ///
    /// *Errors*: [`Error::Scene`] with the candidate at fault.
    pub fn check(&self, scene: &Scene) -> Result<(), Error> {
        let fail = |problem: String| Err(Error::Scene { scene: scene.id.clone(), problem });
        if self.chosen >= self.candidates.len() {
            let (chosen, count) = (self.chosen, self.candidates.len());
            return fail(format!("the generator chose candidate {chosen} of {count}"));
        }
        for (k, candidate) in self.candidates.iter().enumerate() {
            let values = candidate.goal.into_iter().flatten().chain(candidate.log_prob);
            if let Some(value) = values.into_iter().find(|x| !x.is_finite()) {
                return fail(format!("candidate {k} has a goal or log-probability of {value}"));
            }
        }
        Ok(())
    }

    /// The chosen trajectory.
    pub fn trajectory(&self) -> &Trajectory {
        &self.candidates[self.chosen].trajectory
    }
}
