//! The careful and competent driver of UN Regulation 157: everyday car following, and the regulation's reaction to
//! those that come in, brake hard, or appear behind a leader that leaves.
//!
//! It drives along the logged route and never steers around anything. Crossing and oncoming traffic are outside the
//! regulation: they count from the moment at which they overlap the path. For each road user the driver perceives,
//! evaluates and decides, and after a delay brakes with a ramp ([`Reading`] says how); the strongest demand counts.
//! The published implementations differ in when a cut-in is perceived, so results must name the reading.

mod reaction;

use std::collections::BTreeMap;

use sage_core::{
    geometry::{Point, dot, sub},
    motion::DT,
    registry::Entry,
    scene::SceneIndex,
};
use serde::{Deserialize, Deserializer, Serialize, de::Error as _};
use serde_json::{Map, Value};

use super::{
    Driver, EgoPolicy, Start, View,
    idm::{IdmDriver, IdmOptions},
};
use crate::{
    Error,
    body::{Body, BodyKind},
    route::{Localization, Route},
    vehicle::Action,
    world::Control,
};

pub use reaction::Reading;
use reaction::{Reaction, Seen, ramp};

/// Road users farther than this are not looked at, metres.
const REACH: f64 = 100.0;
/// Bodies that overlap by less sideways pass each other, metres.
const TOLERANCE: f64 = 0.1;
/// Most segments of lanes that are looked at in a drive: twenty times what a crowded junction takes.
const MOST_LOOKED: usize = 30_000_000;
/// Largest distance of the lane that a road user follows, metres.
const LANE_REACH: f64 = 3.0;
/// Cosine of the largest angle to the route of those that can come in.
const ALONG: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Emergency braking: time to collision, deceleration (0.85 g), and time in which it rises.
const AEB_TIME: f64 = 1.5;
const AEB_DECELERATION: f64 = 0.85 * 9.81;
const AEB_RAMP: f64 = 0.6;

/// The policy `r157`.
#[derive(Clone, Debug, Default)]
pub struct R157(R157Options);

/// Options of [`R157`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct R157Options {
    /// When those that come in are perceived.
    pub reading: Reading,
    /// Whether an emergency system brakes without delay below 1.5 s to a collision in the path.
    pub aeb: bool,
    /// Whether people who cross are perceived when they have left their place by 0.375 m, as cars that come in; without, when they are
    /// in the path. The regulation's model is of vehicles.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub people: bool,
    /// Car following, and the speed that is driven. The regulation's driver does not look at traffic lights:
    /// `red_lights` is off unless it is given.
    #[serde(deserialize_with = "without_lights")]
    pub following: IdmOptions,
}

impl Default for R157Options {
    fn default() -> Self {
        let following = IdmOptions { lane_changes: None, red_lights: false, ..IdmOptions::default() };
        Self { reading: Reading::default(), aeb: false, people: false, following }
    }
}

/// Options of car following in which `red_lights` is off unless it is given.
fn without_lights<'de, D: Deserializer<'de>>(deserializer: D) -> Result<IdmOptions, D::Error> {
    let mut options = Map::deserialize(deserializer)?;
    options.entry("red_lights").or_insert(Value::Bool(false));
    serde_json::from_value(Value::Object(options)).map_err(D::Error::custom)
}

impl Entry<dyn EgoPolicy> for R157 {
    const NAME: &'static str = "r157";
    const SUMMARY: &'static str =
        "careful and competent driver of UN R157 along the logged route, brakes alone";
    const SOURCE: &'static str = "UN Regulation 157, as in esmini and JRC-FSM";
    type Options = R157Options;

    fn build(options: R157Options) -> Result<Box<dyn EgoPolicy>, String> {
        if options.following.lane_changes.is_some() {
            return Err("`following.lane_changes` must be null: this driver never changes lanes".to_owned());
        }
        options.following.check().map_err(|problem| format!("`following`: {problem}"))?;
        Ok(Box::new(Self(options)))
    }
}

impl EgoPolicy for R157 {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        let R157Options { reading, aeb, people, following } = self.0.clone();
        let following = IdmDriver::new(following);
        let known = BTreeMap::new();
        Ok(Box::new(R157Driver { reading, aeb, people, following, known, leader: None, looked: 0 }))
    }
}

#[derive(Clone)]
struct R157Driver {
    reading: Reading,
    aeb: bool,
    people: bool,
    following: IdmDriver,
    /// Those that were seen, by track.
    known: BTreeMap<usize, Known>,
    /// Track of the nearest road user in the path at the step before.
    leader: Option<usize>,
    /// Segments of lanes that were looked at.
    looked: usize,
}

/// What the driver remembers of a road user.
#[derive(Clone, Copy)]
struct Known {
    reaction: Reaction,
    line: Line,
    /// Speed along the route at the step before, m/s.
    speed: f64,
    /// Since when the emergency system brakes, seconds.
    emergency: Option<f64>,
}

/// The line that a road user follows.
#[derive(Clone, Copy)]
enum Line {
    /// A lane (map feature), or one that follows it.
    Lane(usize),
    /// No lane: its distance from the route when it was first seen, metres.
    Start(f64),
}

impl Driver for R157Driver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let plan = self.following.plan(view);
        let demanded = self.demanded(view, plan.along);
        let acceleration = if demanded > 0.0 { plan.acceleration.min(-demanded) } else { plan.acceleration };
        Ok(Control::Drive(Action { steer: plan.steer, throttle: view.car().throttle_for(acceleration) }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}

impl R157Driver {
    /// The strongest deceleration that a road user demands, m/s², at least 0.
    fn demanded(&mut self, view: &View, along: f64) -> f64 {
        let time = view.step() as f64 * DT;
        let own = Own {
            along,
            speed: view.motion().body_velocity()[0].max(0.0),
            half: [view.area().half_length, view.area().half_width],
        };
        let mut seen: Vec<(usize, Seen)> = Vec::new();
        for body in view.others() {
            if let Some(found) = self.look(view, body, &own) {
                seen.push((body.track, found));
            }
        }
        let nearest = seen.iter().filter(|(_, seen)| seen.is_inside);
        let leader = nearest.min_by(|a, b| a.1.gap.total_cmp(&b.1.gap)).map(|(track, _)| *track);
        // A leader that left the path reveals the one before it.
        let left = |track: usize| seen.iter().any(|(k, seen)| *k == track && !seen.is_inside);
        let is_revealed = self.leader.is_some_and(left);
        self.leader = leader;
        let mut demanded = 0.0f64;
        for (track, seen) in &seen {
            let Some(known) = self.known.get_mut(track) else { continue };
            if is_revealed && leader == Some(*track) {
                known.reaction.reveal(time);
            }
            demanded = demanded.max(known.reaction.deceleration(seen, time, self.reading));
            if self.aeb {
                demanded = demanded.max(known.emergency(seen, time));
            }
        }
        // One that is out of sight begins anew when it comes back.
        self.known.retain(|track, _| seen.iter().any(|(k, _)| k == track));
        demanded
    }

    /// What is seen of a road user; `None` behind, too far away, or across the route and not in the path.
    fn look(&mut self, view: &View, body: &Body, own: &Own) -> Option<Seen> {
        let route = view.route();
        let [x, y] = view.area().center;
        let d = sub(body.area.center, [x, y]);
        if dot(d, d) > REACH * REACH {
            return None;
        }
        let center = route.locate(body.area.center, Localization::Nearest);
        if center.along <= own.along {
            return None;
        }
        let corners = body.area.corners().map(|corner| route.locate(corner, Localization::Nearest));
        let half = own.half[1] - TOLERANCE;
        let is_inside =
            !(corners.iter().all(|c| c.across < -half) || corners.iter().all(|c| c.across > half));
        let heading = route.heading(center.along);
        let axis = [heading.cos(), heading.sin()];
        let speed = dot(body.velocity, axis);
        let is_person = self.people && matches!(body.kind, BodyKind::Pedestrian | BodyKind::Cyclist);
        if !is_inside && !is_person && dot(body.area.axis, axis) < ALONG {
            return None;
        }
        let known = self.known.get(&body.track).copied();
        let first = || {
            if is_person { Line::Start(center.across) } else { Line::of(body, view.index(), center.across) }
        };
        let mut line = known.map_or_else(first, |known| known.line);
        let deviation =
            line.deviation(body.area.center, center.across, route, view.index(), &mut self.looked);
        let seen = Seen {
            deviation,
            is_inside,
            gap: corners.iter().map(|c| c.along).fold(f64::INFINITY, f64::min) - (own.along + own.half[0]),
            closing: own.speed - speed,
            speed: own.speed,
            deceleration: known.map_or(0.0, |known| (known.speed - speed) / DT),
        };
        let reaction = known.map_or_else(|| Reaction::new(&seen), |known| known.reaction);
        let emergency = known.and_then(|known| known.emergency);
        self.known.insert(body.track, Known { reaction, line, speed, emergency });
        Some(seen)
    }
}

/// The own car on its route.
struct Own {
    along: f64,
    speed: f64,
    half: [f64; 2],
}

impl Known {
    /// Deceleration of the emergency system, m/s².
    fn emergency(&mut self, seen: &Seen, time: f64) -> f64 {
        let is_due = seen.is_inside && seen.time_to_collision() < AEB_TIME;
        let goes_on = self.emergency.is_some() && seen.closing > 0.0 && seen.is_inside;
        self.emergency = (is_due || goes_on).then(|| self.emergency.unwrap_or(time));
        self.emergency.map_or(0.0, |since| AEB_DECELERATION * ramp(time - since, AEB_RAMP))
    }
}

impl Line {
    fn of(body: &Body, index: &SceneIndex, across: f64) -> Self {
        let axis = body.area.axis;
        let lanes = index.motor_lanes();
        let is_along = |segment: &sage_core::geometry::Segment| {
            let d = sub(segment.b, segment.a);
            dot(d, axis) > ALONG * dot(d, d).sqrt()
        };
        match lanes.nearest(body.area.center, LANE_REACH, is_along) {
            Some(nearest) => Self::Lane(lanes.segments()[nearest.segment].feature as usize),
            None => Self::Start(across),
        }
    }

    /// How far a road user at a place is off its line towards the route, metres.
    ///
    /// `looked` counts the segments of lanes that were looked at; beyond [`MOST_LOOKED`] everybody is taken to keep to the line.
    fn deviation(
        &mut self,
        place: Point,
        across: f64,
        route: &Route,
        index: &SceneIndex,
        looked: &mut usize,
    ) -> f64 {
        let lane = match *self {
            Self::Start(start) => return start.abs() - across.abs(),
            Self::Lane(lane) => lane,
        };
        let exits = index.map().features[lane].lane.as_ref().map_or(&[][..], |lane| &lane.exits);
        let lanes = index.motor_lanes();
        let follows = |segment: &sage_core::geometry::Segment| {
            let feature = segment.feature as usize;
            feature == lane || exits.contains(&feature)
        };
        let may_look = |count: usize| {
            *looked += count;
            *looked <= MOST_LOOKED
        };
        let Some(nearest) = lanes.nearest_of(place, REACH, follows, may_look) else { return 0.0 };
        let segment = &lanes.segments()[nearest.segment];
        *self = Self::Lane(segment.feature as usize);
        let on_line = route.locate(segment.at(segment.nearest_share(place)), Localization::Nearest);
        on_line.across.abs() - across.abs()
    }
}
