//! A recorded scene, prepared for simulation: everything that does not change while it runs.

use std::sync::{Arc, OnceLock};

use sage_core::{
    Error,
    geometry::Point,
    scene::{Scene, SceneIndex, Track},
};

use crate::{
    body::{BodyShape, is_parked},
    lines::{LineShapes, Lines},
    route::Route,
};

/// Length by which the route of a policy reaches beyond the log, metres.
pub(crate) const GUIDE: f64 = 200.0;

/// A scene with its map index, the ego's route, and its road lines. Cheap to share; build it once a scene.
pub struct SimScene {
    scene: Arc<Scene>,
    index: Arc<SceneIndex>,
    route: Route,
    guide: OnceLock<Route>,
    ego_size: [f64; 2],
    parked: Vec<bool>,
    lines: [OnceLock<Lines>; 2],
}

impl SimScene {
    /// Prepares a scene. `index` is an index of its map.
    ///
    /// *Errors*: [`Error::Scene`] if the ego is not valid at frame 0, where every drive starts.
    pub fn new(scene: Arc<Scene>, index: Arc<SceneIndex>) -> Result<Arc<Self>, Error> {
        let ego = scene.ego();
        if !ego.is_valid(0) {
            return Err(Error::Scene {
                scene: scene.id.clone(),
                problem: format!("the ego `{}` is not valid at frame 0, where a drive starts", ego.id),
            });
        }
        let route = Route::of_track(ego, 0, false);
        let ego_size = BodyShape::at_now(ego).size.unwrap_or([4.5, 1.9]);
        let parked = scene.tracks.iter().map(is_parked).collect();
        Ok(Arc::new(Self {
            route,
            guide: OnceLock::new(),
            ego_size,
            parked,
            lines: Default::default(),
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

    /// The ego's route, continued along the lanes: what policies follow, so that one faster than the log
    /// finds its way.
    pub fn guide(&self) -> &Route {
        self.guide.get_or_init(|| self.route.continued(&self.index, GUIDE))
    }

    /// Length and width of the ego at *now*, metres.
    pub fn ego_size(&self) -> [f64; 2] {
        self.ego_size
    }

    /// Whether a track is a parked vehicle ([`is_parked`]).
    pub fn is_parked(&self, track: usize) -> bool {
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

    /// Error about this scene.
    pub(crate) fn error(&self, problem: String) -> Error {
        Error::Scene { scene: self.scene.id.clone(), problem }
    }
}
