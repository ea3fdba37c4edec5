//! Where a person is placed in a scene: standing beyond the road edge, beside the ego's recorded way.
//!
//! The recorded way is the same for every driver, so all drivers meet the same person. The first place counts: every 2.5 m along the
//! way, on the right side first, beyond the first road edge to that side, where the ego comes after some seconds and nobody is near at
//! any time. The person stands there from the first frame of the recording on.

use sage_core::{
    Error,
    geometry::{Aabb, Point, SegmentIndex, cross, distance, sub},
    motion::{DT, HORIZON, NOW},
    scene::{Scene, SceneIndex, Track, TrackKind, is_one_level},
};
use serde::{Deserialize, Serialize};

/// Distance of the places that are tried, metres.
const EVERY: f64 = 2.5;
/// Reach for the road edge, metres.
const TO_EDGE: f64 = 25.0;
/// Least distance from the centre line of any lane, metres: who is nearer stands on another road.
const OFF_LANES: f64 = 2.0;
/// Speed and delay of the slow walker that must be able to get in the ego's way in time, m/s and seconds.
const SLOW: f64 = 1.39;
const STARTS: f64 = 1.0;
/// Gap between a parked car and the person behind it, metres, and its length, width and height.
const BEHIND: f64 = 1.0;
const CAR: [f64; 3] = [4.6, 1.8, 1.5];
/// How far a parked car stands from the road edge, metres.
const KERB: f64 = 0.2;

/// Sides of the ego's way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// The right one if it has a place, else the left one.
    #[default]
    Any,
    /// The right one.
    Right,
    /// The left one.
    Left,
}

/// How a person is placed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Placement {
    /// Side of the ego's way.
    pub side: Side,
    /// Distance of the person's box beyond the road edge, metres.
    pub beyond: f64,
    /// Least and greatest distance along the ego's way from where it is *now*, metres.
    pub ahead: [f64; 2],
    /// Least and greatest time after *now* at which the recorded ego gets there, seconds.
    pub after: [f64; 2],
    /// Least distance from every recorded road user and from the recorded ego at all frames, metres.
    pub clearance: f64,
    /// Whether a car is parked at the edge just before the person, so that it is seen late: a second added road user.
    pub parked_car: bool,
}

impl Default for Placement {
    fn default() -> Self {
        Self {
            side: Side::Any,
            beyond: 0.7,
            ahead: [10.0, 90.0],
            after: [2.5, 7.5],
            clearance: 1.5,
            parked_car: false,
        }
    }
}

impl Placement {
    /// Refuses values out of range.
    ///
    /// *Errors*: the field, its value and what is expected.
    pub fn check(&self) -> Result<(), String> {
        let is_range = |[low, high]: [f64; 2]| low >= 0.0 && high > low && high.is_finite();
        for (name, value, most) in [("beyond", self.beyond, 20.0), ("clearance", self.clearance, 20.0)] {
            if !(0.0..=most).contains(&value) {
                return Err(format!("`{name}` is {value}; expected metres, 0 to {most}"));
            }
        }
        for (name, range) in [("ahead", self.ahead), ("after", self.after)] {
            if !is_range(range) {
                let [low, high] = range;
                return Err(format!("`{name}` is [{low}, {high}]; expected two rising numbers, at least 0"));
            }
        }
        Ok(())
    }

    /// The tracks that are added, the person first.
    ///
    /// *Errors*: [`Error::NoPlace`]; the kind is no person's.
    pub fn tracks(&self, scene: &Scene, index: &SceneIndex, kind: &TrackKind) -> Result<Vec<Track>, Error> {
        if !kind.is_person() {
            let problem = format!("a {} cannot be placed; expected PEDESTRIAN or CYCLIST", kind.name());
            return Err(Error::Scene { scene: scene.id.clone(), problem });
        }
        let ego = scene.ego();
        let frames: Vec<usize> =
            (NOW..scene.frames.min(NOW + 1 + HORIZON)).filter(|f| ego.is_valid(*f)).collect();
        let mut station = 0.0;
        let mut next = self.ahead[0];
        let mut refused = [0; REFUSALS.len()];
        for pair in frames.windows(2) {
            let (from, to) = (ego.point(pair[0]), ego.point(pair[1]));
            station += distance(from, to);
            if station < next {
                continue;
            }
            next = station + EVERY;
            let time = (pair[1] - NOW) as f64 * DT;
            if station > self.ahead[1] || time > self.after[1] {
                break;
            }
            if time < self.after[0] {
                continue;
            }
            let sides: &[f64] = match self.side {
                Side::Any => &[-1.0, 1.0],
                Side::Right => &[-1.0],
                Side::Left => &[1.0],
            };
            let at = Beside { point: to, heading: ego.heading[pair[1]], ground: ego.ground(pair[1]), time };
            for side in sides {
                match self.at(scene, index, kind, &at, *side) {
                    Ok(tracks) => return Ok(tracks),
                    Err(why) => refused[why as usize] += 1,
                }
            }
        }
        let tried: usize = refused.iter().sum();
        let why: Vec<String> = REFUSALS
            .iter()
            .zip(refused)
            .filter(|(_, count)| *count > 0)
            .map(|(words, count)| format!("{count} {words}"))
            .collect();
        let why = if why.is_empty() { String::new() } else { format!(": {}", why.join(", ")) };
        Err(Error::NoPlace {
            scene: scene.id.clone(),
            who: kind.name().to_lowercase(),
            why: format!("{tried} places tried beside the ego's recorded way{why}"),
        })
    }

    /// The tracks at one place.
    ///
    /// *Errors*: why it is none.
    fn at(
        &self,
        scene: &Scene,
        index: &SceneIndex,
        kind: &TrackKind,
        at: &Beside,
        side: f64,
    ) -> Result<Vec<Track>, Refused> {
        let (sin, cos) = at.heading.sin_cos();
        let out = [-side * sin, side * cos];
        let edge = to_edge(index, at.point, out, at.ground).ok_or(Refused::NoEdge)?;
        let size = size(kind);
        let aside = edge + self.beyond + 0.5 * size[0];
        // The near side of the ego is enough.
        let reach = aside - 0.5 * scene.ego().size[NOW][1];
        if at.time < STARTS + reach / SLOW {
            return Err(Refused::TooSoon);
        }
        let center = [at.point[0] + aside * out[0], at.point[1] + aside * out[1]];
        // It looks across the road.
        let heading = (-out[1]).atan2(-out[0]);
        let person = standing(scene, kind.clone(), center, heading, at.ground, size);
        let is_off = index.motor_lanes().nearest(center, OFF_LANES, |_| true).is_none();
        if !is_off {
            return Err(Refused::OnLane);
        }
        if !self.is_clear(scene, &person) {
            return Err(Refused::NotClear);
        }
        let mut tracks = vec![person];
        if self.parked_car {
            let back = BEHIND + 0.5 * (CAR[0] + size[1]);
            let aside = edge - KERB - 0.5 * CAR[1];
            let center =
                [at.point[0] + aside * out[0] - back * cos, at.point[1] + aside * out[1] - back * sin];
            let car = standing(scene, TrackKind::Vehicle, center, at.heading, at.ground, CAR);
            let is_on_edge = index.edges().nearest(center, 0.5 * CAR[1], |_| true).is_some();
            if is_on_edge || !self.is_clear(scene, &car) {
                return Err(Refused::NoCar);
            }
            tracks.push(car);
        }
        name(scene, &mut tracks);
        Ok(tracks)
    }

    /// Whether nobody is near at any frame.
    fn is_clear(&self, scene: &Scene, added: &Track) -> bool {
        let own = added.oriented_box(NOW);
        let clearance = self.clearance;
        scene.tracks.iter().all(|track| {
            (0..track.valid.len()).filter(|frame| track.is_valid(*frame)).all(|frame| {
                let area = track.oriented_box(frame);
                let reach = own.radius() + area.radius() + clearance;
                own.center_distance(&area) > reach || own.distance(&area) >= clearance
            })
        })
    }
}

/// Why a place is none.
#[derive(Clone, Copy)]
enum Refused {
    NoEdge,
    TooSoon,
    OnLane,
    NotClear,
    NoCar,
}

/// What is said of each, in their order.
const REFUSALS: [&str; 5] = [
    "without a road edge within 25 m, or with a median before it",
    "that a walker cannot leave in time",
    "near another lane",
    "too near to a road user at some time",
    "without room for the parked car",
];

/// A place on the ego's recorded way.
struct Beside {
    point: Point,
    heading: f64,
    ground: f64,
    /// Seconds after *now*.
    time: f64,
}

/// Distance to the road edge in a direction; `None` if there is none, or a median comes before it.
fn to_edge(index: &SceneIndex, from: Point, out: Point, ground: f64) -> Option<f64> {
    let to = [from[0] + TO_EDGE * out[0], from[1] + TO_EDGE * out[1]];
    let first = |edges: &SegmentIndex| {
        let bounds = Aabb::of([from, to]);
        let runs = edges.near(&bounds).flat_map(|run| &edges.segments()[run]);
        let hits = runs.filter_map(|segment| {
            let level = is_one_level(segment.height(segment.nearest_share(from)), ground);
            let share = crossing([from, to], [segment.a, segment.b]).filter(|_| level)?;
            Some(share * TO_EDGE)
        });
        hits.fold(f64::INFINITY, f64::min)
    };
    let edge = first(index.boundaries());
    (edge.is_finite() && first(index.medians()) > edge).then_some(edge)
}

/// Where a segment is crossed by another one, as a share of the first.
fn crossing([a, b]: [Point; 2], [c, d]: [Point; 2]) -> Option<f64> {
    let (r, s) = (sub(b, a), sub(d, c));
    let area = cross(r, s);
    if area == 0.0 {
        return None;
    }
    let [t, u] = [s, r].map(|way| cross(sub(c, a), way) / area);
    ((0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u)).then_some(t)
}

/// Length, width and height of a placed person, metres.
fn size(kind: &TrackKind) -> [f64; 3] {
    match kind {
        TrackKind::Cyclist => [1.8, 0.6, 1.8],
        _ => [0.6, 0.6, 1.75],
    }
}

/// Somebody who stands at all frames. Numbers are rounded to 32 bits, as recorded files hold them.
fn standing(
    scene: &Scene,
    kind: TrackKind,
    [x, y]: Point,
    heading: f64,
    ground: f64,
    size: [f64; 3],
) -> Track {
    let round = |x: f64| f64::from(x as f32);
    let frames = scene.frames;
    let size = size.map(round);
    Track {
        id: String::new(),
        kind,
        position: vec![[round(x), round(y), round(ground + 0.5 * size[2])]; frames],
        heading: vec![round(heading); frames],
        velocity: vec![[0.0; 2]; frames],
        size: vec![size; frames],
        valid: vec![true; frames],
    }
}

/// Gives added tracks the numbers after the largest of the file: formats with numbers as ids keep them.
fn name(scene: &Scene, tracks: &mut [Track]) {
    let ids = scene.tracks.iter().map(|track| track.id.as_str());
    let largest = ids.filter_map(|id| id.parse::<u32>().ok()).max().unwrap_or(0);
    let is_free = |id: &String| scene.tracks.iter().all(|track| track.id != *id);
    let mut free = (u64::from(largest) + 1..).map(|number| number.to_string()).filter(is_free);
    for track in tracks {
        track.id = free.next().unwrap_or_default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_data::procedural::{Kind, generate};

    #[test]
    fn a_crossing_is_found_within_both_segments_alone() {
        assert_eq!(crossing([[0.0, 0.0], [4.0, 0.0]], [[1.0, -1.0], [1.0, 1.0]]), Some(0.25));
        assert_eq!(crossing([[0.0, 0.0], [4.0, 0.0]], [[5.0, -1.0], [5.0, 1.0]]), None);
        assert_eq!(crossing([[0.0, 0.0], [4.0, 0.0]], [[1.0, 1.0], [1.0, 2.0]]), None);
        assert_eq!(crossing([[0.0, 0.0], [4.0, 0.0]], [[0.0, 1.0], [4.0, 1.0]]), None);
    }

    #[test]
    fn a_placed_person_stands_beyond_the_edge_clear_of_everybody() {
        let placement = Placement::default();
        let mut places = 0;
        for (seed, kind) in (0..20).zip([Kind::Straight, Kind::FourWay, Kind::Merge].into_iter().cycle()) {
            let Some(scene) = generate(kind, seed, 0) else { continue };
            let index = SceneIndex::new(scene.map.clone());
            for kind in [TrackKind::Pedestrian, TrackKind::Cyclist] {
                let Ok(tracks) = placement.tracks(&scene, &index, &kind) else { continue };
                places += 1;
                let person = &tracks[0];
                let own = person.oriented_box(NOW);
                assert!(person.valid.iter().all(|valid| *valid) && person.kind == kind);
                assert!(
                    index.boundaries().nearest(own.center, 0.9, |_| true).is_none(),
                    "{seed}: on the edge"
                );
                for track in &scene.tracks {
                    assert!(track.id != person.id);
                    for frame in (0..scene.frames).filter(|frame| track.is_valid(*frame)) {
                        assert!(track.oriented_box(frame).distance(&own) >= placement.clearance);
                    }
                }
            }
        }
        assert!(places > 5, "{places}");
    }

    #[test]
    fn values_out_of_range_are_refused_by_name() {
        let refused = |text: &str| serde_json::from_str::<Placement>(text).unwrap().check().unwrap_err();
        assert_eq!(refused(r#"{"beyond": -1}"#), "`beyond` is -1; expected metres, 0 to 20");
        assert!(refused(r#"{"ahead": [5, 5]}"#).starts_with("`ahead` is [5, 5]"));
    }
}
