//! What a car does up to a contact, and on what kind of road, by fixed rules.

use std::f64::consts::{FRAC_PI_4, FRAC_PI_6, PI};

use sage_core::{
    geometry::{Aabb, OrientedBox, Point, cross, distance, dot, norm, sub, wrap_angle},
    motion::DT,
    scene::SceneIndex,
};
use serde::{Deserialize, Serialize};

/// Speed below which a car stands, m/s.
const STANDING: f64 = 0.5;
/// Change of heading from which a car turns, rad.
const TURN: f64 = FRAC_PI_4;
/// Drift across the lane from which a car moves over, metres.
const DRIFT: f64 = 1.5;
/// Mean acceleration or deceleration from which a car accelerates or brakes, m/s².
const CHANGE: f64 = 1.0;
/// Steps over which speeds at both ends are averaged.
const SPEED_STEPS: usize = 3;
/// Reach for the lane of a car, metres.
const OWN_LANE: f64 = 3.0;
/// Reach for lanes that cross, metres.
const CROSSING: f64 = 5.0;
/// Largest angle between a car and its lane, and least angle of lanes that cross, rad.
const ALONG: f64 = FRAC_PI_6;

/// What a car does up to a contact. The first that holds, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Manoeuvre {
    /// Below 0.5 m/s at both ends.
    Stands,
    /// Its heading changes by 45° or more to the left.
    TurnsLeft,
    /// The same to the right.
    TurnsRight,
    /// It drifts 1.5 m or more to the left of the direction of its lane.
    MovesLeft,
    /// The same to the right.
    MovesRight,
    /// It loses 1 m/s² or more on average.
    Brakes,
    /// It gains 1 m/s² or more on average.
    Accelerates,
    /// None of these.
    DrivesOn,
}

impl Manoeuvre {
    /// Its name.
    pub fn words(self) -> &'static str {
        match self {
            Self::Stands => "stands",
            Self::TurnsLeft => "turns left",
            Self::TurnsRight => "turns right",
            Self::MovesLeft => "moves left",
            Self::MovesRight => "moves right",
            Self::Brakes => "brakes",
            Self::Accelerates => "accelerates",
            Self::DrivesOn => "drives on",
        }
    }

    /// The manoeuvre of boxes at consecutive steps of 0.1 s.
    pub fn of(boxes: &[OrientedBox], index: &SceneIndex) -> Self {
        let (Some(first), Some(last)) = (boxes.first(), boxes.last()) else { return Self::Stands };
        let ends = SPEED_STEPS.min(boxes.len().saturating_sub(1));
        let speed =
            |from: usize| distance(boxes[from].center, boxes[from + ends].center) / (ends.max(1) as f64 * DT);
        let [before, after] = [speed(0), speed(boxes.len() - 1 - ends)];
        if before < STANDING && after < STANDING {
            return Self::Stands;
        }
        let heading = |area: &OrientedBox| area.axis[1].atan2(area.axis[0]);
        let turned: f64 = boxes.windows(2).map(|w| wrap_angle(heading(&w[1]) - heading(&w[0]))).sum();
        if turned.abs() >= TURN {
            return if turned > 0.0 { Self::TurnsLeft } else { Self::TurnsRight };
        }
        let across = |w: &[OrientedBox]| {
            let direction = lane_direction(&w[0], index).unwrap_or(first.axis);
            cross(direction, sub(w[1].center, w[0].center))
        };
        let drift: f64 = boxes.windows(2).map(across).sum();
        if drift.abs() >= DRIFT && distance(first.center, last.center) > 0.0 {
            return if drift > 0.0 { Self::MovesLeft } else { Self::MovesRight };
        }
        let gain = (after - before) / (boxes.len().saturating_sub(1).max(1) as f64 * DT);
        match gain {
            _ if gain <= -CHANGE => Self::Brakes,
            _ if gain >= CHANGE => Self::Accelerates,
            _ => Self::DrivesOn,
        }
    }
}

/// Direction of the lane that a car follows: the nearest one along its heading.
fn lane_direction(area: &OrientedBox, index: &SceneIndex) -> Option<Point> {
    let lanes = index.motor_lanes();
    let direction = |k: usize| {
        let d = sub(lanes.segments()[k].b, lanes.segments()[k].a);
        d.map(|x| x / norm(d).max(1e-9))
    };
    let along = |segment: &sage_core::geometry::Segment| {
        let d = sub(segment.b, segment.a);
        dot(d, area.axis) >= norm(d) * ALONG.cos()
    };
    lanes.nearest(area.center, OWN_LANE, along).map(|nearest| direction(nearest.segment))
}

/// What a contact happens on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RoadKind {
    /// Lanes within 5 m cross at 30° or more.
    Junction,
    /// Lanes along each other, or opposite.
    Road,
    /// No motor lane within 5 m.
    OffLanes,
}

impl RoadKind {
    /// Its name.
    pub fn words(self) -> &'static str {
        match self {
            Self::Junction => "junction",
            Self::Road => "road",
            Self::OffLanes => "off lanes",
        }
    }

    /// The kind of road at a point.
    pub fn at(p: Point, index: &SceneIndex) -> Self {
        let lanes = index.motor_lanes();
        let mut headings: Vec<f64> = Vec::new();
        for k in lanes.near(&Aabb::around(p, CROSSING)).flatten() {
            let segment = &lanes.segments()[k];
            if distance(segment.at(segment.nearest_share(p)), p) <= CROSSING {
                let d = sub(segment.b, segment.a);
                headings.push(d[1].atan2(d[0]));
            }
        }
        let crosses = |a: f64, b: f64| (ALONG..=PI - ALONG).contains(&wrap_angle(a - b).abs());
        match headings.split_first() {
            None => Self::OffLanes,
            // Lanes cross where any two do; that each is along or against the first shows only that none crosses it.
            Some(_)
                if headings
                    .iter()
                    .enumerate()
                    .any(|(k, a)| headings[..k].iter().any(|b| crosses(*a, *b))) =>
            {
                Self::Junction
            }
            Some(_) => Self::Road,
        }
    }
}
