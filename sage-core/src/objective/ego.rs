//! The ego as an adversary meets it: one path or several with weights.

use super::Convention;
use crate::{
    Error,
    geometry::{OrientedBox, Point},
    motion::{
        HORIZON, NOW, Pose, backward_velocity,
        kinematics::{paper, release},
        trajectory::check_points,
    },
    scene::{Scene, Track},
};

/// Paths that the ego may take, as a caller gives them.
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
    /// are known; `release` never uses them. After its end the ego is not there.
    ///
    /// *Errors*: as [`EgoPaths::and`].
    pub fn one(what: &str, positions: Vec<Point>, headings: Option<Vec<f64>>) -> Result<Self, Error> {
        Self(Vec::new()).and(what, 1.0, positions, headings)
    }

    /// With one path more, and its weight > 0 beside the others'.
    ///
    /// *Errors*: [`Error::Length`] for no position or more than 80, or as many headings as there are not
    /// positions; [`Error::NotFinite`] for a coordinate, [`Error::Options`] for a weight that is none.
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

/// A path of the ego made ready for a context's convention and sizes.
pub struct EgoPath {
    weight: f64,
    start: Point,
    positions: Vec<Point>,
    boxes: Vec<Option<OrientedBox>>,
}

impl EgoPath {
    /// Its weight among the paths of a context; they sum to 1.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Positions, step 1 first; a gap in a log repeats the last one. At most 80.
    pub fn positions(&self) -> &[Point] {
        &self.positions
    }

    /// Boxes of all 80 steps; `None` where the ego is not there: a gap in its log, or past the path's end.
    pub fn boxes(&self) -> &[Option<OrientedBox>] {
        &self.boxes
    }

    /// Its box at a step, 1 to 80.
    pub fn box_at(&self, step: usize) -> Option<&OrientedBox> {
        self.boxes[step - 1].as_ref()
    }

    /// Its velocity at a step, 1 to 80, by backward difference, m/s; `None` at a gap.
    pub fn velocity(&self, step: usize) -> Option<Point> {
        let seen = self.boxes[step - 1].is_some() && (step == 1 || self.boxes[step - 2].is_some());
        seen.then(|| backward_velocity(&self.positions, self.start, step))
    }
}

/// Which readings of paths a context asks for.
#[derive(Clone, Copy)]
pub(super) struct Reading {
    pub convention: Convention,
    /// Length and width of the ego, metres.
    pub size: [f64; 2],
}

/// The given paths, or the logged one, made ready.
///
/// *Errors*: [`Error::Scene`] if none was given and the log has none.
pub(super) fn ready(
    given: Option<&EgoPaths>,
    scene: &Scene,
    reading: Reading,
) -> Result<Vec<EgoPath>, Error> {
    let Some(EgoPaths(given)) = given else { return Ok(vec![logged(scene, reading)?]) };
    let total: f64 = given.iter().map(|path| path.weight).sum();
    let ready = |path: &GivenPath| {
        let boxes = boxes(&path.positions, path.headings.as_deref(), scene.ego(), reading);
        let mut boxes: Vec<_> = boxes.into_iter().map(Some).collect();
        boxes.resize(HORIZON, None);
        EgoPath {
            weight: path.weight / total,
            start: scene.ego().point(NOW),
            positions: path.positions.clone(),
            boxes,
        }
    };
    Ok(given.iter().map(ready).collect())
}

/// Boxes along a whole path, with headings by the convention's rule where none are given.
fn boxes(
    positions: &[Point],
    headings: Option<&[f64]>,
    track: &Track,
    Reading { convention, size: [length, width] }: Reading,
) -> Vec<OrientedBox> {
    let axes = match (convention, headings) {
        (Convention::Release, _) => release::axes(&release::headings(positions)),
        (Convention::Paper, Some(headings)) => release::axes(headings),
        (Convention::Paper, None) => {
            let start = Pose { position: track.point(NOW), heading: track.heading[NOW] };
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

/// The logged ego; a gap repeats the last valid position and has no box.
fn logged(scene: &Scene, reading: Reading) -> Result<EgoPath, Error> {
    let ego = scene.ego();
    let fail = |problem: String| Err(Error::Scene { scene: scene.id.clone(), problem });
    if scene.frames <= NOW + HORIZON {
        return fail(format!(
            "it ends at frame {}, but the logged ego path needs frames {} to {}; give an `ego` path with each candidate",
            scene.frames - 1,
            NOW + 1,
            NOW + HORIZON
        ));
    }
    if ego.count_valid(NOW + 1..NOW + HORIZON + 1) == 0 {
        return fail(format!(
            "ego `{}` is not seen after frame {NOW}; give an `ego` path with each candidate",
            ego.id
        ));
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
    let boxes = boxes(&positions, Some(&headings), ego, reading);
    let seen = boxes.into_iter().zip(NOW + 1..).map(|(b, frame)| ego.is_valid(frame).then_some(b)).collect();
    Ok(EgoPath { weight: 1.0, start: ego.point(NOW), positions, boxes: seen })
}
