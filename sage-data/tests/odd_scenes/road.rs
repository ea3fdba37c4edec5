//! The road and the traffic of the odd scenes: two lanes each way along x; the ego at 10 m/s, a faster car beside it, one that
//! comes towards it, a standing one, a person and a bicycle.

use sage_core::seed::Rng;

use super::OddScene;

/// Id of the ego's lane.
pub const EGO_LANE: &str = "11";

/// A feature of the map, in the frame of the road.
pub struct Feature {
    pub id: String,
    pub kind: &'static str,
    pub points: Vec<[f64; 3]>,
    pub is_area: bool,
    pub entries: Vec<String>,
    pub exits: Vec<String>,
}

/// A pose and a velocity, in the frame of the road.
#[derive(Clone, Copy)]
pub struct Pose {
    pub position: [f64; 2],
    pub heading: f64,
    pub velocity: [f64; 2],
}

/// A road user.
pub struct Motion {
    pub name: &'static str,
    pub kind: &'static str,
    pub size: [f64; 3],
    pub height: f64,
    pub poses: Vec<Pose>,
    pub valid: Vec<bool>,
}

fn line(id: &str, kind: &'static str, points: &[[f64; 3]]) -> Feature {
    Feature {
        id: id.to_owned(),
        kind,
        points: points.to_vec(),
        is_area: false,
        entries: Vec::new(),
        exits: Vec::new(),
    }
}

/// Points every 10 m along x at a y and a height.
fn along(from: f64, to: f64, y: f64, z: impl Fn(f64) -> f64) -> Vec<[f64; 3]> {
    let count = ((to - from).abs() / 10.0).ceil().max(1.0);
    let at = |k: usize| from + (to - from) * k as f64 / count;
    (0..=count as usize).map(|k| [at(k), y, z(at(k))]).collect()
}

/// Height of the road.
fn ground(scene: &OddScene) -> impl Fn(f64) -> f64 {
    let (base, slope) = match (scene.value("edges"), scene.value("level")) {
        ("at-0-under-35", _) => (35.0, 0.0),
        (_, "slope") => (0.0, 0.06),
        _ => (0.0, 0.0),
    };
    move |x| base + slope * x
}

/// The map.
pub fn features(scene: &OddScene) -> Vec<Feature> {
    let z = ground(scene);
    let mut all = Vec::new();
    lanes(scene, &z, &mut all);
    all.push(line("line", "ROAD_LINE_SOLID_SINGLE_YELLOW", &along(-150.0, 250.0, 0.0, &z)));
    edges(scene, &z, &mut all);
    let over = match scene.value("level") {
        "over-6m" | "over-now" => Some(6.0),
        "under-6m" => Some(-6.0),
        "over-4m" => Some(4.0),
        _ => None,
    };
    if let Some(height) = over {
        let at = if scene.value("level") == "over-now" { 11.0 } else { 61.75 };
        for (id, x) in [("bridge-1", at), ("bridge-2", at + 3.5)] {
            let points: Vec<[f64; 3]> = (0..=20).map(|k| [x, 10.0 * f64::from(k) - 100.0, height]).collect();
            all.push(line(id, "LANE_SURFACE_STREET", &points));
        }
    }
    if scene.value("level") == "same-speed" {
        all.push(line("deck", "LANE_SURFACE_STREET", &along(-150.0, 250.0, -1.75, |_| 6.0)));
    }
    all
}

fn lanes(scene: &OddScene, z: &dyn Fn(f64) -> f64, all: &mut Vec<Feature>) {
    let kind = "LANE_SURFACE_STREET";
    let value = scene.value("lanes");
    if value == "none" {
        return;
    }
    let short: Option<f64> = value.strip_prefix("short-").and_then(|length| length.parse().ok());
    for (id, y, forward) in
        [(EGO_LANE, -1.75, true), ("12", -5.25, true), ("21", 1.75, false), ("22", 5.25, false)]
    {
        let ends = if forward { [-150.0, 250.0] } else { [250.0, -150.0] };
        if value == "polygons" {
            let [low, high] = [y - 1.75, y + 1.75];
            let mut ring = along(ends[0], ends[1], if forward { low } else { high }, z);
            ring.extend(along(ends[1], ends[0], if forward { high } else { low }, z));
            all.push(Feature { is_area: true, ..line(id, kind, &ring) });
            continue;
        }
        let sign = if forward { 1.0 } else { -1.0 };
        let middle = 50.0;
        let gap = short.unwrap_or(0.0);
        let second = format!("{id}-next");
        let mut first = line(id, kind, &along(ends[0], middle, y, z));
        let mut last = line(&second, kind, &along(middle + sign * gap, ends[1], y, z));
        if let Some(length) = short {
            let between = format!("{id}-short");
            let mut points = along(middle, middle + sign * length, y, z);
            if length == 0.0 {
                points.truncate(1);
            }
            let mut part = line(&between, kind, &points);
            (part.entries, part.exits) = (vec![id.to_owned()], vec![second]);
            (first.exits, last.entries) = (vec![between.clone()], vec![between]);
            all.push(part);
        } else if value == "linked" {
            (first.exits, last.entries) = (vec![second], vec![id.to_owned()]);
        }
        all.extend([first, last]);
    }
}

fn edges(scene: &OddScene, z: &dyn Fn(f64) -> f64, all: &mut Vec<Feature>) {
    let both = |kind: &'static str, z: &dyn Fn(f64) -> f64| {
        // The road lies on the left.
        [
            line("edge-right", kind, &along(-150.0, 250.0, -7.4, z)),
            line("edge-left", kind, &along(250.0, -150.0, 7.4, z)),
        ]
    };
    let area = |id: &str, kind: &'static str, low: f64, high: f64| {
        let ring: Vec<[f64; 3]> =
            along(-150.0, 250.0, low, z).into_iter().chain(along(250.0, -150.0, high, z)).collect();
        Feature { is_area: true, ..line(id, kind, &ring) }
    };
    match scene.value("edges") {
        "none" => {}
        "sidewalk" => {
            let kind = "ROAD_EDGE_SIDEWALK";
            all.extend([area("walk-right", kind, -10.5, -7.5), area("walk-left", kind, 7.5, 10.5)]);
        }
        "guardrail" => all
            .extend([area("rail-right", "GUARDRAIL", -7.9, -7.5), area("rail-left", "GUARDRAIL", 7.5, 7.9)]),
        "median" => {
            all.extend(both("ROAD_EDGE_BOUNDARY", z));
            all.push(line("median", "ROAD_EDGE_MEDIAN", &along(-150.0, 250.0, 0.0, z)));
        }
        "at-0-under-35" => all.extend(both("ROAD_EDGE_BOUNDARY", &|_| 0.0)),
        "4m-above" => all.extend(both("ROAD_EDGE_BOUNDARY", &|x| z(x) + 4.0)),
        "open" => all.push(line("edge-right", "ROAD_EDGE_BOUNDARY", &along(-150.0, 30.0, -7.4, z))),
        _ => all.extend(both("ROAD_EDGE_BOUNDARY", z)),
    }
}

/// The road users, the ego first.
pub fn motions(scene: &OddScene, frames: usize, step: f64, rng: &mut Rng) -> Vec<Motion> {
    let z = ground(scene);
    let car = [4.6, 1.9, 1.6];
    // Straight at a velocity; the motion at 10 Hz and frame 10 is the same for every rate.
    let straight = |name: &'static str, kind, size, from: [f64; 2], velocity: [f64; 2], heading: f64| {
        let at = |k: usize| {
            let t = step * k as f64;
            Pose { position: [from[0] + t * velocity[0], from[1] + t * velocity[1]], heading, velocity }
        };
        Motion {
            name,
            kind,
            size,
            height: z(from[0]) + 0.5 * size[2],
            poses: (0..frames).map(at).collect(),
            valid: vec![true; frames],
        }
    };
    let pi = std::f64::consts::PI;
    let mut ego = straight("ego", "VEHICLE", car, [0.0, -1.75], [10.0, 0.0], 0.0);
    let mut beside = straight("a", "VEHICLE", car, [-20.0, -5.25], [12.0, 0.0], 0.0);
    let mut oncoming = straight("b", "VEHICLE", car, [120.0, 1.75], [-10.0, 0.0], pi);
    let mut standing = straight("q", "VEHICLE", car, [95.0, -5.25], [0.0; 2], 0.0);
    recording(scene, &mut ego, step);
    headings(scene, &mut ego, &mut oncoming, step);
    gaps(scene, step, &mut beside, &mut oncoming, &mut standing);
    still(scene, &mut standing, rng);
    let person = straight("person", "PEDESTRIAN", [0.7, 0.7, 1.75], [60.0, -10.0], [0.0, 1.2], 0.5 * pi);
    let bike = straight("bike", "CYCLIST", [1.75, 0.6, 1.75], [10.0, -6.8], [4.0, 0.0], 0.0);
    let cone = straight("cone", "TRAFFIC_CONE", [0.4, 0.4, 0.8], [80.0, 6.9], [0.0; 2], 0.0);
    let mut all = vec![ego, beside, oncoming, person, bike, cone];
    if scene.value("standing") != "absent" {
        all.push(standing);
    }
    match scene.value("level") {
        "over-6m" | "under-6m" | "over-4m" => {
            let height = [("over-6m", 6.0), ("under-6m", -6.0), ("over-4m", 4.0)];
            let height =
                height.iter().find(|(name, _)| *name == scene.value("level")).map_or(0.0, |(_, h)| *h);
            let over = straight("c", "VEHICLE", car, [61.75, -62.0], [0.0, 10.0], 0.5 * pi);
            all.push(Motion { height: height + 0.8, ..over });
        }
        "over-now" => {
            let over = straight("c", "VEHICLE", car, [11.0, -11.75], [0.0, 10.0], 0.5 * pi);
            all.push(Motion { height: 6.8, ..over });
        }
        "same-speed" => {
            let over = straight("d", "VEHICLE", car, [0.2, -1.75], [10.0, 0.0], 0.0);
            all.push(Motion { height: 6.8, ..over });
        }
        _ => {}
    }
    match scene.value("reversing") {
        "driveway" => all.push(straight("r", "VEHICLE", car, [45.0, -14.0], [0.0, 2.0], -0.5 * pi)),
        "along" => all.push(straight("r", "VEHICLE", car, [40.0, -1.75], [-2.0, 0.0], 0.0)),
        "rolls-back" => all.push(straight("r", "VEHICLE", car, [40.0, -5.25], [-0.7, 0.0], 0.0)),
        "from-rest" => {
            let mut back = straight("r", "VEHICLE", car, [45.0, -12.0], [0.0; 2], -0.5 * pi);
            for (k, pose) in back.poses.iter_mut().enumerate() {
                let t = (step * k as f64 - 1.5).max(0.0);
                pose.position[1] += (2.0 * t).min(7.0);
                pose.velocity = if t > 0.0 && t < 3.5 { [0.0, 2.0] } else { [0.0; 2] };
            }
            all.push(back);
        }
        _ => {}
    }
    let trailer = [8.0, 2.3, 2.5];
    match scene.value("trailer") {
        "touching" => all.push(straight("t", "VEHICLE", trailer, [126.0, 1.75], [-10.0, 0.0], pi)),
        "half-metre" => all.push(straight("t", "VEHICLE", trailer, [126.8, 1.75], [-10.0, 0.0], pi)),
        "of-the-ego" => all.push(straight("t", "VEHICLE", trailer, [-6.0, -1.75], [10.0, 0.0], 0.0)),
        "parked" => all.push(straight("t", "TRAILER", trailer, [88.5, -5.25], [0.0; 2], 0.0)),
        _ => {}
    }
    all
}

/// Where the ego's recording leads.
fn recording(scene: &OddScene, ego: &mut Motion, step: f64) {
    for (k, pose) in ego.poses.iter_mut().enumerate() {
        let t = step * k as f64;
        let turn = (t - 3.0).max(0.0);
        match scene.value("recording") {
            "entrance" => pose.position[1] -= 1.6 * turn,
            "over-the-median" => pose.position[1] += (0.8 * turn).min(3.5),
            "kerb-at-start" => pose.position[1] -= (4.9 - 1.2 * t).max(0.0),
            "across" => pose.position[1] += 2.0 * turn,
            _ => {}
        }
    }
}

fn headings(scene: &OddScene, ego: &mut Motion, oncoming: &mut Motion, step: f64) {
    let pi = std::f64::consts::PI;
    let now = (1.0 / step).round() as usize;
    let flip = |motion: &mut Motion, frames: std::ops::RangeInclusive<usize>| {
        for (k, pose) in motion.poses.iter_mut().enumerate() {
            pose.heading += if frames.contains(&k) { pi } else { 0.0 };
        }
    };
    match scene.value("heading") {
        "flipped-now" => flip(oncoming, now..=now),
        "flipped-1s" => flip(oncoming, now / 2..=now + now / 2),
        "ego-at-0" => flip(ego, 0..=0),
        "ego-now" => flip(ego, now..=now),
        "all-flipped" => flip(oncoming, 0..=usize::MAX - 1),
        _ => {}
    }
}

fn gaps(scene: &OddScene, step: f64, beside: &mut Motion, oncoming: &mut Motion, standing: &mut Motion) {
    let frame = |seconds: f64| (seconds / step).round() as usize;
    let hide = |motion: &mut Motion, hidden: &dyn Fn(usize) -> bool| {
        motion.valid.iter_mut().enumerate().for_each(|(k, valid)| *valid &= !hidden(k));
    };
    match scene.value("gaps") {
        "unseen-3s" => hide(standing, &|k| (frame(3.0)..frame(6.0)).contains(&k)),
        "flickers" => hide(standing, &|k| k % 6 < 3),
        "moving-flickers" => hide(beside, &|k| k > frame(1.0) && k % 6 < 3),
        "appears" => {
            hide(standing, &|k| k < frame(4.0));
            for pose in &mut standing.poses {
                pose.position = [45.0, -1.75];
            }
        }
        "adversary" => hide(oncoming, &|k| k % 7 == 3),
        _ => {}
    }
}

/// What a standing car does.
fn still(scene: &OddScene, standing: &mut Motion, rng: &mut Rng) {
    for (k, pose) in standing.poses.iter_mut().enumerate() {
        match scene.value("standing") {
            "spins" => {
                pose.heading = rng.uniform(-3.1, 3.1);
                pose.position = pose.position.map(|x| x + rng.uniform(-0.08, 0.08));
            }
            "flips" => pose.heading += if k % 3 == 0 { std::f64::consts::PI } else { 0.0 },
            "drifts" => pose.position[0] += 0.002 * k as f64,
            _ => {}
        }
    }
}
