//! Who is the adversary: the road user that a scene chooses, one that the user names, or a person who is placed in the scene.

use sage_core::scene::{Scene, SceneIndex, TrackKind};
use sage_data::{Recording, Warning, checks};
use sage_generators::Placement;
use serde::{Deserialize, Serialize};
use serde_json::{Map, json};

use crate::{Error, Result};

/// Kinds of people.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum PersonKind {
    /// Somebody on foot.
    Pedestrian,
    /// Somebody on a bicycle.
    Cyclist,
}

impl PersonKind {
    /// The kind of their tracks.
    pub fn track_kind(self) -> TrackKind {
        match self {
            Self::Pedestrian => TrackKind::Pedestrian,
            Self::Cyclist => TrackKind::Cyclist,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pedestrian => "pedestrian",
            Self::Cyclist => "cyclist",
        }
    }
}

/// Who is the adversary, as a user says it. Without anything it is the road user that the scene chooses.
///
/// ```
/// use std::path::Path;
///
/// use advsage::{AdversarySpec, PersonKind, Recording};
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let recording = Recording::read(file)?;
/// let count = recording.scene.tracks.len();
/// let spec = AdversarySpec { kind: Some(PersonKind::Pedestrian), ..AdversarySpec::default() };
/// // A pedestrian stands beside the ego's way from the first frame on.
/// let placed = spec.of(recording)?.scene;
/// assert_eq!(placed.tracks.len(), count + 1);
/// assert_eq!(placed.adversary()?.kind.name(), "PEDESTRIAN");
/// # Ok::<(), advsage::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AdversarySpec {
    /// Track of the adversary.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// What it is, if it is a person: recorded if `id` names one, else placed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<PersonKind>,
    /// How a person is placed, if not by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<Placement>,
}

impl AdversarySpec {
    /// A road user by the id of its track; `None` for the one that the scene chooses.
    pub fn named(id: Option<&str>) -> Self {
        Self { id: id.map(str::to_owned), ..Self::default() }
    }

    /// What may change the results of a scene with this adversary: that its kind is no car's, unless that was asked.
    pub fn warnings(&self, scene: &Scene) -> Vec<Warning> {
        let mut all = checks::important(scene);
        all.retain(|warning| self.kind.is_none() || warning.kind != "adversary-kind");
        all
    }

    /// Checks what can be checked without a scene.
    ///
    /// *Errors*: a placement out of range, or of nobody.
    pub fn check(&self) -> Result<()> {
        let Some(place) = &self.place else { return Ok(()) };
        if self.kind.is_none() {
            return Err(Error::Value(
                "a place needs a person: an adversary type, pedestrian or cyclist".to_owned(),
            ));
        }
        if self.id.is_some() {
            return Err(Error::Value(
                "a place is for somebody who is not recorded; leave out the adversary's id".to_owned(),
            ));
        }
        place.check().map_err(|problem| Error::Value(format!("place: {problem}")))
    }

    /// The recording with this adversary.
    ///
    /// *Errors*: no such track, one of another kind, or [`sage_core::Error::NoPlace`].
    pub fn of(&self, mut recording: Recording) -> Result<Recording> {
        let Some((kind, place)) = self.placement() else {
            recording.scene = self.named_in(recording.scene)?;
            return Ok(recording);
        };
        let scene = &recording.scene;
        let tracks = place.tracks(scene, &SceneIndex::new(scene.map.clone()), &kind.track_kind())?;
        let mut facts = Map::new();
        facts.insert("placed".to_owned(), json!(self));
        Ok(recording.with_added(tracks, facts)?)
    }

    /// The recording of a row, whose adversary has an id: it is there, or it was `placed`.
    ///
    /// *Errors*: as [`AdversarySpec::of`].
    pub fn of_row(placed: Option<&Self>, recording: Recording, adversary: &str) -> Result<Recording> {
        let is_there = recording.scene.tracks.iter().any(|track| track.id == adversary);
        match placed.filter(|_| !is_there) {
            Some(placed) => placed.of(recording),
            None => Self::named(Some(adversary)).of(recording),
        }
    }

    /// This, if it places somebody.
    pub fn placed(&self) -> Option<Self> {
        self.placement().map(|_| self.clone())
    }

    /// The scene with this adversary.
    ///
    /// *Errors*: as [`AdversarySpec::of`].
    pub fn in_scene(&self, scene: Scene) -> Result<Scene> {
        match self.placement() {
            None => self.named_in(scene),
            Some(_) => Ok(self.of(Recording::procedural(scene))?.scene),
        }
    }

    /// Whom to place, and how; `None` for a recorded adversary.
    fn placement(&self) -> Option<(PersonKind, Placement)> {
        Some((self.kind.filter(|_| self.id.is_none())?, self.place.unwrap_or_default()))
    }

    fn named_in(&self, scene: Scene) -> Result<Scene> {
        let scene = scene.with_roles(None, self.id.as_deref())?;
        if let Some(kind) = self.kind {
            let track = scene.adversary()?;
            if track.kind != kind.track_kind() {
                return Err(Error::Value(format!(
                    "scene `{}`: the adversary `{}` is a {}, not a {}",
                    scene.id,
                    track.id,
                    track.kind.name(),
                    kind.name()
                )));
            }
        }
        Ok(scene)
    }
}
