//! What explains a failure: how its plan differs from the recording, how much less is no failure, who else is needed, and when
//! braking would have been enough.
//!
//! All of it is found by driving again: with shares of the difference ([`Shrunk`]), and without other road users ([`Needed`]).
//! [`Explanation::sentence`] says it in words, from the fields alone. It claims no cause: another plan, or another driver's
//! reaction, may lead to a failure too.

mod braking;
mod deviation;
mod needed;
mod sentence;
mod shrunk;

use sage_core::{
    geometry::{OrientedBox, cross, distance, dot, sub, wrap_angle},
    motion::NOW,
    objective::{CollisionType, Context, Feasibility, PersonMet},
};
use serde::{Deserialize, Serialize};

pub use braking::Braking;
pub use deviation::Deviation;
use deviation::{SPEED, last_speed, range_of_speeds, recorded};
pub use needed::{Needed, NeededRoadUser};
pub use shrunk::Shrunk;

use needed::Driven;

use super::{
    AttackedPath, Evaluated, Failure, Features, PoolPlan, SearchOptions, circumstances::Origin,
    evaluation::Evaluator, manoeuvre::Manoeuvre,
};
use crate::{Error, attack_test::AttackTest};

/// Which failures of a scene are explained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Explained {
    /// None.
    #[default]
    None,
    /// The mildest one.
    Mildest,
    /// All.
    All,
}

/// Distance along from which a car beside is ahead or behind, metres.
const FAR: f64 = 2.5;
/// Lateral distance from which a car is on the left or right of the ego, metres.
const BESIDE: f64 = 2.0;

/// Where the adversary is *now*, seen from the ego, or where it comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Approach {
    /// In the opposite direction.
    Oncoming,
    /// In the ego's direction, ahead.
    Ahead,
    /// The same, ahead on the left.
    AheadLeft,
    /// The same, ahead on the right.
    AheadRight,
    /// Behind.
    Behind,
    /// Behind on the left.
    BehindLeft,
    /// Behind on the right.
    BehindRight,
    /// Beside, on the left.
    Left,
    /// Beside, on the right.
    Right,
    /// At an angle, from the left.
    FromLeft,
    /// At an angle, from the right.
    FromRight,
    /// From a place where no lane leads its way.
    OffLanes,
}

impl Approach {
    /// The adversary in words; `noun` is what it is, such as a car.
    fn words(self, noun: &str) -> String {
        let place = match self {
            Self::Oncoming => return format!("the oncoming {noun}"),
            Self::Ahead => "ahead",
            Self::AheadLeft => "ahead on the left",
            Self::AheadRight => "ahead on the right",
            Self::Behind => "behind",
            Self::BehindLeft => "behind on the left",
            Self::BehindRight => "behind on the right",
            Self::Left => "on the left",
            Self::Right => "on the right",
            Self::FromLeft => "from the left",
            Self::FromRight => "from the right",
            Self::OffLanes => "from beside the lanes",
        };
        format!("the {noun} {place}")
    }

    /// By the boxes *now*; `origin` is where the adversary comes from.
    fn of(ego: &OrientedBox, adversary: &OrientedBox, origin: Origin) -> Self {
        let way = sub(adversary.center, ego.center);
        let (ahead, left) = (dot(ego.axis, way), cross(ego.axis, way));
        match origin {
            Origin::OffLanes => Self::OffLanes,
            Origin::OppositeDirection => Self::Oncoming,
            // Who heads to the right comes from the left.
            Origin::SideRoad if cross(ego.axis, adversary.axis) < 0.0 => Self::FromLeft,
            Origin::SideRoad => Self::FromRight,
            Origin::SameDirection => match (ahead, left.abs() > BESIDE, left > 0.0) {
                (_, false, _) if ahead > 0.0 => Self::Ahead,
                (_, false, _) => Self::Behind,
                (x, _, true) if x > FAR => Self::AheadLeft,
                (x, _, false) if x > FAR => Self::AheadRight,
                (x, _, true) if x < -FAR => Self::BehindLeft,
                (x, _, false) if x < -FAR => Self::BehindRight,
                (_, _, true) => Self::Left,
                (_, _, false) => Self::Right,
            },
        }
    }
}

/// What a driver does up to a contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Driving {
    /// Speed in the first 0.3 s, m/s.
    pub speed_now: f64,
    /// Speed in the last 0.3 s before the contact, m/s.
    pub speed: f64,
    /// The lowest and the highest speed, m/s.
    pub speeds: [f64; 2],
    /// Change of its heading, rad, positive to the left.
    pub turned: f64,
    /// What it does by fixed rules; `None` if that cannot be told.
    pub manoeuvre: Option<Manoeuvre>,
}

impl Driving {
    /// What the ego does in an attacked drive up to a contact at a step.
    fn of(path: &AttackedPath, contact: usize, manoeuvre: Option<Manoeuvre>) -> Self {
        let [x, y, heading] = path.history.last().copied().unwrap_or_default();
        // The step of the contact is cut by it.
        let steps = contact.saturating_sub(1).max(1).min(path.positions.len());
        let (points, headings) = (&path.positions[..steps], &path.headings[..steps]);
        let before = std::iter::once(&heading).chain(headings);
        Self {
            speed_now: last_speed([x, y], &points[..steps.min(SPEED)]),
            speed: last_speed([x, y], points),
            speeds: range_of_speeds([x, y], points),
            turned: before.zip(headings).map(|(a, b)| wrap_angle(b - a)).sum(),
            manoeuvre,
        }
    }
}

/// What explains a failure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Explanation {
    /// Where the adversary is *now*; `None` if that cannot be told.
    pub approach: Option<Approach>,
    /// Length of the adversary, metres.
    pub length: f64,
    /// Type of the collision.
    pub collision: Option<CollisionType>,
    /// What the driver does up to the contact.
    pub ego: Driving,
    /// The failure with less of its difference from the recording; `None` if the adversary is not recorded up to the contact.
    pub shrunk: Option<Shrunk>,
    /// The other road users that it takes.
    pub needed: Needed,
    /// The pedestrian or cyclist, if the adversary is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub person: Option<ExplainedPerson>,
    /// Braking of the driver, and what would have been enough.
    pub braking: Braking,
    /// Number of drives that the explanation took, unattacked ones included.
    pub drives: usize,
}

/// A person as the adversary of a failure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExplainedPerson {
    /// `PEDESTRIAN` or `CYCLIST`.
    pub kind: String,
    /// The contact.
    #[serde(flatten)]
    pub met: PersonMet,
}

/// What explains the failures of a search.
pub(super) struct Explainer<'e> {
    pub(super) test: &'e AttackTest<'e>,
    pub(super) ctx: &'e Context,
    pub(super) rule: &'e dyn Feasibility,
    pub(super) evaluator: &'e Evaluator<'e>,
    pub(super) options: &'e SearchOptions,
}

impl Explainer<'_> {
    /// Explains a failure.
    ///
    /// *Errors*: those of the scene; errors of the driver are reasons for which a drive is no failure.
    pub(super) fn explain(
        &self,
        plan: &PoolPlan,
        evaluated: &Evaluated,
        failure: &Failure,
    ) -> Result<Explanation, Error> {
        let mut drives = 0;
        let kind = &self.ctx.adversary().kind;
        let person = evaluated.person.map(|met| ExplainedPerson { kind: kind.name().to_owned(), met });
        // Less of the way is another way: a person who walks half of it stops in the road.
        let shrunk = match person {
            Some(_) => None,
            None => shrunk::shrink(self.evaluator, self.ctx, self.rule, plan, evaluated, &mut drives),
        };
        let trajectory = plan.candidate.trajectory();
        let contact = evaluated.contact.as_ref().and_then(|met| usize::try_from(met.step).ok()).unwrap_or(0);
        let driven = Driven::new(&failure.path, contact);
        let needed = Needed::of(self.test, self.ctx, trajectory, &driven, self.options, &mut drives)?;
        let ego = failure.path.history.last().map(|[x, y, heading]| {
            let [length, width] = self.ctx.ego_size();
            OrientedBox::new([*x, *y], *heading, length, width)
        });
        let origin = failure.circumstances.as_ref().map(|circumstances| circumstances.adversary_from);
        let adversary = Some(self.ctx.adversary()).filter(|track| track.is_valid(NOW));
        let approach = ego.zip(adversary).zip(origin);
        let driven_ctx = failure.path.context(self.ctx)?;
        let met = evaluated.contact.as_ref();
        let features = met.and_then(|met| Features::of(&driven_ctx, &plan.candidate, met, None));
        let recorded = recorded(self.ctx);
        let points = plan.candidate.points();
        let off = |step: usize| match step.checked_sub(1) {
            _ if person.is_some() => None,
            None => Some(0.0),
            Some(k) => Some(distance(*points.get(k)?, *recorded.get(k)?)),
        };
        Ok(Explanation {
            collision: features.map(|features| features.collision),
            ego: Driving::of(&failure.path, contact, features.map(|features| features.ego)),
            length: self.ctx.size()[0],
            approach: approach
                .map(|((ego, track), origin)| Approach::of(&ego, &track.oriented_box(NOW), origin)),
            shrunk,
            needed,
            braking: Braking::of(&failure.path, &failure.avoidable, contact, off),
            person,
            drives,
        })
    }
}
