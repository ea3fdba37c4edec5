//! The ego in an encounter: one path or several weighted paths.

use std::sync::Arc;

use super::{Candidate, Convention, ground::Ground};
use crate::{
    Error,
    geometry::{OrientedBox, Point},
    motion::{
        HORIZON, NOW, Pose, backward_velocity, check_path,
        kinematics::{paper, release},
        trajectory::check_points,
    },
    scene::{Scene, SceneIndex, Track},
};

/// Possible paths of the ego, as given by the caller.
///
/// In place of the recording in `ctx`, an ego that goes on at 10 m/s, or, three times as likely, stops within 10 m:
///
/// ```
/// # use std::sync::Arc;
/// # use sage_core::{objective::{Context, ContextOptions}, scene::SceneIndex};
/// use sage_core::objective::{EgoPath, EgoPaths};
///
/// # let scene = Arc::new(include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/road.rs")));
/// # let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// let braking = |t: f64| if t < 2.0 { 10.0 * t - 2.5 * t * t } else { 10.0 };
/// let path = |at: &dyn Fn(f64) -> f64| (1..=80).map(|step| [at(0.1 * f64::from(step)), 0.0]).collect();
/// let paths = EgoPaths::one("goes on", path(&|t| 10.0 * t), None)?.and("stops", 3.0, path(&braking), None)?;
///
/// // Objectives are means over the paths, by weights that sum to 1.
/// let ctx = ctx.with_ego(&paths)?;
/// assert_eq!(ctx.egos().iter().map(EgoPath::weight).collect::<Vec<_>>(), [0.25, 0.75]);
/// # Ok::<(), sage_core::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct EgoPaths(Vec<GivenPath>);

#[derive(Clone, Debug, PartialEq)]
struct GivenPath {
    weight: f64,
    positions: Vec<Point>,
    headings: Option<Vec<f64>>,
}

impl EgoPaths {
    /// One path: 1 to 80 positions from frame 11 on (metres, world frame), and its headings (rad) if they
    /// are known; `release` never uses them. After its end the ego is absent.
    ///
    /// *Errors*: as [`EgoPaths::and`].
    pub fn one(what: &str, positions: Vec<Point>, headings: Option<Vec<f64>>) -> Result<Self, Error> {
        Self(Vec::new()).and(what, 1.0, positions, headings)
    }

    /// Adds a path with a weight > 0, relative to the others.
    ///
    /// *Errors*: [`Error::Options`] for no position, for more than 80, or for a weight that is not above 0;
    /// [`Error::Length`] for a number of headings other than the number of positions; [`Error::NotFinite`]
    /// for a coordinate or heading; [`Error::TooLong`] for a step beyond [`crate::motion::MAX_STEP`].
    pub fn and(
        mut self,
        what: &str,
        weight: f64,
        positions: Vec<Point>,
        headings: Option<Vec<f64>>,
    ) -> Result<Self, Error> {
        let length = |found, expected| Error::Length { what: what.to_owned(), found, expected };
        if positions.is_empty() || positions.len() > HORIZON {
            let problem = format!("{what} has {} points; expected 1 to {HORIZON}", positions.len());
            return Err(Error::Options { kind: "ego path", name: "positions", problem });
        }
        check_points(what, &positions)?;
        if let Some(headings) = &headings {
            if headings.len() != positions.len() {
                return Err(length(headings.len(), positions.len()));
            }
            if let Some(index) = headings.iter().position(|heading| !heading.is_finite()) {
                let point = [headings[index], 0.0];
                return Err(Error::NotFinite { what: format!("{what}: headings"), index, point });
            }
        }
        if !(weight > 0.0 && weight.is_finite()) {
            let problem = format!("{what} has weight {weight}; expected a finite number above 0");
            return Err(Error::Options { kind: "ego path", name: "weight", problem });
        }
        self.0.push(GivenPath { weight, positions, headings });
        Ok(self)
    }
}

/// A path of the ego, prepared for a context's convention and sizes.
pub struct EgoPath {
    weight: f64,
    start: Point,
    positions: Vec<Point>,
    boxes: Vec<Option<OrientedBox>>,
    ground: Ground,
}

impl EgoPath {
    /// Weight of the path; the weights of a context sum to 1.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Positions, step 1 first, at most 80. A gap in a log repeats the last position.
    pub fn positions(&self) -> &[Point] {
        &self.positions
    }

    /// Boxes of all 80 steps; `None` where the ego is absent: at a gap in its log or after the path's end.
    pub fn boxes(&self) -> &[Option<OrientedBox>] {
        &self.boxes
    }

    /// Box at a step, 1 to 80.
    pub fn box_at(&self, step: usize) -> Option<&OrientedBox> {
        self.boxes[step - 1].as_ref()
    }

    /// Whether a candidate is on its level at a step. The published code has one level.
    pub fn is_on_level_of(&self, candidate: &Candidate, step: usize) -> bool {
        if candidate.convention() == Convention::Release {
            return true;
        }
        let ground = self.ground.at(step, || self.positions.iter().copied());
        ground.is_none_or(|height| candidate.is_on_level(step, height))
    }

    /// Velocity at a step, 1 to 80, by backward difference, m/s; `None` at a gap.
    pub fn velocity(&self, step: usize) -> Option<Point> {
        let present = self.boxes[step - 1].is_some() && (step == 1 || self.boxes[step - 2].is_some());
        present.then(|| backward_velocity(&self.positions, self.start, step))
    }
}

/// Convention and ego size of a context.
#[derive(Clone, Copy)]
pub(super) struct PathOptions {
    pub convention: Convention,
    /// Length and width of the ego, metres.
    pub size: [f64; 2],
}

/// Prepares the given paths, or the logged one.
///
/// *Errors*: [`Error::Scene`] if no path is given and the log has none, or if a given path begins farther from the
/// ego than [`crate::motion::MAX_STEP`].
pub(super) fn prepare(
    given: Option<&EgoPaths>,
    scene: &Scene,
    index: &Arc<SceneIndex>,
    options: PathOptions,
) -> Result<Vec<EgoPath>, Error> {
    let Some(EgoPaths(given)) = given else { return Ok(vec![logged(scene, index, options)?]) };
    let total: f64 = given.iter().map(|path| path.weight).sum();
    if !total.is_finite() {
        let problem = format!("the weights sum to {total}; expected a finite sum");
        return Err(Error::Options { kind: "ego path", name: "weight", problem });
    }
    let start = scene.ego().point(NOW);
    for path in given {
        check_path([(0, start), (1, path.positions[0])]).map_err(|problem| Error::Scene {
            scene: scene.id.clone(),
            problem: format!("the first position of the given ego path {problem}, that of frame {NOW}"),
        })?;
    }
    let prepare = |path: &GivenPath| {
        let boxes = boxes(&path.positions, path.headings.as_deref(), scene.ego(), options);
        let mut boxes: Vec<_> = boxes.into_iter().map(Some).collect();
        boxes.resize(HORIZON, None);
        let ground = Ground::from_now(index, scene.ego().ground(NOW));
        EgoPath { weight: path.weight / total, start, positions: path.positions.clone(), boxes, ground }
    };
    Ok(given.iter().map(prepare).collect())
}

/// Boxes along a whole path, with headings by the convention's rule where none are given.
fn boxes(
    positions: &[Point],
    headings: Option<&[f64]>,
    track: &Track,
    PathOptions { convention, size: [length, width] }: PathOptions,
) -> Vec<OrientedBox> {
    let axes = match (convention, headings) {
        (Convention::Release, _) => release::axes(&release::headings(positions)),
        (Convention::Paper, Some(headings)) => release::axes(headings),
        (Convention::Paper, None) => {
            let start = Pose { position: track.point(NOW), heading: track.heading[NOW] };
            paper::profile_from(positions, &start, track.reverses(NOW)).axis
        }
    };
    let half = [0.5 * length, 0.5 * width];
    let at = |(&center, axis): (&Point, Point)| OrientedBox {
        center,
        axis,
        half_length: half[0],
        half_width: half[1],
    };
    positions.iter().zip(axes).map(at).collect()
}

/// The logged ego path; a gap repeats the last valid position and has no box.
fn logged(scene: &Scene, index: &Arc<SceneIndex>, options: PathOptions) -> Result<EgoPath, Error> {
    let ego = scene.ego();
    let fail = |problem: String| Err(Error::Scene { scene: scene.id.clone(), problem });
    let frames = NOW + 1..NOW + scene.horizon() + 1;
    if ego.count_valid(frames.clone()) == 0 {
        return fail(format!(
            "ego `{}` has no valid frame after frame {NOW}; give an `ego` path with each candidate",
            ego.id
        ));
    }
    let (mut last, mut height) = (ego.point(NOW), ego.ground(NOW));
    let mut headings = Vec::with_capacity(frames.len());
    let mut heights = vec![height];
    let positions: Vec<Point> = frames
        .map(|frame| {
            if ego.is_valid(frame) {
                (last, height) = (ego.point(frame), ego.ground(frame));
            }
            heights.push(height);
            headings.push(ego.heading[frame]);
            last
        })
        .collect();
    let boxes = boxes(&positions, Some(&headings), ego, options);
    let mut present: Vec<Option<OrientedBox>> =
        boxes.into_iter().zip(NOW + 1..).map(|(b, frame)| ego.is_valid(frame).then_some(b)).collect();
    present.resize(HORIZON, None);
    let ground = Ground::recorded(index, heights.into());
    Ok(EgoPath { weight: 1.0, start: ego.point(NOW), positions, boxes: present, ground })
}
