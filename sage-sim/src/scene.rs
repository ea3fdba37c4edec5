//! A recorded scene, prepared for simulation: everything that does not change while it runs.

use std::sync::{Arc, OnceLock};

use sage_core::{
    geometry::Point,
    motion::{HORIZON, NOW},
    scene::{Hitch, LEVEL_GAP, Scene, SceneIndex, Track, recording_off_road},
};

use crate::{
    Error,
    body::BodyShape,
    lines::{LineShapes, Lines},
    route::Route,
    route_lights::RouteLights,
};

/// Last frame of an episode.
pub const LAST_FRAME: usize = NOW + HORIZON;
/// Length by which the route of a policy reaches beyond the log, metres.
pub(crate) const GUIDE: f64 = 200.0;

/// A shorter log gives no direction to drive in, metres.
const SHORTEST_LOG: f64 = 1.0;

/// The route of a track's log, continued along the lanes. A track that stands gets one along its heading.
pub(crate) fn guide(log: &Track, index: &SceneIndex) -> Route {
    let route = Route::of_track(log, 0, false);
    if route.length() >= SHORTEST_LOG {
        return route.continued(index, GUIDE);
    }
    let first = (0..log.valid.len()).find(|&frame| log.valid[frame]).unwrap_or(0);
    let ([x, y], (sin, cos)) = (log.point(first), log.heading[first].sin_cos());
    let ahead = [x + 1.5 * SHORTEST_LOG * cos, y + 1.5 * SHORTEST_LOG * sin];
    Route::new(&[[x, y], ahead]).continued(index, GUIDE)
}

fn is_finite(track: &Track, frame: usize) -> bool {
    let numbers = track.position[frame].iter().chain(&track.velocity[frame]).chain(&track.size[frame]);
    numbers.chain([&track.heading[frame]]).all(|x| x.is_finite())
}

/// A scene with its map index, the ego's route, and its road lines. Cheap to share; build it once a scene.
///
/// ```
/// use std::sync::Arc;
///
/// use sage_core::scene::SceneIndex;
/// use sage_data::procedural::{Kind, generate};
/// use sage_sim::SimScene;
///
/// let scene = Arc::new(generate(Kind::Curve, 1, 0).ok_or("no scene for this seed")?);
/// let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
/// // The way that the ego drove, without its times: what drivers follow.
/// let along = simulated.route().length();
/// assert!(along > 5.0 && simulated.guide().length() >= along);
/// // Another car in the ego's place shares the lines and edges of the map.
/// let other = scene.adversary()?.id.clone();
/// let exchanged = scene.as_ref().clone().with_roles(Some(&other), None)?;
/// assert!(simulated.on_same_map(exchanged.into()).is_ok());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct SimScene {
    scene: Arc<Scene>,
    index: Arc<SceneIndex>,
    route: Route,
    window_length: f64,
    guide: OnceLock<Route>,
    lights: OnceLock<Arc<RouteLights>>,
    ego_size: [f64; 2],
    parked: Vec<bool>,
    lines: Arc<[OnceLock<Lines>; 2]>,
    hitches: [Option<Hitch>; 2],
    recording_leaves: OnceLock<bool>,
}

impl SimScene {
    /// Prepares a scene. `index` is an index of its map.
    ///
    /// *Errors*: [`Error::Scene`] if the ego is not valid at frame 0, where every drive starts, if a valid frame
    /// of a track is not finite, or if the index is of another map.
    pub fn new(scene: Arc<Scene>, index: Arc<SceneIndex>) -> Result<Arc<Self>, Error> {
        Self::of(scene, index, Arc::default())
    }

    /// The same for a scene on the map of this one, such as one with another ego; lines and edges are shared.
    ///
    /// *Errors*: as [`SimScene::new`].
    pub fn on_same_map(&self, scene: Arc<Scene>) -> Result<Arc<Self>, Error> {
        Self::of(scene, self.index.clone(), self.lines.clone())
    }

    fn of(
        scene: Arc<Scene>,
        index: Arc<SceneIndex>,
        lines: Arc<[OnceLock<Lines>; 2]>,
    ) -> Result<Arc<Self>, Error> {
        let ego = scene.ego();
        if !ego.is_valid(0) {
            return Err(Error::Scene {
                scene: scene.id.clone(),
                problem: format!("the ego `{}` is not valid at frame 0, where a drive starts", ego.id),
            });
        }
        if !std::ptr::eq(index.map(), &raw const *scene.map) {
            let problem = "the index is of another map; build it from this scene's".to_owned();
            return Err(Error::Scene { scene: scene.id.clone(), problem });
        }
        for track in &scene.tracks {
            if let Some(frame) = (0..scene.frames).find(|&f| track.is_valid(f) && !is_finite(track, f)) {
                let problem = format!("track `{}` is not finite at frame {frame}", track.id);
                return Err(Error::Scene { scene: scene.id.clone(), problem });
            }
        }
        let route = Route::of_track(ego, 0, false);
        let window_length = if scene.frames <= LAST_FRAME + 1 {
            route.length()
        } else {
            Route::of_frames(ego, 0..=LAST_FRAME, false).length()
        };
        let ego_size = BodyShape::at_now(ego).size.unwrap_or([4.5, 1.9]);
        let hitches =
            [Some(scene.ego), scene.adversary].map(|car| car.and_then(|car| Hitch::of(&scene, car)));
        let parked = scene.tracks.iter().map(Track::is_parked).collect();
        Ok(Arc::new(Self {
            route,
            window_length,
            guide: OnceLock::new(),
            lights: OnceLock::new(),
            ego_size,
            parked,
            lines,
            hitches,
            recording_leaves: OnceLock::new(),
            scene,
            index,
        }))
    }

    /// The recorded scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Search structures of the map.
    pub fn index(&self) -> &Arc<SceneIndex> {
        &self.index
    }

    /// The ego's logged route.
    pub fn route(&self) -> &Route {
        &self.route
    }

    /// Length of the ego's logged route up to the last frame of an episode, metres: what a drive can complete. A longer
    /// recording goes on behind it.
    pub fn window_length(&self) -> f64 {
        self.window_length
    }

    /// The ego's route, continued along the lanes: what policies follow, so that one faster than the log
    /// finds its way.
    pub fn guide(&self) -> &Route {
        self.guide.get_or_init(|| guide(self.log(), &self.index))
    }

    /// The traffic lights on [`SimScene::guide`].
    pub fn lights(&self) -> &Arc<RouteLights> {
        self.lights.get_or_init(|| Arc::new(RouteLights::new(&self.scene, self.guide())))
    }

    /// Length and width of the ego at *now*, metres.
    pub fn ego_size(&self) -> [f64; 2] {
        self.ego_size
    }

    /// Whether the ego's recording leaves the road itself: then the edges of the map cannot be trusted there.
    pub fn recording_leaves_road(&self) -> bool {
        *self.recording_leaves.get_or_init(|| recording_off_road(&self.scene, &self.index).is_some())
    }

    /// What the ego and the adversary tow.
    pub(crate) fn hitches(&self) -> [Option<Hitch>; 2] {
        self.hitches
    }

    /// Whether a track is a parked vehicle ([`Track::is_parked`]).
    pub(crate) fn is_parked(&self, track: usize) -> bool {
        self.parked[track]
    }

    /// Road lines and edges.
    pub fn lines(&self, shapes: LineShapes) -> &Lines {
        let slot = match shapes {
            LineShapes::Exact => &self.lines[0],
            LineShapes::Pieces => &self.lines[1],
        };
        slot.get_or_init(|| Lines::of(&self.scene.map, shapes))
    }

    /// The ego's recording.
    pub fn log(&self) -> &Track {
        self.scene.ego()
    }

    /// Logged position of the ego at a frame, or at the last valid frame before it.
    pub fn logged_position(&self, frame: usize) -> Point {
        let log = self.log();
        let last = (0..=frame.min(log.valid.len() - 1)).rev().find(|&f| log.valid[f]);
        log.point(last.unwrap_or(0))
    }

    /// Whether the map has roads above each other.
    pub(crate) fn has_levels(&self) -> bool {
        self.index.has_levels(LEVEL_GAP)
    }

    /// Height of the ground at a point, for something that was at a height before: that of the nearest lane of
    /// its own level. On a map without levels the height stays.
    pub(crate) fn follow_level(&self, p: Point, before: f64) -> f64 {
        if self.has_levels() { self.index.follow_ground(p, before, LEVEL_GAP) } else { before }
    }

    /// Error about this scene.
    pub fn error(&self, problem: String) -> Error {
        Error::Scene { scene: self.scene.id.clone(), problem }
    }
}
