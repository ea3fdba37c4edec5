//! Circumstances of a failure: where the adversary comes from, red lights and solid lines on its way, and the right of way.
//!
//! Right of way is what geometry, lights and lanes tell; the first of these rules that applies:
//!
//! | rule | who has it |
//! | --- | --- |
//! | one of the two ran over red | the other |
//! | `rear-end`, `rear-ended` | the car ahead |
//! | `oncoming`, one is on the side of the other direction | the other |
//! | `cut-in`, `sideswipe`, `turning-across`, `oncoming`: one moves over or turns | the other |
//! | `turning-across` from opposite directions, one turns left, one right | the one that turns right |
//! | `crossing`, one comes from off the lanes | the other |
//!
//! Else it is unknown: stop signs and the rules of a country are not in the maps. So it is if the car that moves over comes
//! from a side road with a light that is not red.

use sage_core::{
    geometry::{Aabb, OrientedBox, Point, dot, norm, sub},
    motion::NOW,
    objective::{Candidate, CollisionType, Context},
    scene::{LEVEL_GAP, SceneIndex},
};
use serde::{Deserialize, Serialize};

use super::{
    Met,
    manoeuvre::{Manoeuvre, lane_direction},
};
use crate::{red_lights::crossed_red, route::Route, route_lights::RouteLights};

/// Reach for the lane that a car is on, metres.
const ON_LANE: f64 = 3.0;
/// Cosine of 45°.
const ALONG: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Steps before the contact at which earlier directions are compared.
const BEFORE: usize = 30;

/// Where the adversary comes from, by the directions of both cars *now*.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// No lane leads along its heading within 3 m: a driveway or a parking lot.
    OffLanes,
    /// Within 45° of the ego's direction.
    SameDirection,
    /// Within 45° of the opposite direction.
    OppositeDirection,
    /// At an angle.
    SideRoad,
}

impl Origin {
    /// Its name.
    pub fn words(self) -> &'static str {
        match self {
            Self::OffLanes => "off the lanes",
            Self::SameDirection => "the same direction",
            Self::OppositeDirection => "the opposite direction",
            Self::SideRoad => "a crossing direction",
        }
    }
}

/// One of the two cars.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Party {
    /// The car under test.
    Ego,
    /// The adversary.
    Adversary,
}

impl Party {
    /// Its name.
    pub fn words(self) -> &'static str {
        match self {
            Self::Ego => "ego",
            Self::Adversary => "adversary",
        }
    }
}

/// Circumstances of a failure, up to the contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Circumstances {
    /// Where the adversary comes from.
    pub adversary_from: Origin,
    /// Whether the adversary runs over red; `None` without a light ahead on its way.
    pub adversary_over_red: Option<bool>,
    /// The same of the ego.
    pub ego_over_red: Option<bool>,
    /// Whether the centre of the adversary crosses a solid line; `None` if the map has none.
    pub crosses_solid_line: Option<bool>,
    /// Who has the right of way; `None` if it is unknown.
    pub right_of_way: Option<Party>,
}

impl Circumstances {
    /// Circumstances of an attacked drive. The first path of `ctx` is that of the drive. `None` if the ego has no box at the
    /// contact.
    pub fn of(ctx: &Context, plan: &Candidate, met: &Met) -> Option<Self> {
        let step = usize::try_from(met.step).ok().filter(|step| (1..=plan.boxes().len()).contains(step))?;
        let path: Vec<OrientedBox> = ctx.ego().boxes().iter().map_while(|area| *area).collect();
        let both = Both { ego: path.get(..step)?, adversary: &plan.boxes()[..step], index: ctx.index() };
        let adversary_over_red = over_red(ctx, plan.boxes(), step);
        let ego_over_red = over_red(ctx, &path, step);
        let origin = both.origin();
        let collision = CollisionType::between(both.ego, both.adversary)?;
        let right_of_way = match [ego_over_red == Some(true), adversary_over_red == Some(true)] {
            [false, true] => Some(Party::Ego),
            [true, false] => Some(Party::Adversary),
            [true, true] => None,
            [false, false] => both.right_of_way(collision, origin, adversary_over_red.is_some()),
        };
        Some(Self {
            adversary_from: origin,
            adversary_over_red,
            ego_over_red,
            crosses_solid_line: crosses_solid_line(ctx, plan, step),
            right_of_way,
        })
    }

    /// What the adversary does against lights and lines, in words.
    pub fn violation(&self) -> &'static str {
        match [self.adversary_over_red, self.crosses_solid_line].map(|answer| answer == Some(true)) {
            [true, true] => "runs over red and crosses a solid line",
            [true, false] => "runs over red",
            [false, true] => "crosses a solid line",
            [false, false] => "neither",
        }
    }
}

/// Boxes of both cars at the steps up to the contact.
struct Both<'b> {
    ego: &'b [OrientedBox],
    adversary: &'b [OrientedBox],
    index: &'b SceneIndex,
}

impl Both<'_> {
    fn origin(&self) -> Origin {
        let (ego, adversary) = (&self.ego[0], &self.adversary[0]);
        let cosine = dot(ego.axis, adversary.axis);
        match lane_direction(adversary, self.index) {
            None => Origin::OffLanes,
            Some(_) if cosine > ALONG => Origin::SameDirection,
            Some(_) if cosine < -ALONG => Origin::OppositeDirection,
            Some(_) => Origin::SideRoad,
        }
    }

    /// The right of way if nobody ran over red.
    fn right_of_way(
        &self,
        collision: CollisionType,
        origin: Origin,
        adversary_has_light: bool,
    ) -> Option<Party> {
        let [ego, adversary] = [self.ego, self.adversary].map(|boxes| Manoeuvre::of(boxes, self.index));
        let last = self.ego.len() - 1;
        match collision {
            CollisionType::RearEnd => Some(Party::Adversary),
            CollisionType::RearEnded => Some(Party::Ego),
            CollisionType::Oncoming => {
                let is_on_other_side = |area: &OrientedBox| is_against_lane(area, self.index);
                the_other([is_on_other_side(&self.ego[last]), is_on_other_side(&self.adversary[last])])
                    .or_else(|| the_other([leaves_its_lane(ego), leaves_its_lane(adversary)]))
            }
            CollisionType::CutIn | CollisionType::Sideswipe | CollisionType::TurningAcross => {
                let opposed = {
                    let before = last.saturating_sub(BEFORE);
                    dot(self.ego[before].axis, self.adversary[before].axis) < 0.0
                };
                match (ego, adversary) {
                    (Manoeuvre::TurnsLeft, Manoeuvre::TurnsRight) if opposed => Some(Party::Adversary),
                    (Manoeuvre::TurnsRight, Manoeuvre::TurnsLeft) if opposed => Some(Party::Ego),
                    _ if origin == Origin::SideRoad && adversary_has_light => None,
                    _ => the_other([leaves_its_lane(ego), leaves_its_lane(adversary)]),
                }
            }
            CollisionType::Crossing => {
                let ego_off_lanes = lane_direction(&self.ego[0], self.index).is_none();
                the_other([ego_off_lanes, origin == Origin::OffLanes])
            }
        }
    }
}

/// The car that does not do something that only one of them does: the ego, the adversary.
fn the_other([ego, adversary]: [bool; 2]) -> Option<Party> {
    match (ego, adversary) {
        (true, false) => Some(Party::Adversary),
        (false, true) => Some(Party::Ego),
        _ => None,
    }
}

fn leaves_its_lane(manoeuvre: Manoeuvre) -> bool {
    use Manoeuvre::*;
    matches!(manoeuvre, TurnsLeft | TurnsRight | MovesLeft | MovesRight)
}

/// Whether the nearest lane leads the other way.
fn is_against_lane(area: &OrientedBox, index: &SceneIndex) -> bool {
    let lanes = index.motor_lanes();
    lanes.nearest(area.center, ON_LANE, |_| true).is_some_and(|near| {
        let lane = &lanes.segments()[near.segment];
        let way = sub(lane.b, lane.a);
        dot(way, area.axis) < -ALONG * norm(way)
    })
}

/// Whether a car runs over red up to a step; its path goes on beyond.
fn over_red(ctx: &Context, path: &[OrientedBox], step: usize) -> Option<bool> {
    let scene = ctx.scene();
    if scene.lights.is_empty() {
        return None;
    }
    let points: Vec<Point> = path.iter().map(|area| area.center).collect();
    let route = Route::new(&points);
    let lights = RouteLights::new(scene, &route);
    Some(!crossed_red(scene, &lights, &route, &path[..step], NOW + 1)?.is_empty())
}

/// Whether the centre of a plan crosses a solid line up to a step; `None` if the map has none.
fn crosses_solid_line(ctx: &Context, plan: &Candidate, step: usize) -> Option<bool> {
    let (lines, index) = (ctx.index().solid_lines(), ctx.index());
    if lines.segments().is_empty() {
        return None;
    }
    let mut from = plan.start().position;
    let mut ground = ctx.adversary().ground(NOW);
    Some(plan.points()[..step].iter().any(|to| {
        ground = index.follow_ground(*to, ground, LEVEL_GAP);
        let way = [std::mem::replace(&mut from, *to), *to];
        lines.near(&Aabb::of(way)).flatten().any(|k| {
            let line = &lines.segments()[k];
            let is_level = (line.height(line.nearest_share(*to)) - ground).abs() <= LEVEL_GAP;
            is_level && line.meets(way)
        })
    }))
}
