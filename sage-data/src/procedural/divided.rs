//! The network of `divided`: a street whose carriageways a raised median separates.
//!
//! Three junctions follow each other. At some the median has a gap, and all turns are possible. At the
//! others it is unbroken: cars turn right into the side street and right out of it.

use sage_core::{
    geometry::{Point, distance},
    motion::Pose,
    seed::Rng,
};

use super::{
    curve::{arc, beside, bezier, end_pose, resampled, start_pose},
    layouts::{CORNER, RIGHT, around, crosswalk, opening, road},
    network::{Arm, Network, STRAIGHT, Section, turn},
};

/// Distance of a median's nose from the junction, metres.
const SETBACK: f64 = 1.0;
/// Least diameter of a turn back to the other carriageway, metres.
const TURN_DIAMETER: f64 = 10.0;
/// Lateral acceleration of a turn back, m/s².
const TURN_BACK: f64 = 2.5;
/// Which of the three junctions have a gap. Each scene has junctions of both sorts.
const GAPS: [[bool; 3]; 4] =
    [[false, true, false], [false, true, true], [true, true, false], [true, false, true]];

/// A side street's junction with the main street.
struct Place {
    /// Distance along the main street from the centre of the scene, metres.
    at: f64,
    has_gap: bool,
    lights: bool,
    /// Whether there is a side street on the left and on the right.
    sides: [bool; 2],
}

/// A dual carriageway with three junctions.
pub(super) fn divided(net: &mut Network, rng: &mut Rng) {
    let lanes = 1 + rng.below(3);
    let main = Section {
        along: lanes,
        against: lanes,
        bikes: rng.below(4) == 0,
        median: rng.uniform(1.0, 6.0),
        limit: rng.uniform(13.0, 18.0),
    };
    let side = Section { along: 1, against: 1, bikes: false, median: 0.0, limit: 9.0 };
    let bend = if rng.below(2) == 0 { 0.0 } else { rng.uniform(1.0 / 320.0, 1.0 / 160.0) };
    let bend = if rng.below(2) == 0 { bend } else { -bend };
    let places = places(rng);
    let half = opening(&side);
    let (first, last) =
        (places[0].at - half - rng.uniform(75.0, 100.0), places[2].at + half + rng.uniform(75.0, 100.0));
    let reference = |from: f64, to: f64| arc(&along(bend, from), to - from, bend).0;
    let mut from = first;
    let mut before: Option<(Arm, &Place)> = None;
    for place in places.iter().map(Some).chain([None]) {
        let to = place.map_or(last, |place| place.at - half);
        let [start, end] = net.road(&reference(from, to), &main);
        if let Some((arm, place)) = before.take() {
            join(net, rng, [arm, start], place, &along(bend, place.at), &main, &side);
        }
        let Some(place) = place else { break };
        from = place.at + half;
        before = Some((end, place));
    }
    // Medians end before the gaps, and run to the ends of the map.
    let short_of = half + SETBACK + 0.5 * main.median;
    let mut from: Option<f64> = None;
    for place in places.iter().filter(|place| place.has_gap) {
        let stretch = reference(from.unwrap_or(first), place.at - short_of);
        median(net, &stretch, main.median, [from.is_some(), true]);
        from = Some(place.at + short_of);
    }
    median(net, &reference(from.unwrap_or(first), last), main.median, [from.is_some(), false]);
}

/// Junctions along the main street, in order; the second is near the centre of the scene.
fn places(rng: &mut Rng) -> [Place; 3] {
    let gaps = GAPS[rng.below(GAPS.len())];
    let middle = rng.uniform(-8.0, 8.0);
    let at = [middle - rng.uniform(80.0, 105.0), middle, middle + rng.uniform(80.0, 105.0)];
    let left = rng.below(2) == 0;
    [0, 1, 2].map(|k| {
        let has_gap = gaps[k];
        // Side streets alternate, and a crossing has both.
        let is_crossing = has_gap && k == 1 && rng.below(2) == 0;
        let is_left = left == (k == 1);
        Place {
            at: at[k],
            has_gap,
            lights: has_gap && rng.below(3) == 0,
            sides: [is_crossing || is_left, is_crossing || !is_left],
        }
    })
}

/// Pose on the main street.
fn along(bend: f64, at: f64) -> Pose {
    arc(&Pose::new(0.0, 0.0, 0.0), at, bend).1
}

/// Connects two stretches of the main street and the side streets between them.
fn join(
    net: &mut Network,
    rng: &mut Rng,
    stretches: [Arm; 2],
    place: &Place,
    center: &Pose,
    main: &Section,
    side: &Section,
) {
    let mut arms = Vec::from(stretches);
    for (is_there, (turned, edge)) in
        place.sides.into_iter().zip([(RIGHT, main.left()), (-RIGHT, main.right())])
    {
        if !is_there {
            continue;
        }
        let away = Pose { heading: center.heading + turned, ..*center };
        // Side streets curve away from the centre of the scene and from each other.
        let curvature = rng.uniform(0.002, 0.012) * -place.at.signum() * turned.signum();
        let ([arm, _], _) =
            road(net, &away.shifted(edge + CORNER, 0.0), rng.uniform(45.0, 75.0), curvature, side);
        arms.push(arm);
    }
    let arms = around(center.position, arms);
    let is_main = |arm: &Arm| (arm.out.heading - center.heading).sin().abs() < 0.7;
    let minor: Vec<usize> = (0..arms.len()).filter(|k| !is_main(&arms[*k])).collect();
    let yielding: &[usize] = if place.lights { &[] } else { &minor };
    // An unbroken median leaves right turns, and the main street itself.
    let is_open = |i: usize, j: usize| {
        let is_right = turn(&arms[i], &arms[j]) < -STRAIGHT;
        place.has_gap || is_right || !(minor.contains(&i) || minor.contains(&j))
    };
    let number = net.junction_where(&arms, yielding, place.lights, is_open);
    for (k, arm) in arms.iter().enumerate().filter(|(k, _)| place.has_gap && !minor.contains(k)) {
        turn_back(net, number, k, arm);
    }
    if place.lights {
        arms.iter().for_each(|arm| crosswalk(net, arm));
    }
}

/// Adds the turn back around the median's nose, to the innermost lane that a car can reach.
fn turn_back(net: &mut Network, junction: usize, number: usize, arm: &Arm) {
    let from = end_pose(&net.lanes[arm.entering[0]].points);
    let reached = arm.leaving.iter().copied().find_map(|lane| {
        let to = start_pose(&net.lanes[lane].points);
        let diameter = distance(from.position, to.position);
        (diameter >= TURN_DIAMETER).then_some((lane, to, diameter))
    });
    let Some((lane, to, diameter)) = reached else { return };
    let radius = 0.5 * diameter;
    let half_way = Pose { heading: from.heading + RIGHT, ..from.shifted(radius, radius) };
    let mut points = bezier(&from, &half_way);
    points.extend(bezier(&half_way, &to));
    let (first, last) = net.lane(&resampled(&points), (TURN_BACK * radius).sqrt(), false);
    for part in first..=last {
        net.lanes[part].crossing = Some((junction, number));
        net.junctions[junction].crossing.push(part);
    }
    net.lanes[arm.entering[0]].exits.push(first);
    net.lanes[last].exits.push(lane);
}

/// The outline of a median along a reference line, with the road on its left. It has round noses beyond the
/// start and the end of the line, or is open where the map ends; one of both has a nose.
fn median(net: &mut Network, reference: &[Point], width: f64, noses: [bool; 2]) {
    let half = 0.5 * width;
    let back: Vec<Point> = reference.iter().rev().copied().collect();
    // Each face, in its own direction, and the nose at its end.
    let face = |line: &[Point], has_nose: bool| {
        let nose = arc(&end_pose(line).shifted(0.0, half), std::f64::consts::PI * half, -1.0 / half).0;
        let mut face = beside(line, half);
        face.extend(nose.into_iter().filter(|_| has_nose));
        face
    };
    let (left, right) = (face(reference, noses[1]), face(&back, noses[0]));
    // An open end is where the line begins and ends.
    let outline = if noses[1] { [left, right] } else { [right, left] };
    net.line("ROAD_EDGE_MEDIAN", resampled(&outline.concat()));
}
