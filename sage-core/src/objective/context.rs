//! Scene data for scoring, built once for all candidates of a scene.

use std::sync::Arc;

use super::{
    Body, Candidate, Convention, EgoPath, EgoPaths, OtherAgent, Sizes,
    ego::{self, PathOptions},
    ground::Ground,
};
use crate::{
    Error,
    geometry::OrientedBox,
    motion::{NOW, Trajectory},
    scene::{Hitch, LEVEL_GAP, Levels, Scene, SceneIndex, Track},
};

/// Number of other agents in the published code: its table has 128 rows, two of them ego and adversary.
const RELEASE_AGENTS: usize = 126;

/// Options of a context.
#[derive(Clone, Debug, Default)]
pub struct ContextOptions {
    /// Convention of the formulas.
    pub convention: Convention,
    /// Sizes of ego and adversary.
    pub sizes: Sizes,
    /// The ego's paths; the logged one if `None`.
    pub ego: Option<EgoPaths>,
    /// Whether boxes are mirrored against map and agents; by default only in `release`.
    pub mirrored_boxes: Option<bool>,
}

/// A scene with one adversary and the ego's paths, prepared for scoring. Clones share its data.
///
/// A plan of the adversary, which moves over in front of the ego and slows down to 4 m/s:
///
/// ```
/// use std::sync::Arc;
///
/// use sage_core::{
///     motion::Trajectory,
///     objective::{Context, ContextOptions, Situation},
///     scene::SceneIndex,
/// };
///
/// # let scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/road.rs"));
/// let scene = Arc::new(scene);
/// let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// let at = |t: f64| [20.0 + 4.0 * t, (4.0 - 2.0 * t).max(0.0)];
/// let plan = Trajectory::new("plan", (1..=80).map(|step| at(0.1 * f64::from(step))).collect())?;
///
/// let candidate = ctx.candidate(plan);
/// // The ego at 10 m/s gains 6 m/s on it and closes the gap of 16 m after 2.7 s.
/// assert_eq!(Situation::new(&candidate, ctx.ego(), &ctx).encounter.contact, Some(27));
/// # Ok::<(), sage_core::Error>(())
/// ```
#[derive(Clone)]
pub struct Context {
    scene: Arc<Scene>,
    index: Arc<SceneIndex>,
    adversary: usize,
    body: Body,
    ego_size: [f64; 2],
    egos: Arc<[EgoPath]>,
    others: Arc<[OtherAgent]>,
    horizon: usize,
    is_in_contact_now: bool,
    /// Height of the ground under the adversary *now*, metres; `None` if it is not valid there.
    ground_now: Option<f64>,
}

impl Context {
    /// Prepares a scene for scoring.
    ///
    /// *Errors*: [`Error::Scene`] if there is no adversary, if less than 1 s after *now* is recorded, or if no ego
    /// path is given and the ego has no valid frame after *now*.
    pub fn new(scene: &Arc<Scene>, index: &Arc<SceneIndex>, options: &ContextOptions) -> Result<Self, Error> {
        let adversary = scene.adversary_index()?;
        let horizon = scene.attackable_horizon()?;
        let ContextOptions { convention, sizes, ego, mirrored_boxes } = options;
        let mirrored = mirrored_boxes.unwrap_or(*convention == Convention::Release);
        let (ego_size, size) = sizes.of(scene, adversary);
        let egos = ego::prepare(
            ego.as_ref(),
            scene,
            index,
            PathOptions { convention: *convention, size: ego_size },
        )?;
        // What the adversary tows goes where it goes.
        let towed = Hitch::of(scene, adversary).filter(|_| *convention == Convention::Paper);
        let towed = towed.map(|hitch| hitch.trailer);
        let others = scene
            .tracks
            .iter()
            .enumerate()
            .filter(|(k, _)| *k != scene.ego && *k != adversary && Some(*k) != towed)
            .map(|(k, track)| OtherAgent::new(k, track, mirrored))
            .collect();
        Ok(Self {
            scene: scene.clone(),
            index: index.clone(),
            adversary,
            body: Body::new(scene, size, *convention, mirrored)?,
            ego_size,
            egos: egos.into(),
            others,
            horizon,
            is_in_contact_now: overlap_now(scene, [scene.ego, adversary], [ego_size, size]),
            ground_now: Some(&scene.tracks[adversary])
                .filter(|track| track.is_valid(NOW))
                .map(|track| track.ground(NOW)),
        })
    }

    /// The same scene, convention and sizes with other ego paths: index and other road users are shared.
    ///
    /// *Errors*: [`Error::Scene`] for a path that begins elsewhere than the ego; [`Error::Options`] for weights
    /// whose sum is not finite.
    pub fn with_ego(&self, ego: &EgoPaths) -> Result<Self, Error> {
        let options = PathOptions { convention: self.convention(), size: self.ego_size };
        let egos = ego::prepare(Some(ego), &self.scene, &self.index, options)?.into();
        Ok(Self { egos, ..self.clone() })
    }

    /// Prepares a trajectory for scoring up to the horizon, as [`Body::candidate`].
    pub fn candidate(&self, trajectory: Trajectory) -> Candidate {
        let ground = self.ground_now.map(|height| Ground::from_now(&self.index, height));
        let candidate = self.body.candidate_on(trajectory, self.horizon, ground);
        // A recording may drive backwards after a stop, which its positions alone do not say.
        let headings = match candidate.half_turn() {
            Some(_) => self.adversary().headings_if_repeated(candidate.trajectory()),
            None => None,
        };
        match headings {
            Some(headings) => candidate.with_headings(&headings, self.body.car.size),
            None => candidate,
        }
    }

    /// Whether ego and adversary overlap *now* on one level. Then no contact with the ego is measured.
    pub fn is_in_contact_now(&self) -> bool {
        self.is_in_contact_now
    }

    /// Refuses a scene in which ego and adversary overlap *now*.
    ///
    /// *Errors*: [`Error::ContactNow`].
    pub fn check_apart_now(&self) -> Result<(), Error> {
        if !self.is_in_contact_now {
            return Ok(());
        }
        Err(Error::ContactNow {
            scene: self.scene.id.clone(),
            ego: self.scene.ego().id.clone(),
            adversary: self.adversary().id.clone(),
        })
    }

    /// Height of the ground under the adversary *now*, metres; `None` on a map with one level, and if it is not valid now.
    pub(super) fn level_now(&self) -> Option<f64> {
        self.ground_now.filter(|_| self.index.has_levels(LEVEL_GAP))
    }

    /// Number of steps that are evaluated: those that are recorded, at most 80 ([`Scene::horizon`]).
    pub fn horizon(&self) -> usize {
        self.horizon
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The search trees of the map.
    pub fn index(&self) -> &Arc<SceneIndex> {
        &self.index
    }

    /// The adversary's logged track.
    pub fn adversary(&self) -> &Track {
        &self.scene.tracks[self.adversary]
    }

    /// The adversary's body, which prepares all 80 steps of a trajectory.
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// Convention of the formulas.
    pub fn convention(&self) -> Convention {
        self.body.car.convention
    }

    /// The ego's paths, at least one, in the given order.
    pub fn egos(&self) -> &[EgoPath] {
        &self.egos
    }

    /// The first of the ego's paths: the logged one, unless others were given.
    pub fn ego(&self) -> &EgoPath {
        &self.egos[0]
    }

    /// Length and width of the adversary, metres.
    pub fn size(&self) -> [f64; 2] {
        self.body.car.size
    }

    /// Length and width of the ego, metres.
    pub fn ego_size(&self) -> [f64; 2] {
        self.ego_size
    }

    /// The other road users, in the order of the file, without what the adversary tows.
    pub fn others(&self) -> &[OtherAgent] {
        &self.others
    }

    /// The other road users that the convention's frame-by-frame rule considers: all, or the first 126 of
    /// the published code.
    pub(super) fn known_others(&self) -> &[OtherAgent] {
        match self.convention() {
            Convention::Paper => &self.others,
            Convention::Release => &self.others[..self.others.len().min(RELEASE_AGENTS)],
        }
    }
}

/// Whether the boxes of two tracks, with given lengths and widths, overlap *now* on one level; borders
/// excluded.
fn overlap_now(scene: &Scene, tracks: [usize; 2], sizes: [[f64; 2]; 2]) -> bool {
    let [a, b] = [0, 1].map(|k| {
        let (track, [length, width]) = (&scene.tracks[tracks[k]], sizes[k]);
        track.is_valid(NOW).then(|| OrientedBox::new(track.point(NOW), track.heading[NOW], length, width))
    });
    let [ego, adversary] = tracks.map(|k| &scene.tracks[k]);
    a.zip(b).is_some_and(|(a, b)| a.overlap_depth(&b) > 0.0)
        && !Levels::of(&scene.map).differ_at(NOW, ego, adversary)
}
