//! What scoring needs of a scene, built once for all its candidates.

use super::{Candidate, Convention, OtherAgent, Sizes};
use crate::{
    Error,
    geometry::{OrientedBox, Point, distance},
    motion::{
        DT, HORIZON, NOW, Start, Trajectory,
        kinematics::{paper, release},
    },
    scene::{Scene, SceneIndex, Track},
};

/// Other agents that the published code sees: its table has 128 rows, two of them ego and adversary.
const RELEASE_AGENTS: usize = 126;

/// How a context is built.
#[derive(Clone, Debug, Default)]
pub struct ContextOptions {
    /// Which reading of the formulas.
    pub convention: Convention,
    /// Sizes of ego and adversary.
    pub sizes: Sizes,
    /// The ego's path; the logged one if `None`.
    pub ego: Option<EgoPath>,
    /// Whether boxes are mirrored against map and agents; by default in `release` alone.
    pub mirrored_boxes: Option<bool>,
}

/// A path of the ego over the 80 future steps.
#[derive(Clone, Debug, PartialEq)]
pub struct EgoPath {
    /// Its positions.
    pub positions: Trajectory,
    /// Its headings, rad, if known; `release` never uses them.
    pub headings: Option<Vec<f64>>,
}

/// A scene from the point of view of one adversary and one ego path.
pub struct Context<'s> {
    scene: &'s Scene,
    index: &'s SceneIndex,
    adversary: usize,
    convention: Convention,
    mirrored: bool,
    start: Option<Start>,
    /// Heading of the valid frame of history nearest to now.
    last_heading: f64,
    size: [f64; 2],
    ego_size: [f64; 2],
    ego_start: Point,
    ego_positions: Vec<Point>,
    ego_boxes: Vec<Option<OrientedBox>>,
    others: Vec<OtherAgent>,
}

impl<'s> Context<'s> {
    /// Prepares a scene for scoring.
    ///
    /// *Errors*: [`Error::Scene`] if there is no adversary, or no ego path was given and the scene
    /// ends before frame 90 or does not show the ego after frame 10.
    pub fn new(scene: &'s Scene, index: &'s SceneIndex, options: &ContextOptions) -> Result<Self, Error> {
        let adversary = scene.adversary_index()?;
        let adversary_track = &scene.tracks[adversary];
        let ContextOptions { convention, sizes, ego, mirrored_boxes } = options;
        let mirrored = mirrored_boxes.unwrap_or(*convention == Convention::Release);
        let (ego_size, size) = sizes.of(scene, adversary);
        let ego_track = scene.ego();
        let (ego_positions, ego_boxes) = match ego {
            Some(path) => {
                let positions = path.positions.points().to_vec();
                let boxes = ego_boxes(&positions, path.headings.as_deref(), ego_track, *convention, ego_size);
                (positions, boxes.into_iter().map(Some).collect())
            }
            None => logged_ego(scene, *convention, ego_size)?,
        };
        let others = scene
            .tracks
            .iter()
            .enumerate()
            .filter(|(k, _)| *k != scene.ego && *k != adversary)
            .map(|(k, track)| OtherAgent::new(k, track, mirrored))
            .collect();
        let start = adversary_track
            .is_valid(NOW)
            .then(|| Start { position: adversary_track.point(NOW), heading: adversary_track.heading[NOW] });
        let seen = (0..adversary_track.valid.len()).filter(|&f| adversary_track.is_valid(f));
        let nearest = seen.min_by_key(|f| (*f > NOW, f.abs_diff(NOW)));
        let last_heading = nearest.map_or(0.0, |frame| adversary_track.heading[frame]);
        Ok(Self {
            scene,
            index,
            adversary,
            convention: *convention,
            mirrored,
            start,
            last_heading,
            size,
            ego_size,
            ego_start: ego_track.point(NOW),
            ego_positions,
            ego_boxes,
            others,
        })
    }

    /// Prepares a trajectory for scoring. Where the adversary is not valid *now*, its position is
    /// extrapolated from the first two planned points, and so is its heading if they move; if not,
    /// it is the last that was seen.
    pub fn candidate(&self, trajectory: Trajectory) -> Candidate {
        let start = self.start.unwrap_or_else(|| {
            let [a, b] = [trajectory.points()[0], trajectory.points()[1]];
            let position = [2.0 * a[0] - b[0], 2.0 * a[1] - b[1]];
            let moves = distance(a, b) / DT >= paper::MOVING;
            let heading = if moves { (b[1] - a[1]).atan2(b[0] - a[0]) } else { self.last_heading };
            Start { position, heading }
        });
        Candidate::new(trajectory, start, self.size, self.convention, self.mirrored)
    }

    /// The scene.
    pub fn scene(&self) -> &'s Scene {
        self.scene
    }

    /// The map's search trees.
    pub fn index(&self) -> &'s SceneIndex {
        self.index
    }

    /// The adversary's logged track.
    pub fn adversary(&self) -> &'s Track {
        &self.scene.tracks[self.adversary]
    }

    /// Which reading of the formulas.
    pub fn convention(&self) -> Convention {
        self.convention
    }

    /// The ego's positions, step 1 first; a gap in its log repeats the last one.
    pub fn ego_positions(&self) -> &[Point] {
        &self.ego_positions
    }

    /// Length and width of the adversary, metres.
    pub fn size(&self) -> [f64; 2] {
        self.size
    }

    /// Length and width of the ego, metres.
    pub fn ego_size(&self) -> [f64; 2] {
        self.ego_size
    }

    /// The ego's box at a step, 1 to 80; `None` where the log has a gap.
    pub fn ego_box(&self, step: usize) -> Option<&OrientedBox> {
        self.ego_boxes[step - 1].as_ref()
    }

    /// The ego's boxes, step 1 first.
    pub fn ego_boxes(&self) -> &[Option<OrientedBox>] {
        &self.ego_boxes
    }

    /// The ego's velocity at a step, 1 to 80, by backward difference, m/s; `None` at a gap.
    pub fn ego_velocity(&self, step: usize) -> Option<Point> {
        let seen = self.ego_boxes[step - 1].is_some() && (step == 1 || self.ego_boxes[step - 2].is_some());
        seen.then(|| velocity(&self.ego_positions, self.ego_start, step))
    }

    /// The other road users, in the order of the file.
    pub fn others(&self) -> &[OtherAgent] {
        &self.others
    }

    /// Those of them that the convention's frame-by-frame rule knows of: all, or the published
    /// code's first 126.
    pub(super) fn known_others(&self) -> &[OtherAgent] {
        match self.convention {
            Convention::Paper => &self.others,
            Convention::Release => &self.others[..self.others.len().min(RELEASE_AGENTS)],
        }
    }
}

/// Backward difference of a path at a step, 1 to its length, m/s.
pub(super) fn velocity(points: &[Point], start: Point, step: usize) -> Point {
    let before = if step == 1 { start } else { points[step - 2] };
    let now = points[step - 1];
    [(now[0] - before[0]) / DT, (now[1] - before[1]) / DT]
}

/// Boxes along a whole path, with headings by the convention's rule where none are given.
fn ego_boxes(
    positions: &[Point],
    headings: Option<&[f64]>,
    track: &Track,
    convention: Convention,
    [length, width]: [f64; 2],
) -> Vec<OrientedBox> {
    let axes = match (convention, headings) {
        (Convention::Release, _) => release::axes(&release::headings(positions)),
        (Convention::Paper, Some(headings)) => release::axes(headings),
        (Convention::Paper, None) => {
            let start = Start { position: track.point(NOW), heading: track.heading[NOW] };
            paper::profile(positions, &start).axis
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

/// Positions and boxes of the logged ego; a gap repeats the last valid position and has no box.
fn logged_ego(
    scene: &Scene,
    convention: Convention,
    size: [f64; 2],
) -> Result<(Vec<Point>, Vec<Option<OrientedBox>>), Error> {
    let ego = scene.ego();
    if scene.frames <= NOW + HORIZON {
        return Err(Error::Scene {
            scene: scene.id.clone(),
            problem: format!(
                "it ends at frame {}, but the logged ego path needs frames {} to {}; give an `ego` path with each candidate",
                scene.frames - 1,
                NOW + 1,
                NOW + HORIZON
            ),
        });
    }
    if ego.count_valid(NOW + 1..NOW + HORIZON + 1) == 0 {
        return Err(Error::Scene {
            scene: scene.id.clone(),
            problem: format!(
                "ego `{}` is not seen after frame {NOW}; give an `ego` path with each candidate",
                ego.id
            ),
        });
    }
    let mut last = ego.point(NOW);
    let mut headings = Vec::with_capacity(HORIZON);
    let positions: Vec<Point> = (NOW + 1..=NOW + HORIZON)
        .map(|frame| {
            if ego.is_valid(frame) {
                last = ego.point(frame);
            }
            headings.push(ego.heading[frame]);
            last
        })
        .collect();
    let boxes = ego_boxes(&positions, Some(&headings), ego, convention, size);
    let seen = boxes.into_iter().zip(NOW + 1..).map(|(b, frame)| ego.is_valid(frame).then_some(b)).collect();
    Ok((positions, seen))
}
