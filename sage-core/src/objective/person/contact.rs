//! A contact with a person, by geometry.
//!
//! A contact is believable if the front of an ego of 2 m/s or more meets somebody who crosses its way: within 10 to 90 % of the ego's width,
//! after at least a second in sight and a second of walking, without a turn in the last second. Who runs into the side of a car, or
//! into a car that stands, was not endangered by its driver.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use serde::{Deserialize, Serialize};

use crate::{
    geometry::{OrientedBox, Point, cross, dot, norm, sub, wrap_angle},
    motion::{DT, HORIZON},
    objective::{
        Candidate, EgoPath, SideHit,
        reason::{ALONG, AT_CORNER, DASH, EGO_STANDS, NOT_BY_FRONT, TURNED},
    },
};

/// Least time of walking, and in sight, before a believable contact, seconds.
pub const LEAST_SEEN: f64 = 1.0;
/// Largest distance of the person from the ego's middle line, as a share of the ego's width.
const WITHIN: f64 = 0.4;
/// Least speed of the ego, m/s: into a slower car people walk by themselves, said two readers of 30 contacts each.
const MOVING: f64 = 2.0;
/// Speed from which a person walks, m/s.
const WALKING: f64 = 0.5;
/// Largest turn in the last second, and largest departure from crossing at right angles, rad.
const TURN: f64 = FRAC_PI_4;
const ASKEW: f64 = FRAC_PI_4;
/// Steps of the last second.
const SECOND: usize = 10;
/// Halvings that find the moment of the contact within a step.
const HALVINGS: usize = 6;
/// What believable conditions are worth to a search, beside the 1 of any contact, and an early contact.
const BELIEVABLE: f64 = 2.0;
const EARLY: f64 = 0.5;
/// Decay of the value of a plan without contact with its least distance, 1/m.
const DECAY: f64 = 0.2;

/// What a contact with a person looks like, apart from sight, which costs more.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PersonContact {
    /// Its step, 1 or later.
    pub step: usize,
    /// Side of the ego that the person meets.
    pub side: SideHit,
    /// Distance of the person's centre to the left of the ego's middle line, as a share of its width.
    pub offset: f64,
    /// Speed of the ego, m/s.
    pub ego_speed: f64,
    /// Seconds for which the person has walked without a break, counted from *now* at most.
    pub walking: f64,
    /// Turn of the person in the last second, rad.
    pub turned: f64,
    /// Departure of its direction from a right angle to the ego's, rad.
    pub askew: f64,
    /// Whether it comes from the left of the ego.
    pub from_left: bool,
    /// Its speed, m/s.
    pub speed: f64,
    /// Its largest speed up to the contact, m/s.
    pub top_speed: f64,
}

impl PersonContact {
    /// The contact of a person with the ego, from the boxes of both at the steps from 1 up to the contact; `None` without a box.
    pub fn of(person: &[OrientedBox], ego: &[OrientedBox]) -> Option<Self> {
        let step = person.len().min(ego.len());
        let (person, ego) = (&person[..step], &ego[..step]);
        let (own, met) = moment(person, ego)?;
        let away = sub(met.center, own.center);
        let velocity = velocity(person, step);
        let speed = |step: usize| norm(self::velocity(person, step));
        let walking = (1..=step).rev().take_while(|step| speed(*step) > WALKING).count();
        let direction = |step: usize| {
            let [x, y] = self::velocity(person, step);
            (norm([x, y]) > WALKING).then(|| y.atan2(x))
        };
        let last = step.saturating_sub(SECOND).max(1)..=step;
        let directions: Vec<f64> = last.filter_map(direction).collect();
        let turn = |angle: &f64| directions.last().map_or(0.0, |end| wrap_angle(end - angle).abs());
        let across = cross(own.axis, velocity).atan2(dot(own.axis, velocity)).abs();
        Some(Self {
            step,
            side: SideHit::of(&own, &met),
            offset: cross(own.axis, away) / (2.0 * own.half_width),
            ego_speed: norm(self::velocity(ego, step)),
            walking: walking as f64 * DT,
            turned: directions.iter().map(turn).fold(0.0, f64::max),
            askew: (across - FRAC_PI_2).abs(),
            from_left: cross(own.axis, velocity) < 0.0,
            speed: norm(velocity),
            top_speed: (1..=step).map(speed).fold(0.0, f64::max),
        })
    }

    /// The contact of a plan with a path of the ego at a step; `None` if the ego has no box up to there.
    pub fn at(plan: &Candidate, ego: &EgoPath, step: usize) -> Option<Self> {
        let boxes: Option<Vec<OrientedBox>> = ego.boxes().get(..step)?.iter().copied().collect();
        Self::of(plan.boxes().get(..step)?, &boxes?)
    }

    /// What it is worth to a search: 1, up to 2 for the conditions of a believable contact but sight, and up to 0.5 for an early one.
    pub fn value(&self) -> f64 {
        let conditions = self.conditions();
        let met = conditions.iter().filter(|(_, holds, ..)| *holds).count();
        let early = 1.0 - self.step as f64 / HORIZON as f64;
        1.0 + BELIEVABLE * met as f64 / conditions.len() as f64 + EARLY * early
    }

    /// Conditions of a believable contact but sight: the reason that it breaks, whether it holds, value and limit.
    pub(super) fn conditions(&self) -> [(&'static str, bool, f64, f64); 6] {
        // Half a step of tolerance: a time is a count of steps.
        let walks = self.walking > LEAST_SEEN - 0.5 * DT;
        let (by_front, offset) = (self.side == SideHit::Front, self.offset.abs());
        [
            (NOT_BY_FRONT, by_front, 0.0, 0.0),
            (AT_CORNER, offset <= WITHIN, offset, WITHIN),
            (EGO_STANDS, self.ego_speed >= MOVING, self.ego_speed, MOVING),
            (DASH, walks, self.walking, LEAST_SEEN),
            (TURNED, self.turned <= TURN, self.turned, TURN),
            (ALONG, self.askew <= ASKEW, self.askew, ASKEW),
        ]
    }
}

/// What a plan of a person is worth to a search, held against a path of the ego: [`PersonContact::value`] of its first contact, else
/// closeness. Both begin at step 1.
pub fn promise(person: &[OrientedBox], ego: &[OrientedBox]) -> Promise {
    let (mut nearest, mut at) = (f64::INFINITY, 0);
    for (k, (own, other)) in ego.iter().zip(person).enumerate() {
        let distance = own.center_distance(other);
        if distance < nearest {
            (nearest, at) = (distance, k);
        }
        let is_near = distance <= own.radius() + other.radius();
        if is_near && own.intersects(other) {
            let contact = PersonContact::of(&person[..=k], &ego[..=k]);
            return Promise { value: contact.map_or(1.0, |contact| contact.value()), step: k };
        }
    }
    Promise { value: (-DECAY * nearest).exp(), step: at }
}

/// What a plan is worth, with the step of its contact or of the least distance, 0 the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Promise {
    /// At most 1 without contact.
    pub value: f64,
    /// The step.
    pub step: usize,
}

/// Velocity at a step of some boxes, 1 the first, m/s; at the first step that of the second.
fn velocity(boxes: &[OrientedBox], step: usize) -> Point {
    let step = step.max(2);
    let pair = boxes.get(step - 2).zip(boxes.get(step - 1));
    pair.map_or([0.0; 2], |(before, now)| sub(now.center, before.center).map(|x| x / DT))
}

/// Boxes of ego and person when they first meet within the last step.
fn moment(person: &[OrientedBox], ego: &[OrientedBox]) -> Option<(OrientedBox, OrientedBox)> {
    let (met, own) = (*person.last()?, *ego.last()?);
    let before = |boxes: &[OrientedBox]| boxes[boxes.len().saturating_sub(2)];
    let (met_before, own_before) = (before(person), before(ego));
    let at = |share: f64| (own_before.between(&own, share), met_before.between(&met, share));
    let [mut apart, mut meets] = [0.0, 1.0];
    for _ in 0..HALVINGS {
        let share = 0.5 * (apart + meets);
        let (own, met) = at(share);
        if own.intersects(&met) { meets = share } else { apart = share }
    }
    Some(at(meets))
}
