//! What every generator of adversarial scenes offers.

use crate::{Error, geometry::Point, motion::Trajectory, objective::Context, scene::Scene};

/// One way that a generator thought of.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposed {
    /// The 80 positions, world frame.
    pub trajectory: Trajectory,
    /// How likely the generator's model finds it, if it has one: to compare candidates of one scene; where
    /// paces are tried these do not sum to 1.
    pub log_prob: Option<f64>,
    /// Where it was meant to end, metres, world frame, if it was aimed.
    pub goal: Option<Point>,
}

/// What a generator gives for one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Attack {
    /// All that it thought of, at least one.
    pub candidates: Vec<Proposed>,
    /// Index of the one it chose.
    pub chosen: usize,
    /// Why the choice is not what it should be, if so: none was feasible, nothing could hit, …
    pub note: Option<String>,
}

impl Attack {
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

    /// The chosen way.
    pub fn trajectory(&self) -> &Trajectory {
        &self.candidates[self.chosen].trajectory
    }
}

/// Makes the adversary of a scene do something else than it did.
///
/// Implementations are pure: the same context and seed give the same bits on any thread.
pub trait Generator: Send + Sync {
    /// Its name with what tells it from its siblings, for tables.
    fn name(&self) -> String;

    /// Candidates for the adversary of a context, and the choice among them.
    ///
    /// *Errors*: [`Error::Scene`] for a scene that it cannot work with.
    fn generate(&self, ctx: &Context, seed: u64) -> Result<Attack, Error>;
}
