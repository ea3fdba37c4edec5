//! Where an optimisation starts: the adversary's state *now*, and positions to begin from.

use sage_core::{
    Error,
    geometry::{Point, distance, norm, wrap_angle},
    motion::{DT, HORIZON, NOW, Pose, State, Trajectory},
    objective::Context,
    registry::Entry,
    scene::Track,
};
use sage_generators::proposers::{MixedExperts, Prior};
use serde::{Deserialize, Serialize};

/// Where a search begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartFrom {
    /// The adversary's recorded future.
    #[default]
    Log,
    /// The attack that the selection finds among the prior's candidates.
    Prior,
    /// SAGE's attack at the operating point.
    Sage,
}

impl StartFrom {
    /// Name of the generator whose attack is the start; `None` for the recording.
    pub(crate) fn generator(self) -> Option<&'static str> {
        match self {
            Self::Log => None,
            Self::Prior => Some(Prior::NAME),
            Self::Sage => Some(MixedExperts::NAME),
        }
    }
}

/// The start of a search.
pub(crate) struct Start {
    /// State *now*.
    pub(crate) now: State,
    /// Positions one and two frames before.
    pub(crate) before: [Point; 2],
    /// Poses at the steps 1 to 80.
    pub(crate) poses: Vec<Pose>,
}

impl Start {
    /// The recorded motion; gaps are filled by straight lines, the ends are held.
    ///
    /// *Errors*: [`Error::Scene`] if the adversary is never valid.
    pub(crate) fn of_log(ctx: &Context) -> Result<Self, Error> {
        let frames = filled(ctx)?;
        let pose = |frame: usize| frames[frame.min(frames.len() - 1)];
        let [before, last, now] = [NOW - 2, NOW - 1, NOW].map(pose);
        // Held ends have no speed.
        let track = ctx.adversary();
        let is_known = [NOW - 2, NOW].iter().all(|frame| track.is_valid(*frame));
        let recorded = || track.velocity.get(NOW).map_or(0.0, |v| norm(*v));
        let speed = if is_known || !track.is_valid(NOW) {
            distance(before.position, now.position) / (2.0 * DT)
        } else {
            recorded()
        };
        Ok(Self {
            now: State { position: now.position, heading: now.heading, speed },
            before: [last.position, before.position],
            poses: (NOW + 1..=NOW + HORIZON).map(pose).collect(),
        })
    }

    /// The recorded history with a plan.
    ///
    /// *Errors*: as [`Start::of_log`].
    pub(crate) fn of_plan(ctx: &Context, plan: &Trajectory) -> Result<Self, Error> {
        let start = Self::of_log(ctx)?;
        // The search moves all steps, also those beyond the horizon.
        let candidate = ctx.body().candidate(plan.clone());
        let pose = |area: &sage_core::geometry::OrientedBox| Pose {
            position: area.center,
            heading: area.axis[1].atan2(area.axis[0]),
        };
        Ok(Self { poses: candidate.boxes().iter().map(pose).collect(), ..start })
    }
}

/// Poses of the adversary at all frames.
fn filled(ctx: &Context) -> Result<Vec<Pose>, Error> {
    let track = ctx.adversary();
    let known: Vec<usize> = (0..track.valid.len()).filter(|frame| track.is_valid(*frame)).collect();
    if known.is_empty() {
        let problem = format!("the adversary `{}` is valid in no frame", track.id.escape_debug());
        return Err(Error::Scene { scene: ctx.scene().id.clone(), problem });
    }
    let frames = track.valid.len().max(NOW + HORIZON + 1);
    Ok((0..frames).map(|frame| at(track, &known, frame)).collect())
}

fn at(track: &Track, known: &[usize], frame: usize) -> Pose {
    let pose = |frame: usize| Pose { position: track.point(frame), heading: track.heading[frame] };
    let next = known.partition_point(|k| *k < frame);
    match (next.checked_sub(1).map(|k| known[k]), known.get(next)) {
        (_, Some(&after)) if after == frame => pose(frame),
        (Some(before), Some(&after)) => {
            let (a, b) = (pose(before), pose(after));
            let share = (frame - before) as f64 / (after - before) as f64;
            Pose {
                position: [0, 1].map(|i| a.position[i] + share * (b.position[i] - a.position[i])),
                heading: a.heading + share * wrap_angle(b.heading - a.heading),
            }
        }
        (Some(before), None) => pose(before),
        (None, Some(&after)) => pose(after),
        // `known` is not empty.
        (None, None) => pose(frame),
    }
}
