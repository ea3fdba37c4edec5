//! A self-contained HTML page that plays drives of one scene side by side.
//!
//! The page holds the map around the drives, the traffic, and each drive, as integers: centimetres,
//! milliradians, centimetres per second, each as the difference to the number before. It needs no network.

mod encoding;
pub(crate) mod map;

use sage_core::{
    geometry::{Aabb, OrientedBox, Point},
    motion::{DT, NOW},
    scene::{Scene, Track, TrackKind},
    selection_outcome::{CandidateKind, Mark},
    text::escaped_name,
};
use sage_sim::{
    body::BodyShape,
    drive::Drive,
    episode::{EpisodeContact, LAST_FRAME},
    policy::Shown,
    vehicle::Motion,
};
use serde::Serialize;
use serde_json::Result;

use crate::html_page::{self, PageParts};
pub(crate) use encoding::EncodedBody;
use encoding::FrameState;
use map::EncodedFeature;

/// Size limit of a page, bytes.
const LIMIT: usize = 2_000_000;
/// Detail of the map, finest first: largest error of a line, and reach around the drives, metres. The first
/// that fits into the page is taken.
const DETAILS: [[f64; 2]; 5] = [[0.05, 150.0], [0.1, 100.0], [0.2, 70.0], [0.5, 50.0], [1.0, 30.0]];

pub(crate) const PAGE: &str = include_str!("player/page.html");
pub(crate) const STYLE: &str = include_str!("player/style.css");
/// The player, without data.
pub(crate) const PLAYER: &str = concat!(
    include_str!("player/drawing.js"),
    include_str!("player/burst.js"),
    include_str!("player/sweep.js"),
    include_str!("player/player.js")
);
const START: &str = r#"start(JSON.parse(element("data").textContent));"#;

/// One drive of the page.
pub struct Panel<'a> {
    /// Driver and attack.
    pub name: String,
    /// Names it in a link to the page; may be empty.
    pub id: String,
    /// Its place in a sweep.
    pub sweep: Option<Sweep>,
    /// Motion of the ego at each frame, up to its first contact.
    pub motions: &'a [Motion],
    /// Last frame of the drive.
    pub end: usize,
    /// What its driver showed.
    pub shown: &'a [Shown],
    /// The contact that ends it.
    pub contact: Option<Meeting>,
    /// What the adversary does, if there is one.
    pub adversary: Option<&'a Track>,
    /// The same driver without the attack, up to its first contact.
    pub unattacked: Option<&'a [Motion]>,
    /// The last evasive manoeuvre of that drive, from its start to frame 90: box centres and headings.
    pub evasion: Option<&'a [[f64; 3]]>,
    /// Whether the attack works; `None` without an attack.
    pub verdict: Option<bool>,
    /// Whether its planner failed, so that the drive has no result.
    pub is_failed: bool,
    /// Candidates that were not selected, by their number among the paths of the page.
    pub others: Vec<usize>,
    /// Where hits that were not selected break a rule.
    pub marks: Vec<Mark>,
    /// What the verdict is called at the end; "attack" if `None`.
    pub badge: Option<&'static str>,
    /// Says what is attacked, before the end.
    pub note: String,
    /// Says how it ended.
    pub ending: String,
}

/// A candidate of the adversary.
pub struct Path {
    /// What it does.
    pub kind: CandidateKind,
    /// Positions from *now* on.
    pub points: Vec<Point>,
}

/// Where two boxes meet.
#[derive(Clone, Copy, Debug)]
pub struct Meeting {
    /// Frame of the contact.
    pub frame: usize,
    /// Boxes of the ego and of the other.
    pub areas: [OrientedBox; 2],
}

impl From<&EpisodeContact> for Meeting {
    fn from(hit: &EpisodeContact) -> Self {
        Self { frame: hit.contact.step, areas: hit.contact.areas }
    }
}

/// The part of a drive that a page shows: up to its first contact.
pub fn shown_part(drive: &Drive) -> &[Motion] {
    let end = drive.contacts.first().map_or(LAST_FRAME, |contact| contact.step.min(LAST_FRAME));
    &drive.motions[..drive.motions.len().min(end + 1)]
}

/// Drives that differ in one value share a box of the page, and a slider chooses which of them it shows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sweep {
    /// Number of the box.
    pub group: usize,
    /// What differs: `lambda` or `aggression`.
    pub axis: &'static str,
    /// Value of the swept quantity.
    pub value: f64,
}

#[derive(Serialize)]
struct Data<'a> {
    title: &'a str,
    subtitle: &'a str,
    now: usize,
    frames: usize,
    columns: usize,
    back: Option<&'a str>,
    map: Vec<EncodedFeature>,
    traffic: Vec<EncodedBody>,
    paths: Vec<EncodedPath>,
    panels: Vec<EncodedPanel<'a>>,
}

/// Boxes with a label: centre in centimetres, heading in milliradians, length and width in centimetres.
#[derive(Serialize)]
struct EncodedMark<'a> {
    boxes: Vec<[i64; 5]>,
    label: &'a str,
}

/// Every fourth point of a path, in decimetres as differences.
#[derive(Serialize)]
pub(crate) struct EncodedPath {
    kind: CandidateKind,
    x: Vec<i64>,
    y: Vec<i64>,
}

/// A drive as the script of the player reads it.
#[derive(Serialize)]
pub(crate) struct EncodedPanel<'a> {
    name: &'a str,
    #[serde(skip_serializing_if = "str::is_empty")]
    id: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    sweep: Option<Sweep>,
    /// Last frame of the drive.
    end: usize,
    ego: EncodedBody,
    adversary: Option<EncodedBody>,
    ghost: Option<EncodedBody>,
    escape: Option<EncodedBody>,
    contact: Option<EncodedContact>,
    verdict: Option<bool>,
    failed: bool,
    #[serde(skip_serializing_if = "<[usize]>::is_empty")]
    others: &'a [usize],
    #[serde(skip_serializing_if = "Vec::is_empty")]
    marks: Vec<EncodedMark<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    badge: Option<&'static str>,
    /// What the driver showed.
    shown: Vec<EncodedShown<'a>>,
    note: &'a str,
    ending: &'a str,
}

/// A plan from a frame on, in centimetres as differences, and lines of a log.
#[derive(Serialize)]
struct EncodedShown<'a> {
    frame: usize,
    x: Vec<i64>,
    y: Vec<i64>,
    log: &'a str,
}

#[derive(Serialize)]
struct EncodedContact {
    frame: usize,
    x: i64,
    y: i64,
}

/// A page of drives in one scene.
#[derive(Clone, Copy)]
pub struct Page<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// What the page is called.
    pub title: &'a str,
    /// What is said below.
    pub subtitle: &'a str,
    /// The drives.
    pub panels: &'a [Panel<'a>],
    /// Candidates that were not chosen, by their numbers in the panels.
    pub paths: &'a [Path],
    /// Number of drives in a row, if there is room.
    pub columns: usize,
    /// Link to the page that lists all.
    pub back: Option<&'a str>,
}

/// The text of a page.
///
/// *Errors*: a template without the places for title and data.
///
/// The recorded drive as a page that plays it:
///
/// ```
/// use std::sync::Arc;
///
/// use sage_core::scene::SceneIndex;
/// use sage_data::procedural::{Kind, generate};
/// use sage_sim::{SimScene, episode::Episode, policy::policies};
/// use sage_view::player::{Page, Panel, page, shown_part};
///
/// let scene = Arc::new(generate(Kind::Merge, 1, 0).ok_or("no scene for this seed")?);
/// let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
/// let episode = Episode::run(&simulated, None, &*policies()?.build_default("replay")?, 0)?;
/// let panel = Panel {
///     name: "replay".to_owned(),
///     motions: shown_part(&episode.drive),
///     end: episode.steps(),
///     adversary: scene.adversary().ok(),
///     note: "no attack".to_owned(),
///     ending: "no contact".to_owned(),
/// #     id: String::new(),
/// #     sweep: None,
/// #     shown: &[],
/// #     contact: None,
/// #     unattacked: None,
/// #     evasion: None,
/// #     verdict: None,
/// #     is_failed: false,
/// #     others: Vec::new(),
/// #     marks: Vec::new(),
/// #     badge: None,
///     // … and nothing of an attack
/// };
/// let (title, panels) = (scene.id.as_str(), &[panel]);
/// let html = page(&Page { scene: &scene, title, subtitle: "", panels, paths: &[], columns: 1, back: None })?;
/// // It loads nothing: one file is enough.
/// assert!(html.contains("<title>merge-1-0") && !html.contains("src=\"http"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn page(page: &Page) -> Result<String> {
    let Page { scene, title, subtitle, panels, paths, columns, back } = *page;
    let (title, subtitle) = (&*escaped_name(title), &*escaped_name(subtitle));
    // World coordinates reach 100 km, so the page counts from the ego's start.
    let origin = scene.ego().point(0);
    let driven = Aabb::of(panels.iter().flat_map(|panel| {
        let ego = panel.motions.iter().map(|motion| motion.position);
        let other = panel.adversary.into_iter().flat_map(|track| states(track, [0.0, 0.0]).map(|s| s.1.at));
        ego.chain(other).collect::<Vec<Point>>()
    }));
    let mut text = String::new();
    for [error, reach] in DETAILS {
        let area = Aabb { min: driven.min.map(|x| x - reach), max: driven.max.map(|x| x + reach) };
        let data = Data {
            title,
            subtitle,
            now: NOW,
            frames: LAST_FRAME + 1,
            columns,
            back,
            map: map::encoded(scene, &area, error, origin),
            traffic: traffic(scene, panels, &area, origin),
            paths: paths.iter().map(|path| encoded_path(path, origin)).collect(),
            panels: panels.iter().map(|panel| encoded(panel, scene, origin)).collect(),
        };
        text = html_page::embedded(&data)?;
        if text.len() + PAGE.len() + STYLE.len() + PLAYER.len() <= LIMIT {
            break;
        }
    }
    let script = &[PLAYER, START].concat();
    html_page::assembled(PageParts { body: PAGE, style: STYLE, script, title, data: &text })
}

/// All road users besides ego and adversary that come near.
fn traffic(scene: &Scene, panels: &[Panel], area: &Aabb, origin: Point) -> Vec<EncodedBody> {
    let has_adversary = panels.iter().any(|panel| panel.adversary.is_some());
    let is_shown = |k: usize| k != scene.ego && !(has_adversary && scene.adversary == Some(k));
    let tracks = scene.tracks.iter().enumerate().filter(|(k, _)| is_shown(*k)).map(|(_, track)| track);
    tracks.filter(|track| is_in(track, area)).filter_map(|track| encoded_track(track, origin)).collect()
}

/// Whether a road user is ever in an area.
pub(crate) fn is_in(track: &Track, area: &Aabb) -> bool {
    states(track, [0.0, 0.0]).any(|(_, state)| area.meets(&Aabb::around(state.at, 0.0)))
}

/// A road user; `None` if it is never there.
pub(crate) fn encoded_track(track: &Track, origin: Point) -> Option<EncodedBody> {
    EncodedBody::of(states(track, origin), box_size(track), kind(track))
}

pub(crate) fn encoded<'a>(panel: &'a Panel, scene: &Scene, origin: Point) -> EncodedPanel<'a> {
    let Panel {
        name,
        id,
        sweep,
        motions,
        end,
        adversary,
        unattacked,
        evasion,
        verdict,
        is_failed,
        note,
        ending,
        ..
    } = panel;
    let size = box_size(scene.ego());
    let drive = |motions: &[Motion]| {
        let states =
            motions.iter().enumerate().map(|(frame, motion)| (frame, FrameState::of_motion(motion, origin)));
        EncodedBody::of(states, size, "vehicle")
    };
    let contact = panel.contact.map(|hit| {
        let [own, other] = &hit.areas;
        // The corner of one box that lies deepest in the other is near the place of the contact.
        let nearest = |a: &OrientedBox, b: &OrientedBox| {
            let gap = |p: &Point| {
                let [x, y] = b.box_from_world(*p);
                (x.abs() - b.half_length).max(y.abs() - b.half_width)
            };
            a.corners().into_iter().map(|p| (gap(&p), p)).min_by(|p, q| p.0.total_cmp(&q.0))
        };
        let corners = [nearest(own, other), nearest(other, own)].into_iter().flatten();
        let at = corners.min_by(|p, q| p.0.total_cmp(&q.0)).map_or(own.center, |(_, p)| p);
        let [x, y] = [0, 1].map(|k| encoding::hundredths(at[k] - origin[k]));
        EncodedContact { frame: hit.frame, x, y }
    });
    EncodedPanel {
        name,
        id,
        sweep: *sweep,
        end: *end,
        // A drive has at least its first frame.
        ego: drive(motions).unwrap_or_default(),
        adversary: adversary.and_then(|track| encoded_track(track, origin)),
        ghost: unattacked.and_then(drive),
        escape: evasion.and_then(|rows| EncodedBody::of(evasion_states(rows, origin), size, "vehicle")),
        contact,
        verdict: *verdict,
        failed: *is_failed,
        others: &panel.others,
        marks: panel.marks.iter().map(|mark| encoded_mark(mark, origin)).collect(),
        badge: panel.badge,
        shown: panel.shown.iter().map(|shown| encoded_shown(shown, origin)).collect(),
        note,
        ending,
    }
}

fn encoded_mark(mark: &Mark, origin: Point) -> EncodedMark<'_> {
    let encoded = |b: &OrientedBox| {
        let heading = b.axis[1].atan2(b.axis[0]);
        let [x, y] = [0, 1].map(|axis| encoding::hundredths(b.center[axis] - origin[axis]));
        let [length, width] = [b.half_length, b.half_width].map(|half| encoding::hundredths(2.0 * half));
        [x, y, (1000.0 * heading).round() as i64, length, width]
    };
    EncodedMark { boxes: mark.boxes.iter().map(encoded).collect(), label: &mark.label }
}

pub(crate) fn encoded_path(path: &Path, origin: Point) -> EncodedPath {
    let last = path.points.len().saturating_sub(1);
    let shown: Vec<&Point> =
        path.points.iter().enumerate().filter(|(k, _)| k % 4 == 0 || *k == last).map(|(_, p)| p).collect();
    let differences = |axis: usize| -> Vec<i64> {
        let all = shown.iter().map(|p| (10.0 * (p[axis] - origin[axis])).round() as i64);
        all.scan(0, |before, value| Some(value - std::mem::replace(before, value))).collect()
    };
    EncodedPath { kind: path.kind, x: differences(0), y: differences(1) }
}

fn encoded_shown(shown: &Shown, origin: Point) -> EncodedShown<'_> {
    let differences = |axis: usize| -> Vec<i64> {
        let all = shown.plan.iter().map(|p| encoding::hundredths(p[axis] - origin[axis]));
        all.scan(0, |before, value| Some(value - std::mem::replace(before, value))).collect()
    };
    EncodedShown { frame: shown.step, x: differences(0), y: differences(1), log: &shown.log }
}

/// States of an evasive manoeuvre, which ends at the last frame.
fn evasion_states(rows: &[[f64; 3]], origin: Point) -> impl Iterator<Item = (usize, FrameState)> {
    let first = LAST_FRAME + 1 - rows.len().min(LAST_FRAME + 1);
    rows.iter().enumerate().map(move |(k, &[x, y, heading])| {
        let [before_x, before_y, _] = rows[k.saturating_sub(1)];
        let motion = Motion {
            position: [x, y],
            heading,
            velocity: [(x - before_x) / DT, (y - before_y) / DT],
            yaw_rate: 0.0,
        };
        (first + k, FrameState::of_motion(&motion, origin))
    })
}

/// States of a track at its valid frames, relative to an origin.
fn states(track: &Track, origin: Point) -> impl Iterator<Item = (usize, FrameState)> {
    let frames = (0..track.valid.len().min(LAST_FRAME + 1)).filter(|&frame| track.is_valid(frame));
    frames.map(move |frame| {
        let motion = Motion {
            position: track.point(frame),
            heading: track.heading[frame],
            velocity: track.velocity[frame],
            yaw_rate: 0.0,
        };
        (frame, FrameState::of_motion(&motion, origin))
    })
}

/// Length and width of a track's box, metres.
fn box_size(track: &Track) -> [f64; 2] {
    BodyShape::at_now(track).size.unwrap_or([4.5, 1.9])
}

fn kind(track: &Track) -> &'static str {
    match track.kind {
        TrackKind::Vehicle => "vehicle",
        TrackKind::Pedestrian => "pedestrian",
        TrackKind::Cyclist => "cyclist",
        TrackKind::Other(_) => "other",
    }
}
