//! Procedural scenes: seeded, unlimited in number, and free of third-party licences.
//!
//! A scene is a road network of one of seven kinds, traffic on it, and an ego and an adversary whose paths
//! conflict. Every scene passes the checks of recorded scenes. The logged futures of ego and adversary are
//! feasible and free of contacts. Some change of the adversary's speed or lane gives a feasible collision.
//! Scenes are drawn by rejection sampling: a network or traffic without these properties is drawn again,
//! from the same seed.

mod curve;
mod divided;
mod layouts;
mod medians;
mod network;
mod roles;
mod traffic;

use std::sync::Arc;

use sage_core::{
    geometry::{Point, distance},
    motion::{DT, HORIZON, NOW, Pose},
    scene::{AdversaryOrigin, LightState, MapKind, Scene, SceneIndex, Track, TrackKind, TrafficLight},
    seed::Rng,
};

use crate::checks::warnings;
use curve::end_pose;
use network::Network;
use traffic::{Traffic, VehicleState, spawn};

pub use roles::attacks;

/// Frames of a scene.
const FRAMES: usize = NOW + 1 + HORIZON;
/// Number of traffic steps before the recording starts.
const WARM_UP: usize = 30;
/// Largest number of draws per scene; one in three succeeds, of divided streets one in fourteen.
const DRAWS: u64 = 400;

/// Kinds of scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A straight street with side streets.
    Straight,
    /// A curved street with side streets.
    Curve,
    /// A motorway with an acceleration lane.
    Merge,
    /// Two crossing streets, with lights or priority.
    FourWay,
    /// A street that ends at another street.
    TJunction,
    /// A roundabout with one lane.
    Roundabout,
    /// A street of two carriageways with a raised median, which has gaps at some junctions.
    Divided,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 7] = [
        Self::Straight,
        Self::Curve,
        Self::Merge,
        Self::FourWay,
        Self::TJunction,
        Self::Roundabout,
        Self::Divided,
    ];

    /// Parses the name of a kind.
    ///
    /// ```
    /// use sage_data::procedural::Kind;
    ///
    /// assert_eq!(Kind::from_name("t-junction"), Some(Kind::TJunction));
    /// assert!(Kind::ALL.into_iter().all(|kind| Kind::from_name(kind.name()) == Some(kind)));
    /// ```
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Name in ids and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Straight => "straight",
            Self::Curve => "curve",
            Self::Merge => "merge",
            Self::FourWay => "four-way",
            Self::TJunction => "t-junction",
            Self::Roundabout => "roundabout",
            Self::Divided => "divided",
        }
    }
}

/// The scene of a kind, seed and number. `None` if no draw succeeds, which has not occurred.
///
/// ```
/// use sage_data::procedural::{Kind, generate};
///
/// let scene = generate(Kind::Roundabout, 7, 0).ok_or("no scene for this seed")?;
/// assert_eq!((scene.id.as_str(), scene.frames), ("roundabout-7-0", 91));
/// // Kind, seed and number decide every bit.
/// assert_eq!(generate(Kind::Roundabout, 7, 0).as_ref(), Some(&scene));
/// // Every scene can be attacked.
/// assert!(scene.check_apart_now().is_ok() && scene.attackable_horizon()? == 80);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn generate(kind: Kind, seed: u64, number: u64) -> Option<Scene> {
    let id = format!("{}-{seed}-{number}", kind.name());
    (0..DRAWS).find_map(|draw| draw_scene(kind, &id, &mut Rng::new(seed, &id, &format!("procedural {draw}"))))
}

fn draw_scene(kind: Kind, id: &str, rng: &mut Rng) -> Option<Scene> {
    let net = network(kind, rng);
    let origin =
        Pose::new(rng.uniform(-2000.0, 2000.0), rng.uniform(-2000.0, 2000.0), rng.uniform(-3.0, 3.0));
    let count = 18 + rng.below(28);
    let cars = spawn(&net, count, rng);
    let mut traffic = Traffic::new(&net, cars, rng.uniform(0.0, 27.0));
    for _ in 0..WARM_UP {
        traffic.step();
    }
    let mut frames: Vec<Vec<VehicleState>> = Vec::with_capacity(FRAMES);
    let mut shown: Vec<[usize; 2]> = Vec::with_capacity(FRAMES);
    for _ in 0..FRAMES {
        frames.push(traffic.states());
        shown.push([traffic.light(0), traffic.light(1)]);
        traffic.step();
    }
    let (map, lanes) = net.map(&origin, 0.0);
    let mut tracks = Vec::new();
    for (k, car) in traffic.cars.iter().enumerate() {
        let states: Vec<VehicleState> = frames.iter().map(|frame| frame[k]).collect();
        if states.iter().any(Option::is_some) {
            tracks.push(track(tracks.len(), TrackKind::Vehicle, car.size, &states, &origin));
        }
    }
    let cars = tracks.len();
    if kind != Kind::Merge {
        bystanders(&net, &mut tracks, &origin, rng);
    }
    let lights = lights(&net, &lanes, &map, &origin, &shown);
    let mut scene = Scene {
        id: id.to_owned(),
        frames: FRAMES,
        timestamps: (0..FRAMES).map(|f| f64::from((f as f64 * DT) as f32)).collect(),
        tracks: tracks.into(),
        map: Arc::new(map),
        lights,
        ego: 0,
        adversary: None,
        adversary_origin: AdversaryOrigin::None,
        notes: Vec::new(),
        held: Vec::new(),
    };
    as_recorded(&mut scene);
    let index = SceneIndex::new(scene.map.clone());
    if roles::any_vehicles_touch(&scene) || medians::any_vehicle_touches(&scene, &index) {
        return None;
    }
    let is_usable = roles::assign(&mut scene, &index, cars, origin.position) && warnings(&scene).is_empty();
    is_usable.then_some(scene)
}

/// Rounds all numbers to the 32-bit floats of recorded files, so that every format stores the same values.
fn as_recorded(scene: &mut Scene) {
    let round = |x: &mut f64| *x = f64::from(*x as f32);
    for track in &mut scene.tracks {
        track.position.iter_mut().flatten().for_each(round);
        track.velocity.iter_mut().flatten().for_each(round);
        track.size.iter_mut().flatten().for_each(round);
        track.heading.iter_mut().for_each(round);
    }
    let map = Arc::make_mut(&mut scene.map);
    map.points.iter_mut().flatten().for_each(round);
    map.features
        .iter_mut()
        .filter_map(|f| f.lane.as_mut())
        .for_each(|lane| lane.width.iter_mut().flatten().for_each(round));
    scene.lights.iter_mut().filter_map(|l| l.stop_point.as_mut()).for_each(|p| p.iter_mut().for_each(round));
}

/// A track from states in the network's own frame.
fn track(id: usize, kind: TrackKind, size: [f64; 3], states: &[VehicleState], origin: &Pose) -> Track {
    let mut track = Track {
        id: id.to_string(),
        kind,
        position: Vec::with_capacity(states.len()),
        heading: Vec::with_capacity(states.len()),
        velocity: Vec::with_capacity(states.len()),
        size: Vec::with_capacity(states.len()),
        valid: Vec::with_capacity(states.len()),
    };
    for state in states {
        let (at, heading, v) = state.unwrap_or(([0.0, 0.0], 0.0, 0.0));
        let heading = sage_core::geometry::wrap_angle(heading + origin.heading);
        let [x, y] = origin.shifted(at[0], at[1]).position;
        let valid = state.is_some();
        let masked = |x: f64| if valid { x } else { 0.0 };
        track.position.push([masked(x), masked(y), masked(0.5 * size[2])]);
        track.heading.push(masked(heading));
        track.velocity.push([masked(v * heading.cos()), masked(v * heading.sin())]);
        track.size.push(size.map(masked));
        track.valid.push(valid);
    }
    track
}

/// Parked cars and pedestrians beside the road.
fn bystanders(net: &Network, tracks: &mut Vec<Track>, origin: &Pose, rng: &mut Rng) {
    let edges: Vec<&Vec<Point>> = net
        .lines
        .iter()
        .filter(|(kind, p)| *kind == MapKind::EdgeBoundary && p.len() > 40)
        .map(|(_, p)| p)
        .collect();
    let Some(most) = edges.len().checked_sub(1) else { return };
    let off_the_road = |p: Point, room: f64| {
        let near = |q: &Point| distance(p, *q) < room;
        !net.lanes.iter().any(|lane| lane.points.iter().step_by(4).any(near))
    };
    let mut positions: Vec<Point> = Vec::new();
    let (cars, people) = (6 + rng.below(12), rng.below(5));
    for k in 0..cars + people {
        let edge = edges[rng.below(most + 1)];
        let at = 10 + rng.below(edge.len() - 20);
        let along = end_pose(&edge[at - 1..=at]);
        let walks = k >= cars;
        let aside = along.shifted(0.0, if walks { -2.2 } else { -rng.uniform(3.5, 12.0) });
        let room = if walks { 4.0 } else { 6.0 };
        if !off_the_road(aside.position, room) || positions.iter().any(|p| distance(*p, aside.position) < 7.0)
        {
            continue;
        }
        positions.push(aside.position);
        let (kind, size, speed, heading) = if walks {
            let back = if rng.below(2) == 0 { 0.0 } else { std::f64::consts::PI };
            (TrackKind::Pedestrian, [0.7, 0.7, 1.75], rng.uniform(0.8, 1.5), aside.heading + back)
        } else {
            let turn = [0.0, std::f64::consts::FRAC_PI_2][rng.below(2)];
            (
                TrackKind::Vehicle,
                [rng.uniform(4.2, 5.0), rng.uniform(1.75, 2.0), 1.5],
                0.0,
                aside.heading + turn,
            )
        };
        let state_at = |f: usize| {
            let moved = Pose { heading, ..aside }.shifted(speed * DT * f as f64, 0.0);
            Some((moved.position, heading, speed))
        };
        let states: Vec<VehicleState> = (0..FRAMES).map(state_at).collect();
        // A pedestrian must not reach the road either.
        let last = states[FRAMES - 1].map_or(aside.position, |(at, ..)| at);
        if off_the_road(last, 3.5) {
            tracks.push(track(tracks.len(), kind, size, &states, origin));
        }
    }
}

/// Lights of the lanes that lead into junctions with lights.
fn lights(
    net: &Network,
    lanes: &[usize],
    map: &sage_core::scene::Map,
    origin: &Pose,
    shown: &[[usize; 2]],
) -> Vec<TrafficLight> {
    let mut out = Vec::new();
    for junction in net.junctions.iter().filter(|j| j.lights) {
        for &k in &junction.crossing {
            let Some((_, arm)) = net.lanes[k].crossing else { continue };
            let first = net.lanes[k].points[0];
            let [x, y] = origin.shifted(first[0], first[1]).position;
            let state = |s: &[usize; 2]| {
                [LightState::Go, LightState::Caution, LightState::Stop][s[junction.phases[arm]]]
            };
            // The light of a divided lane belongs to its first part.
            let begins = !junction.crossing.iter().any(|j| net.lanes[*j].exits.contains(&k));
            if begins {
                out.push(TrafficLight {
                    lane: map.features[lanes[k]].id.clone(),
                    stop_point: Some([x, y, 0.0]),
                    states: shown.iter().map(state).collect(),
                });
            }
        }
    }
    out
}

/// The network of a kind.
fn network(kind: Kind, rng: &mut Rng) -> Network {
    let mut net = Network::default();
    match kind {
        Kind::Straight => layouts::through_road(&mut net, rng, 0.0),
        Kind::Curve => {
            let bend = rng.uniform(1.0 / 140.0, 1.0 / 70.0);
            let bend = if rng.below(2) == 0 { bend } else { -bend };
            layouts::through_road(&mut net, rng, bend);
        }
        Kind::Merge => layouts::merge(&mut net, rng),
        Kind::FourWay => layouts::crossing(&mut net, rng, 4),
        Kind::TJunction => layouts::crossing(&mut net, rng, 3),
        Kind::Roundabout => layouts::roundabout(&mut net, rng),
        Kind::Divided => divided::divided(&mut net, rng),
    }
    net
}
