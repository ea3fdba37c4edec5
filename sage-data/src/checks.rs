//! Summaries of scenes, and warnings about unusual content.

use std::collections::{BTreeMap, HashMap, HashSet};

use sage_core::{
    motion::{DT, HISTORY, HORIZON, LEAST_HORIZON, NOW},
    scene::Note,
    scene::{AdversaryOrigin, Hitch, MapKind, Scene, SceneIndex, Track, TrackKind, recording_off_road},
};
use serde::Serialize;

pub use crate::warning::Warning;
use crate::{Capabilities, contradictions, headings, repairs::Repair};

/// Height difference above which two roads are on different levels, metres.
const LEVEL: f64 = 3.0;
/// Side of the grid cells in which heights of lanes are compared, metres. Crossing lanes have points in one
/// cell, and no street climbs [`LEVEL`] within a cell.
const CELL: f64 = 4.0;
/// Distance to the ego within which a road user on another level causes a warning, metres.
const NEAR: f64 = 20.0;

/// Longest step of a recording at 10 Hz that is not named, seconds, and deviation of its time after 8 s.
const LONGEST_STEP: f64 = 0.15;
const MOST_DRIFT: f64 = 0.02;

/// Gaps of a track that comes and goes.
const FLICKER: usize = 3;

/// Longest box that is tested against road edges, metres: road trains reach 54 m.
const LONGEST: f64 = 100.0;

/// Content of a scene in numbers.
///
/// ```
/// use std::path::Path;
///
/// use sage_data::{Recording, checks::Summary};
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let summary = Summary::of("crossing", &Recording::read(file)?.scene);
/// // History is frames 0 to *now*, 11 of them; 80 follow.
/// assert_eq!((summary.adversary_history, summary.horizon), (11, 80));
/// assert!(summary.tracks["VEHICLE"] >= 2 && summary.capabilities.edges);
/// # Ok::<(), sage_data::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the file without its extension.
    pub scene: String,
    /// Identifier in the file.
    pub id: String,
    /// Number of frames.
    pub frames: usize,
    /// Number of tracks by kind; vehicles, pedestrians and cyclists are always listed.
    pub tracks: BTreeMap<String, usize>,
    /// Number of map features.
    pub map_features: usize,
    /// Number of points in them.
    pub map_points: usize,
    /// Number of traffic lights.
    pub lights: usize,
    /// Id of the ego.
    pub ego: String,
    /// Id of the adversary.
    pub adversary: Option<String>,
    /// How the adversary was found.
    pub adversary_origin: AdversaryOrigin,
    /// Valid frames of its history, at most 11.
    pub adversary_history: usize,
    /// Valid frames of its future, at most 80.
    pub adversary_future: usize,
    /// Frames after *now* that are recorded, at most 80: those on which attacks are scored.
    pub horizon: usize,
    /// What its map and road users have.
    pub capabilities: Capabilities,
    /// Warnings about the scene.
    pub warnings: Vec<Warning>,
    /// Hash of the content; equal for one scene under several names.
    #[serde(skip)]
    pub content: [u8; 16],
}

impl Summary {
    /// Summary of a scene under a name.
    pub fn of(name: &str, scene: &Scene) -> Self {
        let mut tracks: BTreeMap<String, usize> =
            ["VEHICLE", "PEDESTRIAN", "CYCLIST"].map(|kind| (kind.to_owned(), 0)).into();
        for track in &scene.tracks {
            *tracks.entry(track.kind.name().to_owned()).or_default() += 1;
        }
        let adversary = scene.adversary.map(|k| &scene.tracks[k]);
        let valid = |frames| adversary.map_or(0, |track: &Track| track.count_valid(frames));
        Self {
            scene: name.to_owned(),
            id: scene.id.clone(),
            frames: scene.frames,
            tracks,
            map_features: scene.map.features.len(),
            map_points: scene.map.points.len(),
            lights: scene.lights.len(),
            ego: scene.ego().id.clone(),
            adversary: adversary.map(|track| track.id.clone()),
            adversary_origin: scene.adversary_origin,
            adversary_history: valid(0..HISTORY),
            adversary_future: valid(NOW + 1..NOW + 1 + HORIZON),
            horizon: scene.horizon(),
            capabilities: Capabilities::of(scene),
            warnings: warnings(scene),
            content: scene.content_hash(),
        }
    }
}

/// Detects scenes that occur more than once.
#[derive(Debug, Default)]
pub struct Duplicates(HashMap<[u8; 16], String>);

impl Duplicates {
    /// Adds a warning to a summary whose content occurred before under another name.
    pub fn note(&mut self, summary: &mut Summary) {
        match self.0.get(&summary.content) {
            Some(first) => {
                summary.warnings.push(Warning::new("duplicate", format!("same content as scene {first}")))
            }
            None => {
                self.0.insert(summary.content, summary.scene.clone());
            }
        }
    }
}

/// All warnings about a scene.
pub fn warnings(scene: &Scene) -> Vec<Warning> {
    let mut found = Vec::new();
    let mut warn = |kind, detail: String| found.push(Warning::new(kind, detail));
    for note in &scene.notes {
        let kind = match note {
            Note::HeldInGap(_) => "held-in-gap",
            Note::SwappedSizes(_) => "swapped-sizes",
            _ => note.repair().map_or("note", Repair::name),
        };
        let is_named = note.repair().is_some() || matches!(note, Note::HeldInGap(_));
        warn(kind, if is_named { note.text().to_owned() } else { note.to_string() });
    }
    let horizon = scene.horizon();
    if horizon < HORIZON {
        let seconds = |steps: usize| steps as f64 * DT;
        let last = scene.frames - 1;
        let text = if horizon < LEAST_HORIZON {
            format!("it ends at frame {last}, {:.1} s after now: nothing can be attacked", seconds(horizon))
        } else {
            format!(
                "it ends at frame {last}: attacks are scored over {:.1} s instead of {:.0} s",
                seconds(horizon),
                seconds(HORIZON)
            )
        };
        warn("short-recording", text);
    }
    if let Some(adversary) = scene.adversary.filter(|_| scene.is_in_contact_now()) {
        let id = scene.tracks[adversary].id.escape_debug();
        let text = format!(
            "the boxes of ego and adversary `{id}` overlap at frame {NOW}: no attack can be measured; name another \
             adversary with --adversary"
        );
        warn("contact-now", text);
    }
    if scene.adversary_origin == AdversaryOrigin::None {
        warn("no-adversary", "no vehicle moves and is valid in all of history".to_owned());
    }
    let agents = [("ego", Some(scene.ego())), ("adversary", scene.adversary.map(|k| &scene.tracks[k]))];
    for (name, track) in agents {
        let Some(track) = track else { continue };
        for (part, frames) in [("history", 0..HISTORY), ("future", NOW + 1..NOW + 1 + horizon)] {
            let missing = frames.len() - track.count_valid(frames.clone());
            if missing > 0 {
                let detail =
                    format!("{name} `{}` lacks {missing} of {} frames of its {part}", track.id, frames.len());
                warn("missing-frames", detail);
            }
        }
    }
    let unknown = scene.tracks.iter().filter(|track| track.kind.is_unknown()).count();
    if unknown > 0 {
        let words = if unknown == 1 { "1 track has" } else { &format!("{unknown} tracks have") };
        let effect = "counts as an obstacle and is never chosen as the adversary";
        warn("unknown-type", format!("{words} no known type; such a track {effect}"));
    }
    let crossings = level_crossings(scene);
    if !crossings.is_empty() {
        let detail =
            format!("lanes are more than {LEVEL} m above each other in {} grid cells", crossings.len());
        warn("overpass", detail);
    }
    let over_or_under = |track: &&Track| {
        passes_on_another_level(scene.ego(), track)
            || (0..track.valid.len())
                .any(|f| track.is_valid(f) && crossings.contains(&cell(&track.position[f])))
    };
    let on_levels = scene.tracks.iter().filter(over_or_under).count();
    if on_levels > 0 {
        warn("other-level", format!("{on_levels} tracks pass over or under another road or the ego"));
    }
    let short = scene.map.features.iter().filter(|f| f.kind.is_lane() && f.points.len() == 1).count();
    if short > 0 {
        let words = if short == 1 { "1 lane has" } else { &format!("{short} lanes have") };
        warn("one-point-lanes", format!("{words} a single point"));
    }
    if !scene.map.features.iter().any(|f| f.kind.is_boundary() && f.points.len() > 1) {
        let detail = if scene.map.has_edges() {
            "the map has medians but no road boundary, so only medians end the road"
        } else {
            "the map has no road edge, so off road is not measured; `drivable` keeps to the lanes, `paper` does not"
        };
        warn("no-road-edges", detail.to_owned());
    }
    let index = SceneIndex::new(scene.map.clone());
    let contradictory = contradictions::find(scene);
    on_edges_now(scene, &index, &mut warn);
    if let Some((frame, feature)) = recording_off_road(scene, &index) {
        let edge = scene.map.features[feature as usize].id.escape_debug();
        let detail = format!(
            "the ego's recording crosses the road edge `{edge}` at frame {frame}: an entrance is missing in the map; tables do not \
             count where a driver leaves the road in this scene"
        );
        warn("recording-off-road", detail);
    }
    of_trailers(scene, &mut warn);
    if let Some(track) = scene.adversary.map(|k| &scene.tracks[k]).filter(|t| t.kind != TrackKind::Vehicle) {
        let (id, kind) = (track.id.escape_debug(), track.kind.name().escape_debug());
        let detail = match track.kind.is_person() {
            true => format!(
                "the adversary `{id}` is a {kind}: its plans are those of a car unless --adversary-type says what it is"
            ),
            false => format!("the adversary `{id}` is a {kind}: plans and rules are those of a car"),
        };
        warn("adversary-kind", detail);
    }
    let flickering = scene.tracks.iter().filter(|track| gaps_of(track) >= FLICKER).count();
    if flickering > 0 {
        let words = if flickering == 1 { "1 track has" } else { &format!("{flickering} tracks have") };
        warn(
            "flickering-tracks",
            format!("{words} {FLICKER} gaps or more; a contact just after one is nobody's fault"),
        );
    }
    // The same remedy is not said twice.
    let are_all_wrong = contradictory.iter().any(|warning| warning.kind == "heading-against-positions");
    found.extend(headings::at_deciding_frames(scene).filter(|_| !are_all_wrong));
    found.extend(headings::of_standing(scene));
    found.extend(uneven_times(scene));
    found.extend(contradictory);
    found
}

/// Warnings that change what is computed from a scene: every command that computes something prints them.
pub fn important(scene: &Scene) -> Vec<Warning> {
    let mut all = warnings(scene);
    all.retain(|warning| warning.is_important);
    all
}

/// A warning about times that stray from 10 Hz. The motion says nothing of it, so the frames stay.
fn uneven_times(scene: &Scene) -> Option<Warning> {
    let times = &scene.timestamps;
    let longest = times.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
    let last = (NOW + HORIZON).min(times.len().saturating_sub(1));
    let drifts =
        times.iter().take(last + 1).enumerate().map(|(frame, time)| time - times[0] - DT * frame as f64);
    let (frame, drift) =
        drifts.enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).unwrap_or_default();
    let falls = times.windows(2).filter(|w| w[1] <= w[0]).count();
    // Clocks stray by tens of milliseconds; a missing or misplaced frame is another matter.
    let is_important = longest > LONGEST_STEP || falls > 0;
    if !is_important && drift.abs() <= MOST_DRIFT {
        return None;
    }
    let falls =
        if falls > 0 { format!("{falls} times are not above the one before; ") } else { String::new() };
    let detail = format!(
        "{falls}the longest step is {longest:.3} s, and frame {frame} comes {:.0} ms {} than at 10 Hz; frames are taken as 0.1 s apart",
        1e3 * drift.abs(),
        if drift > 0.0 { "later" } else { "earlier" }
    );
    Some(Warning { is_important, ..Warning::new("uneven-times", detail) })
}

/// Grid cell in which heights are compared.
fn cell([x, y, _]: &[f64; 3]) -> (i64, i64) {
    ((x / CELL).floor() as i64, (y / CELL).floor() as i64)
}

/// Cells in which lanes are on different levels.
fn level_crossings(scene: &Scene) -> HashSet<(i64, i64)> {
    let (lo, hi) = height_range(scene.map.polylines(MapKind::is_lane).flat_map(|(_, points)| points));
    let mut cells: HashMap<(i64, i64), (f64, f64)> = HashMap::new();
    if hi - lo <= LEVEL {
        return HashSet::new();
    }
    for point in scene.map.polylines(MapKind::is_lane).flat_map(|(_, points)| points) {
        let (lo, hi) = cells.entry(cell(point)).or_insert((point[2], point[2]));
        (*lo, *hi) = (lo.min(point[2]), hi.max(point[2]));
    }
    cells.into_iter().filter(|(_, (lo, hi))| hi - lo > LEVEL).map(|(cell, _)| cell).collect()
}

fn height_range<'p>(points: impl Iterator<Item = &'p [f64; 3]>) -> (f64, f64) {
    points.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), p| (lo.min(p[2]), hi.max(p[2])))
}

/// Whether a track is near the ego in some frame, but on another level.
fn passes_on_another_level(ego: &Track, track: &Track) -> bool {
    (0..track.valid.len()).any(|f| {
        let both_valid = track.is_valid(f) && ego.is_valid(f);
        both_valid
            && (track.position[f][2] - ego.position[f][2]).abs() > LEVEL
            && sage_core::geometry::distance(track.point(f), ego.point(f)) < NEAR
    })
}

/// Number of gaps in a recording.
fn gaps_of(track: &Track) -> usize {
    let ends = track.valid.windows(2).filter(|pair| pair[0] && !pair[1]).count();
    ends.saturating_sub(usize::from(track.valid.last() == Some(&false)))
}

/// Adds a warning about trailers of ego and adversary.
fn of_trailers(scene: &Scene, warn: &mut impl FnMut(&'static str, String)) {
    let cars = [("ego", Some(scene.ego)), ("adversary", scene.adversary)];
    for (role, hitch) in cars.map(|(role, car)| (role, car.and_then(|car| Hitch::of(scene, car)))) {
        let Some(Hitch { car, trailer, .. }) = hitch else { continue };
        let [car, trailer] = [car, trailer].map(|k| scene.tracks[k].id.escape_debug());
        let detail =
            format!("`{trailer}` moves with the {role} `{car}` as a trailer does: it is towed along");
        warn("trailer", detail);
    }
}

/// Adds a warning about vehicles whose box touches a road boundary, or is on a sidewalk, *now*.
fn on_edges_now(scene: &Scene, index: &SceneIndex, warn: &mut impl FnMut(&'static str, String)) {
    let (edges, sidewalks) = (index.boundaries(), index.sidewalks());
    let touches = |track: &Track| {
        // A box larger than any vehicle could intersect the bounds of the whole map.
        if track.kind != TrackKind::Vehicle || !track.is_valid(NOW) || track.size[NOW][0] > LONGEST {
            return false;
        }
        let b = track.oriented_box(NOW);
        edges.near(&b.aabb()).flat_map(|run| &edges.segments()[run]).any(|s| b.intersects_segment(s.a, s.b))
            || sidewalks.near(&b.aabb()).into_iter().any(|area| sidewalks.holds(area, b.center))
    };
    let touching: Vec<usize> = (0..scene.tracks.len()).filter(|&k| touches(&scene.tracks[k])).collect();
    if touching.is_empty() {
        return;
    }
    let mut touching_names: Vec<String> = Vec::new();
    for (name, track) in [("the ego", Some(scene.ego)), ("the adversary", scene.adversary)] {
        if track.is_some_and(|track| touching.contains(&track)) {
            touching_names.push(name.to_owned());
        }
    }
    let others = touching.len() - touching_names.len();
    if others > 0 {
        touching_names.push(format!("{others} other vehicle{}", if others == 1 { "" } else { "s" }));
    }
    warn("on-edge-now", format!("boxes touch a road edge at frame {NOW}: {}", touching_names.join(", ")));
}
