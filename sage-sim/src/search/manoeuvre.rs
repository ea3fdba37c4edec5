//! What a car does up to a contact, and on what kind of road, by fixed rules.

use std::f64::consts::{FRAC_PI_4, FRAC_PI_6, PI};

use sage_core::{
    geometry::{Aabb, OrientedBox, Point, Segment, cross, distance, dot, norm, sub, wrap_angle},
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
/// Steps before the contact at which a car that moved over before is settled, and drift that it may have in them, metres.
const SETTLED_STEPS: usize = 15;
const SETTLED: f64 = 0.3;
/// Speed that a car which brakes loses within a second, and one that accelerates gains up to the contact, m/s.
const CHANGE: f64 = 1.5;
/// Steps over which speeds are averaged, and within which a car brakes.
const SPEED_STEPS: usize = 3;
const SECOND: usize = 10;
/// Reach for the lane of a car, metres, and for a lane that it is on beside the one that it followed, where lanes part.
const OWN_LANE: f64 = 3.0;
const ON_LANE: f64 = 1.0;
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
    /// It drifts 1.5 m or more to the left of the direction of its lane, and not only until 1.5 s before.
    MovesLeft,
    /// The same to the right.
    MovesRight,
    /// It loses 1.5 m/s or more within a second.
    Brakes,
    /// It gains 1.5 m/s or more up to the contact.
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
        let Some(first) = boxes.first() else { return Self::Stands };
        let ends = SPEED_STEPS.min(boxes.len() - 1);
        let speed =
            |from: usize| distance(boxes[from].center, boxes[from + ends].center) / (ends.max(1) as f64 * DT);
        let speeds: Vec<f64> = (0..boxes.len() - ends).map(speed).collect();
        let [before, after] = [speeds[0], speeds[speeds.len() - 1]];
        if before < STANDING && after < STANDING {
            return Self::Stands;
        }
        let heading = |area: &OrientedBox| area.axis[1].atan2(area.axis[0]);
        let turned: f64 = boxes.windows(2).map(|w| wrap_angle(heading(&w[1]) - heading(&w[0]))).sum();
        if turned.abs() >= TURN {
            return if turned > 0.0 { Self::TurnsLeft } else { Self::TurnsRight };
        }
        let mut lane = None;
        let across = |w: &[OrientedBox]| {
            let way = sub(w[1].center, w[0].center);
            let direction = followed_direction(&w[0], way, index, &mut lane).unwrap_or(first.axis);
            cross(direction, way)
        };
        let drifts: Vec<f64> = boxes.windows(2).map(across).collect();
        let drift: f64 = drifts.iter().sum();
        let late = &drifts[drifts.len().saturating_sub(SETTLED_STEPS)..];
        let is_settled = late.len() == SETTLED_STEPS && late.iter().sum::<f64>().abs() < SETTLED;
        if drift.abs() >= DRIFT && !is_settled {
            return if drift > 0.0 { Self::MovesLeft } else { Self::MovesRight };
        }
        let loses = |(k, speed): (usize, &f64)| {
            speeds[k..].iter().take(SECOND + 1).any(|later| speed - later >= CHANGE)
        };
        if speeds.iter().enumerate().any(loses) {
            return Self::Brakes;
        }
        if after - before >= CHANGE { Self::Accelerates } else { Self::DrivesOn }
    }
}

/// Direction of the lane that a car follows: the nearest one along its heading.
pub(super) fn lane_direction(area: &OrientedBox, index: &SceneIndex) -> Option<Point> {
    followed_direction(area, area.axis, index, &mut None)
}

/// The same of a car that goes on by `way` and followed a lane (a map feature) before: it stays on it, or on one of its exits, as long as
/// one is near, whatever other lanes merge there. Where lanes part it is on the one that leads its way best.
fn followed_direction(
    area: &OrientedBox,
    way: Point,
    index: &SceneIndex,
    lane: &mut Option<u32>,
) -> Option<Point> {
    let lanes = index.motor_lanes();
    let along = |segment: &Segment| {
        let d = sub(segment.b, segment.a);
        dot(d, area.axis) >= norm(d) * ALONG.cos()
    };
    let before = *lane;
    let exits = before.and_then(|lane| index.map().features[lane as usize].lane.as_ref());
    let goes_on = |segment: &Segment| {
        let is_exit = || exits.is_some_and(|lane| lane.exits.contains(&(segment.feature as usize)));
        along(segment) && (before == Some(segment.feature) || is_exit())
    };
    let same = before.and_then(|_| lanes.nearest(area.center, OWN_LANE, goes_on));
    let nearest = same.or_else(|| lanes.nearest(area.center, OWN_LANE, along))?;
    let is_on =
        |segment: &&Segment| distance(segment.at(segment.nearest_share(area.center)), area.center) <= ON_LANE;
    let reach = Aabb::around(area.center, ON_LANE);
    let others = lanes.near(&reach).flatten().map(|k| &lanes.segments()[k]);
    let others =
        others.filter(|segment| along(segment) && norm(sub(segment.b, segment.a)) > 0.0).filter(is_on);
    let off = |segment: &Segment| cross(direction(segment), way).abs();
    let segment =
        others.fold(
            &lanes.segments()[nearest.segment],
            |best, other| {
                if off(other) < off(best) { other } else { best }
            },
        );
    *lane = Some(segment.feature);
    Some(direction(segment))
}

fn direction(segment: &Segment) -> Point {
    let way = sub(segment.b, segment.a);
    way.map(|x| x / norm(way).max(1e-9))
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
        // Lanes with their directions near the point. A tight lane does not cross itself.
        let mut found: Vec<(u32, f64)> = Vec::new();
        for k in lanes.near(&Aabb::around(p, CROSSING)).flatten() {
            let segment = &lanes.segments()[k];
            let d = sub(segment.b, segment.a);
            if norm(d) > 0.0 && distance(segment.at(segment.nearest_share(p)), p) <= CROSSING {
                found.push((segment.feature, d[1].atan2(d[0])));
            }
        }
        let crosses = |a: &(u32, f64), b: &(u32, f64)| {
            a.0 != b.0 && (ALONG..=PI - ALONG).contains(&wrap_angle(a.1 - b.1).abs())
        };
        let cross = found.iter().enumerate().any(|(k, a)| found[..k].iter().any(|b| crosses(a, b)));
        match (found.is_empty(), cross) {
            (true, _) => Self::OffLanes,
            (false, true) => Self::Junction,
            (false, false) => Self::Road,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use sage_core::scene::{Map, MapFeature, MapKind};

    use super::*;

    /// A map of lanes, given by their points.
    fn map_of(lanes: &[Vec<Point>]) -> Arc<SceneIndex> {
        let mut map = Map::default();
        for (k, lane) in lanes.iter().enumerate() {
            let start = map.points.len();
            map.points.extend(lane.iter().map(|[x, y]| [*x, *y, 0.0]));
            let (kind, points) = (MapKind::LaneSurfaceStreet, start..map.points.len());
            map.features.push(MapFeature { id: k.to_string(), kind, points, lane: None });
        }
        SceneIndex::new(Arc::new(map))
    }

    /// Boxes along a path of 40 steps: speed and yaw rate at each.
    fn boxes(speed: impl Fn(usize) -> f64, yaw_rate: impl Fn(usize) -> f64) -> Vec<OrientedBox> {
        let (mut p, mut heading) = ([0.0, 0.0], 0.0_f64);
        let step = |k: usize| {
            heading += DT * yaw_rate(k);
            p = [p[0] + DT * speed(k) * heading.cos(), p[1] + DT * speed(k) * heading.sin()];
            OrientedBox::new(p, heading, 4.5, 1.9)
        };
        (0..40).map(step).collect()
    }

    #[test]
    fn manoeuvres_are_what_one_sees() {
        let straight = map_of(&[vec![[-50.0, 0.0], [200.0, 0.0]]]);
        let of = |boxes: &[OrientedBox]| Manoeuvre::of(boxes, &straight);
        let steady = |speed: f64| move |_: usize| speed;
        assert_eq!(of(&boxes(steady(0.1), steady(0.0))), Manoeuvre::Stands);
        assert_eq!(of(&boxes(steady(8.0), steady(0.0))), Manoeuvre::DrivesOn);
        assert_eq!(of(&boxes(steady(8.0), steady(0.3))), Manoeuvre::TurnsLeft);
        assert_eq!(of(&boxes(steady(8.0), steady(-0.3))), Manoeuvre::TurnsRight);
        // Into the lane beside, and along it again.
        let swerves = |sign: f64| move |k: usize| if k < 20 { sign * 0.1 } else { -sign * 0.1 };
        assert_eq!(of(&boxes(steady(8.0), swerves(1.0))), Manoeuvre::MovesLeft);
        assert_eq!(of(&boxes(steady(8.0), swerves(-1.0))), Manoeuvre::MovesRight);
        // Late and hard, so that the mean over the attack says little.
        let late = |k: usize| if k < 33 { 9.0 } else { 9.0 - 0.4 * (k - 33) as f64 };
        assert_eq!(of(&boxes(late, steady(0.0))), Manoeuvre::Brakes);
        assert_eq!(of(&boxes(|k| 1.0 + 0.06 * k as f64, steady(0.0))), Manoeuvre::Accelerates);
        assert_eq!(of(&[]), Manoeuvre::Stands);
        assert_eq!(of(&boxes(steady(8.0), steady(0.0))[..1]), Manoeuvre::Stands, "one box has no speed");
    }

    #[test]
    fn a_car_that_follows_a_curve_does_not_move_over() {
        let path = boxes(|_| 8.0, |_| 0.15);
        let curve: Vec<Point> = path.iter().map(|area| area.center).collect();
        assert_eq!(Manoeuvre::of(&path, &map_of(&[curve])), Manoeuvre::DrivesOn);
        // Without a lane the same path is a drift.
        assert_eq!(Manoeuvre::of(&path, &map_of(&[])), Manoeuvre::MovesLeft);
    }

    #[test]
    fn where_lanes_part_a_car_is_on_the_one_that_it_follows() {
        let straight = vec![[-50.0, 0.0], [200.0, 0.0]];
        let right = vec![[-50.0, -0.1], [0.0, -0.1], [100.0, -30.0]];
        let path = boxes(|_| 8.0, |_| 0.0);
        for lanes in [[straight.clone(), right.clone()], [right, straight]] {
            assert_eq!(Manoeuvre::of(&path, &map_of(&lanes)), Manoeuvre::DrivesOn);
        }
    }

    #[test]
    fn a_lane_change_that_ended_long_before_does_not_count() {
        let straight = map_of(&[vec![[-50.0, 0.0], [200.0, 0.0]], vec![[-50.0, 3.2], [200.0, 3.2]]]);
        let change = |k: usize| match k {
            0..10 => 0.2,
            10..20 => -0.2,
            _ => 0.0,
        };
        let path = boxes(|_| 16.0, change);
        assert_eq!(Manoeuvre::of(&path[..25], &straight), Manoeuvre::MovesLeft);
        assert_eq!(Manoeuvre::of(&path, &straight), Manoeuvre::DrivesOn, "2 s later");
    }

    #[test]
    fn lanes_that_cross_are_a_junction_and_lanes_along_each_other_a_road() {
        let east = vec![[-50.0, 0.0], [50.0, 0.0]];
        let west = vec![[50.0, 3.5], [-50.0, 3.5]];
        let north = vec![[1.0, -50.0], [1.0, 50.0]];
        let at_origin = |lanes: &[Vec<Point>]| RoadKind::at([0.0, 0.0], &map_of(lanes));
        assert_eq!(at_origin(&[east.clone(), west.clone()]), RoadKind::Road);
        assert_eq!(at_origin(&[east.clone(), west, north]), RoadKind::Junction);
        assert_eq!(at_origin(&[]), RoadKind::OffLanes);
        // A lane of 6 m radius turns by more than 30° within the reach.
        let tight: Vec<Point> =
            (0..20).map(|k| [6.0 * (0.1 * k as f64).sin(), 6.0 - 6.0 * (0.1 * k as f64).cos()]).collect();
        assert_eq!(at_origin(&[tight]), RoadKind::Road);
        assert_eq!(RoadKind::at([0.0, -6.0], &map_of(&[east])), RoadKind::OffLanes);
    }
}
