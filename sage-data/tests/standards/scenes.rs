//! Invented scenes for the rare cases of maps and tracks.

use std::sync::Arc;

use sage_core::scene::{
    AdversaryOrigin, Boundary, Lane, LightState, Map, MapFeature, MapKind, Scene, Track, TrackKind,
    TrafficLight,
};

/// Frames of an invented scene.
pub const FRAMES: usize = 91;

/// A straight track along +x at a y, valid in the given frames.
pub fn track(id: &str, kind: &str, y: f64, speed: f64, valid: impl Fn(usize) -> bool) -> Track {
    track_of(FRAMES, id, kind, y, speed, valid)
}

fn track_of(frames: usize, id: &str, kind: &str, y: f64, speed: f64, valid: impl Fn(usize) -> bool) -> Track {
    let masked = |frame: usize, x: f64| if valid(frame) { x } else { 0.0 };
    let along = |frame: usize| 1234.567 + 0.1 * speed * frame as f64;
    Track {
        id: id.to_owned(),
        kind: TrackKind::from_name(kind),
        position: (0..frames)
            .map(|f| [masked(f, along(f)), masked(f, y - 4321.9), masked(f, 10.0 + 0.01 * f as f64)])
            .collect(),
        // A heading of several turns, which the file must wrap.
        heading: (0..frames).map(|f| masked(f, 0.05 * f as f64 - 3.0)).collect(),
        velocity: (0..frames).map(|f| [masked(f, speed), 0.0]).collect(),
        size: (0..frames).map(|f| [4.5, 2.0, 1.5].map(|side| masked(f, side))).collect(),
        valid: (0..frames).map(valid).collect(),
    }
}

/// A scene of an ego and the given tracks on a map.
pub fn scene(id: &str, tracks: Vec<Track>, map: Map) -> Scene {
    let mut all = vec![track("ego", "VEHICLE", 0.0, 8.0, |_| true)];
    all.extend(tracks);
    Scene {
        id: id.to_owned(),
        frames: FRAMES,
        timestamps: Vec::new(),
        tracks: all.into(),
        map: Arc::new(map),
        lights: Vec::new(),
        ego: 0,
        adversary: None,
        adversary_origin: AdversaryOrigin::None,
        notes: Vec::new(),
        held: Vec::new(),
    }
}

/// A lane: id, points in the plane, and exits.
type LaneSpec<'l> = (&'l str, &'l [[f64; 2]], &'l [usize]);

/// A map of lanes.
pub fn lanes(all: &[LaneSpec]) -> Map {
    let mut map = Map::default();
    for (id, points, exits) in all {
        let from = map.points.len();
        // Near the tracks.
        map.points.extend(points.iter().map(|[x, y]| [x + 1234.5, y - 4321.9, 9.0 + 0.02 * x]));
        let lane = Lane { exits: exits.to_vec(), speed_limit: Some(11.176), ..Lane::default() };
        map.features.push(MapFeature {
            id: (*id).to_owned(),
            kind: MapKind::LaneSurfaceStreet,
            points: from..map.points.len(),
            lane: Some(Box::new(lane)),
        });
    }
    map
}

fn light(lane: &str, stop: Option<[f64; 3]>) -> TrafficLight {
    let state =
        |f: usize| [LightState::Stop, LightState::Go, LightState::Unknown, LightState::Caution][f / 25];
    TrafficLight { lane: lane.to_owned(), stop_point: stop, states: (0..FRAMES).map(state).collect() }
}

/// Everything rare that a file must survive.
pub fn odd() -> Vec<Scene> {
    let plain = || lanes(&[("1", &[[0.0, 0.0], [50.0, 0.0]], &[])]);
    let mut all = vec![
        scene("no map", vec![], Map::default()),
        scene("lanes of no and one point", vec![], lanes(&[("1", &[], &[1]), ("2", &[[0.0, 0.0]], &[0, 1])])),
        scene(
            "short and repeated points",
            vec![],
            lanes(&[
                ("short", &[[0.0, 0.0], [0.1, 0.0]], &[1]),
                ("twice", &[[0.1, 0.0], [0.1, 0.0], [5.0, 0.0], [5.0, 0.0]], &[2, 2, 2]),
                ("back", &[[5.0, 0.0], [9.0, 0.0], [5.0, 0.0]], &[3]),
                ("just long enough", &[[5.0, 0.0], [5.0, 0.21]], &[4]),
                ("next", &[[5.0, 0.21], [5.0, 0.5], [5.2, 3.0]], &[]),
            ]),
        ),
        scene("a lane that follows itself", vec![], {
            let ring = |k: i32| [10.0 * (0.1 * f64::from(k)).cos(), 10.0 * (0.1 * f64::from(k)).sin()];
            let mut points: Vec<[f64; 2]> = (0..63).map(ring).collect();
            points.push(points[0]);
            lanes(&[("ring", &points, &[0]), ("spot", &[[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]], &[1])])
        }),
        scene(
            "five ways out of and into each of two lanes",
            vec![],
            lanes(&[
                ("a", &[[0.0, 0.0], [20.0, 0.0]], &[2, 3, 4, 5, 6]),
                ("b", &[[0.0, 0.3], [20.0, 0.3]], &[2, 3, 4, 5, 6]),
                ("1", &[[20.0, 0.1], [30.0, 10.0]], &[7]),
                ("2", &[[20.0, 0.1], [30.0, 5.0]], &[7]),
                ("3", &[[20.0, 0.1], [30.0, 0.0]], &[7]),
                ("4", &[[20.0, 0.1], [20.5, -0.5]], &[7]),
                ("5", &[[20.0, 0.1], [30.0, -9.0], [20.0, 0.1]], &[7]),
                ("far", &[[80.0, 0.0], [90.0, 0.0]], &[]),
            ]),
        ),
        scene(
            "overlaps and gaps",
            vec![],
            lanes(&[
                ("a", &[[0.0, 0.0], [10.0, 0.0]], &[1]),
                ("starts before", &[[9.6, 0.0], [9.8, 0.0], [10.0, 0.0], [10.2, 0.0], [20.0, 0.0]], &[2]),
                ("starts behind", &[[20.4, 0.2], [30.0, 0.0]], &[3]),
                ("ends before it starts", &[[29.6, 0.0], [29.9, 0.0]], &[4, 5]),
                ("fork", &[[29.7, 0.0], [30.0, 0.0]], &[6]),
                ("other", &[[29.5, 0.0], [29.8, 0.0]], &[6]),
                ("end", &[[30.0, 0.0], [60.0, 0.0]], &[0, 99, 6]),
            ]),
        ),
        scene("ids of all sorts", odd_ids(), odd_names()),
        scene("comings and goings", comings(), plain()),
        scene("nothing happens", vec![], plain()),
    ];
    // The ego stands and nobody else is there: no event at all.
    let last = all.len() - 1;
    all[last].tracks[0] = track("ego", "VEHICLE", 0.0, 0.0, |_| true);
    all[last].tracks[0].heading = vec![1.0; FRAMES];
    let mut late = scene("a late ego", comings(), plain());
    late.tracks[0] = track("ego", "VEHICLE", 0.0, 8.0, |f| (7..80).contains(&f));
    all.push(late);
    let mut lights = scene("lights on all sorts of lanes", vec![], {
        let mut map = lanes(&[
            ("1", &[[0.0, 0.0], [50.0, 0.0]], &[1]),
            ("2", &[[50.0, 0.0], [50.05, 0.0]], &[]),
            ("3", &[[0.0, 4.0], [30.0, 4.0], [50.0, 9.0]], &[]),
        ]);
        // Boundaries and widths that make no sense.
        let lane = map.features[2].lane.as_mut().unwrap();
        lane.boundaries =
            [vec![Boundary { feature: 77, own: [9, 3] }], vec![Boundary { feature: 0, own: [0, 9] }]];
        lane.width = vec![[-1.0, 1e9]; 2];
        lane.speed_limit = Some(-1.0);
        map
    });
    let far = Some([1e5, 0.0, 0.0]);
    lights.lights =
        vec![light("3", None), light("2", None), light("none", far), light("3", far), light("1", far)];
    lights.lights[4].states.truncate(5);
    lights.adversary = None;
    all.push(lights);
    let mut long = scene("<199> & \"frames\"", vec![], plain());
    long.frames = 199;
    long.tracks = vec![
        track_of(199, "ego", "VEHICLE", 0.0, 8.0, |_| true),
        track_of(199, "other", "CYCLIST", 4.0, 3.0, |f| f > 100),
    ]
    .into();
    long.adversary = Some(1);
    all.push(long);
    all
}

fn odd_ids() -> Vec<Track> {
    let ids = [
        "",
        "a b",
        "a_b",
        "a:b",
        "a_b_2",
        "$x",
        "ego",
        "<&\">\u{1}\n\u{ffff}'",
        "ü/😀",
        "${1+1}",
        "Adversary",
    ];
    let kinds = [
        "VEHICLE",
        "VEHICLE",
        "VEHICLE",
        "VEHICLE",
        "VEHICLE",
        "PEDESTRIAN",
        "CYCLIST",
        "TRAFFIC_CONE",
        "",
        "é",
    ];
    let at = |k: usize| kinds[k % kinds.len()];
    let tracks = ids.iter().enumerate();
    tracks.map(|(k, id)| track(id, at(k), 4.0 * (k + 1) as f64, k as f64, |_| true)).collect()
}

fn odd_names() -> Map {
    let right: &[[f64; 2]] = &[[0.0, 0.0], [50.0, 0.0]];
    lanes(&[
        ("<lane> & \"co\"", right, &[1]),
        ("$lane\u{2}\t\n", &[[50.0, 0.0], [60.0, 0.0], [70.0, 1.0]], &[2, 3]),
        ("", &[[70.0, 1.0], [90.0, 1.0]], &[]),
        ("d9a1-ü😀", &[[70.0, 1.0], [80.0, 20.0]], &[]),
    ])
}

/// Tracks that appear and leave in every way, and whose size changes.
fn comings() -> Vec<Track> {
    let mut all = vec![
        track("always", "VEHICLE", 4.0, 5.0, |_| true),
        track("from the start", "VEHICLE", 8.0, 5.0, |f| f < 30),
        track("to the end", "PEDESTRIAN", 12.0, 1.5, |f| f > 60),
        track("gaps", "VEHICLE", 16.0, 5.0, |f| !(20..30).contains(&f) && !(50..61).contains(&f)),
        track("first frame", "VEHICLE", 20.0, 5.0, |f| f == 0),
        track("last frame", "VEHICLE", 24.0, 5.0, |f| f == FRAMES - 1),
        track("one frame", "CYCLIST", 28.0, 5.0, |f| f == 40),
        track("never", "VEHICLE", 32.0, 5.0, |_| false),
        track("barrier", "TRAFFIC_BARRIER", 36.0, 0.0, |_| true),
        track("flickers", "VEHICLE", 40.0, 3.0, |f| f % 12 == 0),
    ];
    for (f, size) in all[0].size.iter_mut().enumerate() {
        *size = [9.0 + 0.01 * f as f64, 2.5, 3.0];
    }
    all
}
