//! Networks of the kinds of scene but `divided`, which has its own file.

use sage_core::{geometry::Point, motion::Pose, seed::Rng};

use super::{
    curve::{arc, beside, bezier, end_pose, resampled},
    network::{Arm, LANE, Network, Section, circle_clockwise},
};

/// Margin for the rounded corners of a junction, metres.
pub(super) const CORNER: f64 = 7.0;
/// A quarter turn.
pub(super) const RIGHT: f64 = std::f64::consts::FRAC_PI_2;

/// An urban street.
fn street(rng: &mut Rng, lanes: usize, limit: f64) -> Section {
    Section { along: lanes, against: lanes, bikes: rng.below(4) == 0, median: 0.0, limit }
}

/// A road from a pose; returns its ends and its far end pose.
pub(super) fn road(
    net: &mut Network,
    from: &Pose,
    length: f64,
    bend: f64,
    section: &Section,
) -> ([Arm; 2], Pose) {
    let (reference, end) = arc(from, length, bend);
    (net.road(&reference, section), end)
}

/// Half the opening of a junction that a road of this section needs to cross.
pub(super) fn opening(section: &Section) -> f64 {
    section.left().max(section.right()) + CORNER
}

/// Arms in counter-clockwise order around a point.
pub(super) fn around(center: Point, mut arms: Vec<Arm>) -> Vec<Arm> {
    let angle = |arm: &Arm| (arm.out.position[1] - center[1]).atan2(arm.out.position[0] - center[0]);
    arms.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    arms
}

/// Continues a road with a side street and a further stretch; returns the open end of that stretch.
fn side_street(
    net: &mut Network,
    rng: &mut Rng,
    arm: Arm,
    end: &Pose,
    main: &Section,
    left: bool,
    bend: f64,
) -> (Arm, Pose) {
    let side = Section { along: 1, against: 1, bikes: false, median: 0.0, limit: 9.0 };
    let gap = opening(&side);
    let center = end.shifted(gap, 0.0);
    let ([next, open], far) = road(net, &end.shifted(2.0 * gap, 0.0), rng.uniform(60.0, 95.0), bend, main);
    let turn = if left { RIGHT } else { -RIGHT };
    let away = Pose { heading: center.heading + turn, ..center };
    let mouth = if left { main.left() } else { main.right() } + CORNER;
    // Side streets curve outward, away from the centre of the scene and from each other.
    let outward = if left { -rng.uniform(0.005, 0.028) } else { rng.uniform(0.005, 0.028) };
    let ([side_arm, _], _) = road(net, &away.shifted(mouth, 0.0), rng.uniform(35.0, 60.0), outward, &side);
    let arms = around(center.position, vec![arm, next, side_arm]);
    let minor =
        arms.iter().position(|a| a.entering.len() == 1 && (a.out.heading - away.heading).abs() < 1e-9);
    net.junction(&arms, &minor.into_iter().collect::<Vec<_>>(), false);
    (open, far)
}

/// Two side streets farther out on a street, one on each side.
fn side_streets(net: &mut Network, rng: &mut Rng, arm: Arm, end: &Pose, section: &Section) {
    let left = rng.below(2) == 0;
    let (arm, end) = side_street(net, rng, arm, end, section, left, 0.0);
    side_street(net, rng, arm, &end, section, !left, 0.0);
}

/// A road through the scene with side streets on alternating sides.
pub(super) fn through_road(net: &mut Network, rng: &mut Rng, bend: f64) {
    let limit = rng.uniform(13.0, 18.0);
    let main = street(rng, 2, limit);
    let mut left = rng.below(2) == 0;
    let ([_, mut arm], mut end) =
        road(net, &Pose::new(-170.0, 0.0, 0.0), rng.uniform(80.0, 110.0), bend, &main);
    for _ in 0..4 {
        (arm, end) = side_street(net, rng, arm, &end, &main, left, bend);
        left = !left;
    }
}

/// A crossing of three or four streets, each with a side street farther out.
pub(super) fn crossing(net: &mut Network, rng: &mut Rng, arms: usize) {
    let lights = rng.below(2) == 0;
    let sections: Vec<Section> = (0..2)
        .map(|k| {
            let lanes = if k == 0 { 2 } else { 1 + rng.below(2) };
            street(rng, lanes, 13.4)
        })
        .collect();
    let reach = sections.iter().map(opening).fold(0.0, f64::max);
    let mut joined = Vec::new();
    for k in 0..arms {
        let section = sections[k % 2];
        let heading = k as f64 * RIGHT + rng.uniform(-0.1, 0.1);
        let start = Pose::new(0.0, 0.0, heading).shifted(reach, 0.0);
        let ([arm, far_arm], end) =
            road(net, &start, rng.uniform(55.0, 80.0), rng.uniform(-0.009, 0.009), &section);
        joined.push(arm);
        side_streets(net, rng, far_arm, &end, &section);
    }
    let arms = around([0.0, 0.0], joined);
    // Without lights, the second street yields to the first.
    let minor: Vec<usize> = (0..arms.len()).filter(|k| !lights && is_vertical(&arms[*k])).collect();
    net.junction(&arms, &minor, lights);
    for arm in &arms {
        crosswalk(net, arm);
    }
}

fn is_vertical(arm: &Arm) -> bool {
    arm.out.heading.sin().abs() > 0.7
}

/// A crosswalk across an arm, just outside the junction.
pub(super) fn crosswalk(net: &mut Network, arm: &Arm) {
    let corner = |out: f64, side: usize| {
        let left = if side == 0 { arm.reach[0] } else { -arm.reach[1] };
        arm.out.shifted(out, left).position
    };
    let polygon = vec![corner(-0.5, 0), corner(-3.5, 0), corner(-3.5, 1), corner(-0.5, 1)];
    net.areas.push((sage_core::scene::MapKind::Crosswalk, polygon));
}

/// A roundabout with one lane and four streets.
pub(super) fn roundabout(net: &mut Network, rng: &mut Rng) {
    let radius = rng.uniform(15.0, 19.0);
    let section = Section { along: 1, against: 1, bikes: false, median: 0.0, limit: 12.0 };
    let mouth = radius + 16.0;
    let half = 0.62 * RIGHT * 0.55;
    let on_ring =
        |angle: f64| Pose { position: [radius * angle.cos(), radius * angle.sin()], heading: angle + RIGHT };
    let mut arms = Vec::new();
    for k in 0..4 {
        let angle = k as f64 * RIGHT + rng.uniform(-0.06, 0.06);
        let start = Pose::new(0.0, 0.0, angle).shifted(mouth, 0.0);
        let ([arm, far_arm], end) = road(net, &start, rng.uniform(45.0, 70.0), 0.0, &section);
        side_streets(net, rng, far_arm, &end, &section);
        arms.push((angle, arm));
    }
    let ring_arc = |from: f64, to: f64| arc(&on_ring(from), radius * (to - from), 1.0 / radius).0;
    let number = net.junctions.len();
    let ring_speed = 7.0;
    // Along the ring: past an exit, past an entry, to the next exit.
    let mut passing = Vec::new();
    let mut between = Vec::new();
    for k in 0..4 {
        let (angle, next) = (arms[k].0, arms[(k + 1) % 4].0 + if k == 3 { 4.0 * RIGHT } else { 0.0 });
        passing.push(net.lane(&ring_arc(angle - half, angle + half), ring_speed, false));
        between.push(net.lane(&ring_arc(angle + half, next - half), ring_speed, false));
    }
    for k in 0..4 {
        let (angle, arm) = &arms[k];
        let (entering, leaving) = (arm.entering[0], arm.leaving[0]);
        let enter = bezier(&end_pose(&net.lanes[entering].points), &on_ring(angle + half));
        let leave = bezier(&on_ring(angle - half), &super::curve::start_pose(&net.lanes[leaving].points));
        let enter = net.lane(&enter, 6.0, false);
        let leave = net.lane(&leave, 7.0, false);
        net.lanes[entering].exits.push(enter.0);
        net.lanes[enter.1].exits.push(between[k].0);
        net.lanes[passing[k].1].exits.push(between[k].0);
        let before = between[(k + 3) % 4].1;
        net.lanes[before].exits.extend([leave.0, passing[k].0]);
        net.lanes[leave.1].exits.push(leaving);
        // Cars on the ring have priority: each entry is a junction with the ring lane that passes it.
        let junction = super::network::Junction {
            crossing: vec![enter.0, passing[k].0],
            minor: vec![0],
            ..Default::default()
        };
        net.lanes[enter.0].crossing = Some((number + k, 0));
        net.lanes[passing[k].0].crossing = Some((number + k, 1));
        net.junctions.push(junction);
        // The edge from this street to the next: a corner, the outer ring, a corner.
        let (next_angle, next) = &arms[(k + 1) % 4];
        let next_angle = next_angle + if k == 3 { 4.0 * RIGHT } else { 0.0 };
        let outer = radius + 0.5 * LANE + 1.2;
        let on_outer = |a: f64| Pose { position: [outer * a.cos(), outer * a.sin()], heading: a + RIGHT };
        let inward = arm.out.shifted(0.0, arm.reach[0]).turned();
        let outward = next.out.shifted(0.0, -next.reach[1]);
        let mut edge = bezier(&inward, &on_outer(angle + 1.25 * half));
        let (from, to) = (angle + 1.25 * half, next_angle - 1.25 * half);
        edge.extend(arc(&on_outer(from), outer * (to - from), 1.0 / outer).0);
        edge.extend(bezier(&on_outer(to), &outward));
        net.line("ROAD_EDGE_BOUNDARY", resampled(&edge));
    }
    net.line("ROAD_EDGE_BOUNDARY", circle_clockwise([0.0, 0.0], radius - 0.5 * LANE - 1.2));
}

/// A motorway with an acceleration lane, and the other carriageway beyond a median.
pub(super) fn merge(net: &mut Network, rng: &mut Rng) {
    let limit = rng.uniform(22.0, 26.0);
    let (from, nose, taper, end) = (-220.0, -60.0, rng.uniform(40.0, 70.0), 220.0);
    let rejoined = taper + 50.0;
    let lanes = 3;
    let line = |x0: f64, x1: f64, y: f64| arc(&Pose::new(x0, y, 0.0), x1 - x0, 0.0).0;
    let back = |y: f64| arc(&Pose::new(end, y, std::f64::consts::PI), end - from, 0.0).0;
    // Lanes from the median outward, divided where the ramp joins and where the acceleration lane ends.
    let y = |lane: usize| -(lane as f64 + 0.5) * LANE - 1.5;
    net.line("ROAD_EDGE_BOUNDARY", back(-0.6));
    let mut inner_line = net.line("ROAD_LINE_SOLID_SINGLE_YELLOW", back(-1.5));
    let mut sections: Vec<Vec<(usize, usize)>> = Vec::new();
    for lane in 0..lanes {
        let outer_line = if lane + 1 < lanes {
            net.line("ROAD_LINE_BROKEN_SINGLE_WHITE", line(from, end, y(lane) - 0.5 * LANE))
        } else {
            net.line("ROAD_LINE_SOLID_SINGLE_WHITE", line(from, nose, y(lane) - 0.5 * LANE))
        };
        let mut row: Vec<(usize, usize)> = Vec::new();
        for (a, b) in [(from, nose), (nose, taper), (taper, rejoined), (rejoined, end)] {
            let section = net.lane(&line(a, b, y(lane)), limit, false);
            net.bounds(section, [Some(inner_line), Some(outer_line)]);
            if let Some((_, before)) = row.last().copied() {
                net.lanes[before].exits.push(section.0);
            }
            if let Some(left) = sections.last() {
                net.neighbors(left[row.len()], section);
            }
            row.push(section);
        }
        sections.push(row);
        inner_line = outer_line;
    }
    let outermost = &sections[lanes - 1];
    let outer = y(lanes - 1);
    // The ramp joins from the right, runs beside the motorway, and merges.
    let start = Pose::new(from + 20.0, outer - 34.0, 0.22);
    let beside_start = Pose::new(nose, outer - LANE, 0.0);
    let ramp = bezier(&start, &beside_start);
    let ramp_lane = net.lane(&ramp, 17.0, false);
    let accelerate = net.lane(&line(nose, taper, outer - LANE), limit, false);
    let over = bezier(&Pose::new(taper, outer - LANE, 0.0), &Pose::new(rejoined, outer, 0.0));
    let over_lane = net.lane(&over, limit, false);
    net.lanes[ramp_lane.1].exits.push(accelerate.0);
    net.lanes[accelerate.1].exits.push(over_lane.0);
    net.lanes[over_lane.1].exits.push(outermost[3].0);
    let side = 0.5 * LANE + 1.0;
    // Right edge: along the ramp, the acceleration lane, the taper, and the motorway.
    let mut right = beside(&ramp, -side);
    right.extend(line(nose, taper, outer - LANE - side));
    right.extend(beside(&over, -side));
    right.extend(line(rejoined, end, outer - side));
    let right_edge = net.line("ROAD_EDGE_BOUNDARY", resampled(&right));
    let dashes = net.line("ROAD_LINE_BROKEN_SINGLE_WHITE", line(nose, taper, outer - 0.5 * LANE));
    net.neighbors(outermost[1], accelerate);
    net.bounds(accelerate, [Some(dashes), Some(right_edge)]);
    net.outer_bound(outermost[1], dashes);
    // The wedge between ramp and motorway.
    let gap = |p: &&Point| p[1] + 0.5 * LANE + 0.8 < outer - 0.5 * LANE - 0.8;
    let wedge: Vec<Point> = beside(&ramp, 0.5 * LANE + 0.8).into_iter().collect();
    let wedge: Vec<Point> = ramp.iter().zip(wedge).filter(|(p, _)| gap(p)).map(|(_, q)| q).collect();
    if let Some(tip) = wedge.last() {
        let motorway = line(from, tip[0], outer - 0.5 * LANE - 0.8);
        net.line("ROAD_EDGE_BOUNDARY", motorway);
        net.line("ROAD_EDGE_BOUNDARY", wedge.iter().rev().copied().collect());
    }
    // The other carriageway.
    let mut inner_line = net.line("ROAD_EDGE_BOUNDARY", line(from, end, 4.1));
    let mut inner: Option<(usize, usize)> = None;
    let far_edge = net.line("ROAD_EDGE_BOUNDARY", back(5.0 + lanes as f64 * LANE + 1.0));
    for lane in 0..lanes {
        let this = net.lane(&back(5.0 + (lane as f64 + 0.5) * LANE), limit, false);
        let outer_line = if lane + 1 < lanes {
            net.line("ROAD_LINE_BROKEN_SINGLE_WHITE", back(5.0 + (lane as f64 + 1.0) * LANE))
        } else {
            far_edge
        };
        net.bounds(this, [Some(inner_line), Some(outer_line)]);
        if let Some(left) = inner {
            net.neighbors(left, this);
        }
        (inner, inner_line) = (Some(this), outer_line);
    }
}
