//! A recorded traffic scene: plain data, validated once by the reader.

mod adversary;
mod held;
mod hitch;
mod index;
mod lane_widths;
mod levels;
mod light;
mod map;
mod map_order;
mod note;
mod off_road;
mod scene_data;
mod sidewalks;
mod track;
mod tracks;

pub use adversary::{is_copy_of_ego, path_conflict, select_adversary};
pub use held::Held;
pub use hitch::Hitch;
pub use index::{SceneIndex, Sided};
pub use lane_widths::LaneWidths;
pub use levels::{LEVEL_GAP, Levels, is_one_level};
pub use light::{LightState, TrafficLight};
pub use map::{Boundary, Lane, Map, MapFeature, MapKind, Neighbor};
pub use note::{Note, PROVENANCE, Repair};
pub use off_road::{EDGE_WIDTH, EdgesSinceStart, recording_off_road};
pub use scene_data::SceneData;
pub use sidewalks::Sidewalks;
pub use track::{Track, TrackKind};
pub use tracks::Tracks;

use std::{borrow::Cow, sync::Arc};

use crate::{
    Error,
    motion::{HORIZON, LEAST_HORIZON, NOW},
};

/// A recorded scene.
///
/// Readers guarantee: finite numbers, at least [`crate::motion::HISTORY`] frames, tracks of equal
/// length, unique track ids, an ego that is valid *now*, positive sizes on valid frames.
///
/// `scene` is a road with two cars, of which the one ahead is the adversary:
///
/// ```
/// use sage_core::motion::NOW;
///
/// # let scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/road.rs"));
/// // 80 steps of 0.1 s follow *now*.
/// assert_eq!(scene.horizon(), 80);
/// assert_eq!(scene.ego().point(NOW), [0.0, 0.0]);
/// assert_eq!(scene.adversary()?.point(NOW), [20.0, 4.0]);
/// // The roles change by the ids of tracks; the content of the scene does not.
/// let exchanged = scene.clone().with_roles(Some("other"), Some("ego"))?;
/// assert_eq!(exchanged.ego().id, "other");
/// assert_eq!(exchanged.content_hash(), scene.content_hash());
/// # Ok::<(), sage_core::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Identifier that the file gives.
    pub id: String,
    /// Number of frames at 10 Hz.
    pub frames: usize,
    /// Time of each frame, seconds; as many as `frames`, or none if the file has none.
    pub timestamps: Vec<f64>,
    /// All road users, in the order of the file; shared between copies of the scene until one changes them.
    pub tracks: Tracks,
    /// Lanes, lines, edges; shared between copies of the scene.
    pub map: Arc<Map>,
    /// Traffic lights.
    pub lights: Vec<TrafficLight>,
    /// Index of the car under test in `tracks`.
    pub ego: usize,
    /// Index of the car whose future is replaced, if there is one.
    pub adversary: Option<usize>,
    /// How the adversary was found.
    pub adversary_origin: AdversaryOrigin,
    /// What a reader corrected or noticed.
    pub notes: Vec<Note>,
    /// Frames at which a standing road user was not seen, and is taken to be where it was before and after: its track is valid
    /// there.
    pub held: Vec<Held>,
}

/// How a scene's adversary was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AdversaryOrigin {
    /// The file names exactly one object of interest beside the ego.
    File,
    /// Selected by the conflict of its logged path with the ego's ([`select_adversary`]).
    Conflict,
    /// Named by the user.
    User,
    /// No track is eligible.
    None,
}

/// Stands for the road user that a data set was recorded for, if no road user has this id.
pub const FOCAL: &str = "focal";

impl Scene {
    /// Number of steps after *now* that are recorded, at most [`HORIZON`]: the steps on which a trajectory is
    /// scored and driven.
    pub fn horizon(&self) -> usize {
        self.frames.saturating_sub(NOW + 1).min(HORIZON)
    }

    /// As [`Scene::horizon`], for what needs a recorded future.
    ///
    /// *Errors*: [`Error::Scene`] if less than 1 s after *now* is recorded.
    pub fn attackable_horizon(&self) -> Result<usize, Error> {
        let horizon = self.horizon();
        if horizon >= LEAST_HORIZON {
            return Ok(horizon);
        }
        Err(Error::Scene {
            scene: self.id.clone(),
            problem: format!(
                "it has {} frames, so {horizon} frames after now (frame {NOW}); an attack needs at least \
                 {LEAST_HORIZON}. `sage predict`, `sage draw` and `sage simulate` with a policy that needs no log work \
                 without them",
                self.frames
            ),
        })
    }

    /// The scene with the frames that were observed alone, without those at which a road user is held.
    pub fn as_observed(&self) -> Cow<'_, Self> {
        if self.held.is_empty() {
            return Cow::Borrowed(self);
        }
        let mut scene = self.clone();
        for held in std::mem::take(&mut scene.held) {
            held.release(&mut scene.tracks[held.track]);
        }
        Cow::Owned(scene)
    }

    /// A track as it was observed, without the frames at which it is held.
    pub fn track_as_observed(&self, track: usize) -> Cow<'_, Track> {
        let mut held = self.held.iter().filter(|held| held.track == track).peekable();
        if held.peek().is_none() {
            return Cow::Borrowed(&self.tracks[track]);
        }
        let mut observed = self.tracks[track].clone();
        held.for_each(|held| held.release(&mut observed));
        Cow::Owned(observed)
    }

    /// Whether the recorded boxes of ego and adversary overlap *now* on one level, borders excluded.
    pub fn is_in_contact_now(&self) -> bool {
        let Some(adversary) = self.adversary.map(|k| &self.tracks[k]) else { return false };
        let ego = self.ego();
        ego.is_valid(NOW)
            && adversary.is_valid(NOW)
            && ego.oriented_box(NOW).overlap_depth(&adversary.oriented_box(NOW)) > 0.0
            && !Levels::of(&self.map).differ_at(NOW, ego, adversary)
    }

    /// Refuses a scene in which ego and adversary overlap *now*.
    ///
    /// *Errors*: [`Error::ContactNow`]; [`Error::Scene`] without an adversary.
    pub fn check_apart_now(&self) -> Result<(), Error> {
        let adversary = self.adversary()?;
        if !self.is_in_contact_now() {
            return Ok(());
        }
        Err(Error::ContactNow {
            scene: self.id.clone(),
            ego: self.ego().id.clone(),
            adversary: adversary.id.clone(),
        })
    }

    /// The scene without some road users: ego, adversary and those that `stays` names by their index stay.
    pub fn among(&self, stays: impl Fn(usize) -> bool) -> Self {
        let is_role = |track: usize| track == self.ego || Some(track) == self.adversary;
        let left: Vec<usize> = (0..self.tracks.len()).filter(|k| is_role(*k) || stays(*k)).collect();
        let place = |track: usize| left.iter().position(|k| *k == track);
        let held = self.held.iter().filter_map(|held| {
            let mut held = held.clone();
            held.track = place(held.track)?;
            Some(held)
        });
        Self {
            tracks: left.iter().map(|track| self.tracks[*track].clone()).collect(),
            ego: place(self.ego).unwrap_or_default(),
            adversary: self.adversary.and_then(place),
            held: held.collect(),
            ..self.clone()
        }
    }

    /// The scene without some road users, by their ids. Where its adversary is one of them, another is selected.
    ///
    /// *Errors*: [`Error::Scene`] for the ego, and for an id that there is not.
    pub fn without(mut self, ids: &[String]) -> Result<Self, Error> {
        let mut left_out = Vec::with_capacity(ids.len());
        for id in ids {
            let track = self.track_index(id)?;
            if track == self.ego {
                let problem = format!("track `{id}` cannot be left out: it is the ego");
                return Err(Error::Scene { scene: self.id, problem });
            }
            left_out.push(track);
        }
        let is_adversary = self.adversary.is_some_and(|adversary| left_out.contains(&adversary));
        if is_adversary {
            self.adversary = None;
        }
        let mut scene = self.among(|track| !left_out.contains(&track));
        if is_adversary {
            (scene.adversary, scene.adversary_origin) =
                select_adversary(&scene.as_observed().tracks, scene.ego, &Levels::of(&scene.map));
        }
        Ok(scene)
    }

    /// The car under test.
    pub fn ego(&self) -> &Track {
        &self.tracks[self.ego]
    }

    /// The adversary.
    ///
    /// *Errors*: [`Error::Scene`] if the scene has none.
    pub fn adversary(&self) -> Result<&Track, Error> {
        self.adversary_index().map(|track| &self.tracks[track])
    }

    /// Index of the adversary in `tracks`.
    ///
    /// *Errors*: [`Error::Scene`] if the scene has none.
    pub fn adversary_index(&self) -> Result<usize, Error> {
        self.adversary.ok_or_else(|| Error::Scene {
            scene: self.id.clone(),
            problem: "no vehicle can be the adversary; name one by its track id".to_owned(),
        })
    }

    /// Index of the track with this id.
    ///
    /// *Errors*: [`Error::Scene`] if there is none.
    pub fn track_index(&self, id: &str) -> Result<usize, Error> {
        let position = |id: &str| self.tracks.iter().position(|track| track.id == id);
        let focal = || {
            let mut noted = self.notes.iter().filter_map(|note| match note {
                Note::Focal(track) => Some(&**track),
                _ => None,
            });
            noted.next().filter(|_| id == FOCAL).and_then(position)
        };
        position(id).or_else(focal).ok_or_else(|| {
            let is_of = |note: &&Note| matches!(note, Note::TrackLeftOut { track, .. } if track == id);
            let left_out = self.notes.iter().find(is_of);
            Error::Scene {
                scene: self.id.clone(),
                problem: match left_out {
                    Some(note) => format!("no track `{id}`: {note}"),
                    None => format!("no track `{id}`; `sage inspect --tracks` lists them"),
                },
            }
        })
    }

    /// The scene with another ego, adversary, or both, named by track id.
    ///
    /// *Errors*: [`Error::Scene`] if a track does not exist, is not valid *now*, or both are one.
    pub fn with_roles(mut self, ego: Option<&str>, adversary: Option<&str>) -> Result<Self, Error> {
        let fail = |scene: &Self, problem: String| Err(Error::Scene { scene: scene.id.clone(), problem });
        if let Some(id) = ego {
            self.ego = self.track_index(id)?;
            if !self.ego().is_valid(NOW) {
                return fail(
                    &self,
                    format!("track `{id}` cannot be the ego: it is not valid at frame {NOW}"),
                );
            }
            if adversary.is_none() {
                (self.adversary, self.adversary_origin) =
                    select_adversary(&self.as_observed().tracks, self.ego, &Levels::of(&self.map));
            }
        }
        if let Some(id) = adversary {
            let index = self.track_index(id)?;
            if !self.tracks[index].valid[..=NOW].contains(&true) {
                return fail(
                    &self,
                    format!("track `{id}` cannot be the adversary: no frame of its history is valid"),
                );
            }
            (self.adversary, self.adversary_origin) = (Some(index), AdversaryOrigin::User);
        }
        if let Some(index) = self.adversary.filter(|index| *index != self.ego)
            && is_copy_of_ego(&self.tracks[index], self.ego(), &Levels::of(&self.map))
        {
            let problem = format!(
                "track `{}` cannot be the adversary: it is a second recording of the ego",
                self.tracks[index].id
            );
            return fail(&self, problem);
        }
        if self.adversary == Some(self.ego) {
            let id = self.ego().id.clone();
            return fail(&self, format!("track `{id}` cannot be ego and adversary at once"));
        }
        Ok(self)
    }

    /// Hash of the content: frames, tracks, map and lights, without the scene's identifier. It is equal for
    /// one scene stored under several numbers, ids or file formats.
    pub fn content_hash(&self) -> [u8; 16] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&(self.frames as u64).to_le_bytes());
        let mut numbers = Vec::new();
        for track in &self.tracks {
            numbers.clear();
            track.append_numbers(&mut numbers);
            hash_text(&mut hasher, &track.id);
            hash_text(&mut hasher, track.kind.name());
            hash_numbers(&mut hasher, &numbers);
        }
        numbers.clear();
        numbers.extend(self.map.points.iter().flatten());
        hash_numbers(&mut hasher, &numbers);
        for feature in &self.map.features {
            hash_text(&mut hasher, &feature.id);
            hash_text(&mut hasher, feature.kind.name());
            hasher.update(&(feature.points.len() as u64).to_le_bytes());
        }
        for light in &self.lights {
            hash_text(&mut hasher, &light.lane);
            let states: Vec<u8> = light.states.iter().map(|s| s.steady() as u8).collect();
            hasher.update(&states);
        }
        let mut out = [0; 16];
        out.copy_from_slice(&hasher.finalize().as_bytes()[..16]);
        out
    }
}

fn hash_text(hasher: &mut blake3::Hasher, text: &str) {
    hasher.update(&(text.len() as u64).to_le_bytes()).update(text.as_bytes());
}

fn hash_numbers(hasher: &mut blake3::Hasher, numbers: &[f64]) {
    let mut buffer = [0u8; 8 * 512];
    for chunk in numbers.chunks(512) {
        for (slot, x) in buffer.chunks_exact_mut(8).zip(chunk) {
            slot.copy_from_slice(&x.to_le_bytes());
        }
        hasher.update(&buffer[..8 * chunk.len()]);
    }
}
