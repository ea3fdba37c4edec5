//! Interface of rewards for trajectories of the adversary.

use super::{Candidate, Context, EgoPath, Encounter};

/// A candidate against one path of the ego: the input of a reward. It is one value, so a new field breaks no reward. All terms
/// share its encounter, which costs as much as the paper's other measures together.
pub struct Situation<'a> {
    /// The adversary's trajectory with its profile and boxes.
    pub candidate: &'a Candidate,
    /// The ego's path.
    pub ego: &'a EgoPath,
    /// Encounter of the two, computed once for all rewards.
    pub encounter: Encounter,
    /// Map, other road users, sizes, convention.
    pub ctx: &'a Context,
}

impl<'a> Situation<'a> {
    /// A candidate against an ego path.
    pub fn new(candidate: &'a Candidate, ego: &'a EgoPath, ctx: &'a Context) -> Self {
        let mut encounter = Encounter::of(candidate, ego);
        if ctx.is_in_contact_now() {
            // A contact that the adversary did not bring about is not measured.
            encounter.contact = None;
        }
        Self { candidate, ego, encounter, ctx }
    }
}

/// Scores a trajectory of the adversary. A larger value means more of the named quantity, also for
/// penalties; the sign is part of the objective.
///
/// Implementations are pure: the same situation gives the same bits.
///
/// A reward of your own, the metres that the adversary drives, and its value for `candidate`, which keeps its 8 m/s:
///
/// ```
/// use sage_core::{
///     motion::DT,
///     objective::{Reward, Situation},
/// };
/// # use std::sync::Arc;
/// # use sage_core::{motion::Trajectory, objective::{Context, ContextOptions}, scene::SceneIndex};
///
/// struct Distance;
///
/// impl Reward for Distance {
///     fn score(&self, situation: &Situation) -> Option<f64> {
///         Some(situation.candidate.profile().speed.iter().sum::<f64>() * DT)
///     }
/// }
///
/// # let scene = Arc::new(include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/road.rs")));
/// # let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// # let plan = (1..=80).map(|step| [20.0 + 0.8 * f64::from(step), 4.0]).collect();
/// # let candidate = ctx.candidate(Trajectory::new("plan", plan)?);
/// let metres = Distance.score(&Situation::new(&candidate, ctx.ego(), &ctx));
/// // 8 s at 8 m/s.
/// assert!(metres.is_some_and(|metres| (metres - 64.0).abs() < 1e-9));
/// # Ok::<(), sage_core::Error>(())
/// ```
pub trait Reward: Send + Sync {
    /// Value for one candidate and ego path, in the unit that the implementation states, finite; `None`
    /// where it cannot be measured.
    fn score(&self, situation: &Situation) -> Option<f64>;

    /// Whether the value depends on the ego's path. If not, it is computed once for any number of ego
    /// paths.
    fn depends_on_ego(&self) -> bool {
        true
    }

    /// Whether it needs [`Candidate::nll`]. A proposer computes that only on request.
    fn needs_prior(&self) -> bool {
        false
    }

    /// Least and greatest value of a reward that is slow to compute. A search over thousands of candidates
    /// computes it only for those that can still be selected. `None` for all other rewards.
    fn slow_range(&self) -> Option<[f64; 2]> {
        None
    }

    /// Hash of the file that it was built from, if there is one: it identifies results as options do.
    fn content(&self) -> Option<String> {
        None
    }

    /// Whether it takes milliseconds. Tables show such a reward only if the selection names it.
    fn is_costly(&self) -> bool {
        false
    }
}
