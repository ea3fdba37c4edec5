//! Who was at fault in a contact: nuPlan's rule, on the states when the boxes first meet.
//!
//! The rule is geometry: which box moved, and which edge met which. It is no legal blame, and knows no right of way: a car
//! that cuts in just before a moving ego is hit by the ego's front, and the ego is at fault.

use sage_core::{
    geometry::{OrientedBox, Point, cross, distance, dot, norm, sub},
    scene::{Map, SceneIndex},
};
use serde::{Deserialize, Serialize};

use crate::{
    body::BodyKind,
    drive::DriveContact,
    vehicle::{Motion, Vehicle},
};

/// Speed of an ego that the careful rule looks at, m/s.
const SLOW: f64 = 3.0;
/// Speed that an ego loses within half a second if it brakes, m/s.
const BRAKES: f64 = 0.5;
/// By how much the other is faster, m/s.
const FASTER: f64 = 2.0;
/// Steps of half a second.
const HALF_SECOND: usize = 5;
/// Speed below which a road user stands, m/s.
const STANDING: f64 = 0.05;
/// Angle from the heading beyond which the other is behind, rad.
const BEHIND: f64 = 150.0 * std::f64::consts::PI / 180.0;
/// Half the width of a lane that does not state one, metres.
const HALF_WIDTH: f64 = 1.85;
/// Range of half widths that are believed, metres.
const HALF_WIDTHS: [f64; 2] = [1.5, 2.2];
/// Space that a car in its lane keeps to the lane's borders, metres.
const SPARE: f64 = 0.2;
/// Largest distance of a lane's centre line that is looked at, metres.
const LANE_REACH: f64 = 2.5;

/// The rule that says who is at fault.
///
/// ```
/// use sage_sim::fault::{FaultClass, FaultRule};
///
/// assert_eq!(FaultRule::ALL.map(FaultRule::name), ["nuplan", "careful"]);
/// // Which edge met which decides, not who was right.
/// assert_eq!(FaultClass::ActiveFront.is_at_fault(), Some(true));
/// assert_eq!(FaultClass::ActiveRear.is_at_fault(), Some(false));
/// // A side contact cannot be classified on a map without lanes.
/// assert_eq!(FaultClass::LateralUnknown.is_at_fault(), None);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FaultRule {
    /// nuPlan's.
    #[default]
    Nuplan,
    /// nuPlan's, but an ego below 3 m/s that brakes, in a lane that leads its way, is not at fault if a car meets it that is at
    /// least 2 m/s faster.
    Careful,
}

impl FaultRule {
    /// All rules.
    pub const ALL: [Self; 2] = [Self::Nuplan, Self::Careful];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nuplan => "nuplan",
            Self::Careful => "careful",
        }
    }
}

/// Class of a contact, and with it who is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultClass {
    /// The ego stood: not at fault.
    StoppedEgo,
    /// The other stood, or is an object: at fault.
    StoppedTrack,
    /// The other came from behind: not at fault.
    ActiveRear,
    /// The ego's front met the other: at fault.
    ActiveFront,
    /// The ego's side met the other, the ego wholly in its lane: not at fault.
    LateralInLane,
    /// The ego's side met the other while the ego was not in one lane: at fault.
    LateralOffLane,
    /// The ego's side met the other on a map without lanes: not known.
    LateralUnknown,
    /// The other was not recorded until shortly before: nobody's fault.
    Appeared,
    /// The ego had braked to below 3 m/s in its lane, and a faster car met it: not at fault by [`FaultRule::Careful`].
    SlowedEgo,
}

impl FaultClass {
    /// Whether the ego is at fault; `None` where the map cannot tell.
    pub fn is_at_fault(self) -> Option<bool> {
        match self {
            Self::StoppedEgo | Self::ActiveRear | Self::LateralInLane | Self::Appeared | Self::SlowedEgo => {
                Some(false)
            }
            Self::StoppedTrack | Self::ActiveFront | Self::LateralOffLane => Some(true),
            Self::LateralUnknown => None,
        }
    }

    /// What decides about the fault, in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::StoppedEgo => "the ego stood",
            Self::StoppedTrack => "the other stood",
            Self::ActiveRear => "the ego was hit from behind",
            Self::ActiveFront => "the ego's front edge met the other",
            Self::LateralInLane => "a contact at a side or corner, the ego in its lane",
            Self::LateralOffLane => "a contact at a side or corner, the ego not in one lane",
            Self::LateralUnknown => "a contact at a side or corner, on a map without lanes",
            Self::Appeared => "the other appeared within 0.3 s before",
            Self::SlowedEgo => "the ego had braked in its lane, and a faster car met it",
        }
    }

    /// Number of nuPlan's rule that decides, 1 to 5; 0 if another one does.
    pub fn rule(self) -> u8 {
        match self {
            Self::Appeared | Self::SlowedEgo => 0,
            Self::StoppedEgo => 1,
            Self::StoppedTrack => 2,
            Self::ActiveRear => 3,
            Self::ActiveFront => 4,
            Self::LateralInLane | Self::LateralOffLane | Self::LateralUnknown => 5,
        }
    }
}

/// Class of a contact.
pub fn classify(contact: &DriveContact, car: &Vehicle, index: &SceneIndex) -> FaultClass {
    if contact.appeared {
        return FaultClass::Appeared;
    }
    let [own, other] = &contact.areas;
    let speeds = [contact.car.speed(), contact.other.speed()];
    classify_meeting([own, other], speeds, contact.other.kind, car.rear, index)
}

/// Whether an ego had braked to below 3 m/s in a lane that leads its way, and was met by a faster car. `motions` are those
/// of the drive up to the contact.
pub(crate) fn is_slowed(contact: &DriveContact, motions: &[Motion], index: &SceneIndex) -> bool {
    let (own, other) = (contact.car.speed(), contact.other.speed());
    let earlier = motions[..contact.step.min(motions.len())].iter().rev().nth(HALF_SECOND).map(Motion::speed);
    let brakes = earlier.is_some_and(|earlier| earlier - own >= BRAKES);
    let [x, y] = contact.areas[0].axis;
    let leads = |(_, direction): &(usize, Point)| dot(*direction, [x, y]) > std::f64::consts::FRAC_1_SQRT_2;
    own < SLOW
        && brakes
        && other >= own + FASTER
        && lanes_at(contact.areas[0].center, 0.0, index).iter().any(leads)
}

/// Class of a meeting of two boxes, the own one first, at their speeds (m/s). The rear axle is `rear` metres behind
/// the centre of the own box.
pub(crate) fn classify_meeting(
    [own, other]: [&OrientedBox; 2],
    [own_speed, other_speed]: [f64; 2],
    kind: BodyKind,
    rear: f64,
    index: &SceneIndex,
) -> FaultClass {
    if own_speed <= STANDING {
        return FaultClass::StoppedEgo;
    }
    if other_speed <= STANDING || kind == BodyKind::Object {
        return FaultClass::StoppedTrack;
    }
    if is_behind(own, rear, other.center) {
        return FaultClass::ActiveRear;
    }
    let [front_left, .., front_right] = own.corners();
    if other.intersects_segment(front_left, front_right) {
        return FaultClass::ActiveFront;
    }
    match is_in_one_lane(own, index) {
        None => FaultClass::LateralUnknown,
        Some(true) => FaultClass::LateralInLane,
        Some(false) => FaultClass::LateralOffLane,
    }
}

/// Whether a point is behind a car, whose rear axle is `rear` metres behind the centre of its box.
pub(crate) fn is_behind(own: &OrientedBox, rear: f64, other: Point) -> bool {
    bearing(own, rear, other) < BEHIND.cos()
}

/// Cosine of the angle at the rear axle between the heading and a point.
pub(crate) fn bearing(own: &OrientedBox, rear: f64, other: Point) -> f64 {
    let axle = [own.center[0] - rear * own.axis[0], own.center[1] - rear * own.axis[1]];
    let d = sub(other, axle);
    dot(d, own.axis) / norm(d).max(1e-9)
}

/// Whether all corners of a box lie in one lane, or in lanes that follow each other. `None` without lanes.
pub(crate) fn is_in_one_lane(area: &OrientedBox, index: &SceneIndex) -> Option<bool> {
    let map = index.map();
    if index.motor_lanes().segments().is_empty() {
        return None;
    }
    let lanes = area.corners().map(|corner| lanes_at(corner, SPARE, index));
    let follows = |a: usize, b: usize| {
        let exits = |k: usize| map.features[k].lane.as_ref().map_or(&[][..], |lane| &lane.exits);
        a == b || exits(a).contains(&b) || exits(b).contains(&a)
    };
    // A lane such that every corner lies in it or in one directly before or after it.
    let in_chain = |lane: usize| lanes.iter().all(|at| at.iter().any(|other| follows(lane, other.0)));
    Some(lanes.iter().flatten().any(|lane| in_chain(lane.0)))
}

/// Lanes (map features) that contain a point at least `spare` metres inside their borders, with their directions there.
pub(crate) fn lanes_at(p: Point, spare: f64, index: &SceneIndex) -> Vec<(usize, Point)> {
    let (map, lanes) = (index.map(), index.motor_lanes());
    let bounds = sage_core::geometry::Aabb::around(p, LANE_REACH);
    let mut found: Vec<(usize, Point)> = Vec::new();
    // The widths of a lane are looked for once: a lane may have many segments here.
    let mut widths: Vec<(usize, [f64; 2])> = Vec::new();
    for run in lanes.near(&bounds) {
        for k in run {
            let segment = &lanes.segments()[k];
            let feature = segment.feature as usize;
            let share = segment.nearest_share(p);
            let across = norm(sub(p, segment.at(share)));
            if across > HALF_WIDTHS[1] - spare || found.iter().any(|lane| lane.0 == feature) {
                continue;
            }
            let is_beyond = (share <= 0.0 && !segment.joined[0]) || (share >= 1.0 && !segment.joined[1]);
            let direction = sub(segment.b, segment.a);
            let mut half = || {
                let is_left = cross(direction, sub(p, segment.a)) > 0.0;
                let known = widths.iter().find(|known| known.0 == feature).map(|known| known.1);
                let both = known.unwrap_or_else(|| {
                    let both = half_widths(map, feature, p);
                    widths.push((feature, both));
                    both
                });
                both[usize::from(!is_left)]
            };
            // Within the narrowest lane the width does not matter.
            if !is_beyond && (across <= HALF_WIDTHS[0] - spare || across <= half() - spare) {
                found.push((feature, direction.map(|d| d / norm(direction).max(1e-9))));
            }
        }
    }
    found
}

/// Half the width of a lane at its point nearest to `p`, on the left and on the right, metres.
fn half_widths(map: &Map, feature: usize, p: Point) -> [f64; 2] {
    let lane = &map.features[feature];
    let points = map.points_of(lane).iter().enumerate();
    let nearest =
        points.min_by(|a, b| distance([a.1[0], a.1[1]], p).total_cmp(&distance([b.1[0], b.1[1]], p)));
    let widths = nearest.and_then(|(k, _)| lane.lane.as_ref()?.width.get(k).copied());
    widths.unwrap_or_default().map(|width| match width {
        width if width > 0.0 => width.clamp(HALF_WIDTHS[0], HALF_WIDTHS[1]),
        _ => HALF_WIDTH,
    })
}
