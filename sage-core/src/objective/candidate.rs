//! A trajectory with the derived quantities that every objective needs, computed once.

use std::ops::RangeInclusive;

use super::{Convention, ground::Ground, others::CHUNK};
use crate::{
    geometry::{Aabb, OrientedBox, Point, dot, wrap_angle},
    motion::{
        DT, HORIZON, Pose, Trajectory, backward_velocity,
        kinematics::{Profile, paper, release},
    },
    scene::is_one_level,
};

/// The car that drives a trajectory.
#[derive(Clone, Copy, Debug)]
pub(super) struct Car {
    /// Length and width, metres.
    pub(super) size: [f64; 2],
    pub(super) convention: Convention,
    pub(super) mirrored: bool,
    /// Whether it drives backwards *now*.
    pub(super) reverses: bool,
}

/// A planned trajectory of the adversary, prepared for evaluation.
///
/// A [`Context`](super::Context) makes one of a trajectory:
///
/// ```
/// # use std::sync::Arc;
/// # use sage_core::{motion::Trajectory, objective::{Context, ContextOptions}, scene::SceneIndex};
/// # let scene = Arc::new(include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/road.rs")));
/// # let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// // The adversary goes on from (20, 4) at 8 m/s.
/// let plan = (1..=80).map(|step| [20.0 + 0.8 * f64::from(step), 4.0]).collect();
/// let candidate = ctx.candidate(Trajectory::new("plan", plan)?);
/// assert!(candidate.profile().speed.iter().all(|speed| (speed - 8.0).abs() < 1e-9));
/// // Boxes belong to steps 1 to the horizon; the first is 0.1 s after *now*.
/// assert_eq!(candidate.boxes().len(), candidate.horizon());
/// assert_eq!(candidate.boxes()[0].center, [20.8, 4.0]);
/// # Ok::<(), sage_core::Error>(())
/// ```
#[derive(Clone)]
pub struct Candidate {
    trajectory: Trajectory,
    profile: Profile,
    start: Pose,
    convention: Convention,
    nll: Option<f64>,
    boxes: Vec<OrientedBox>,
    mirrored: Option<Vec<OrientedBox>>,
    bounds: Aabb,
    chunks: [Aabb; HORIZON / CHUNK],
    /// Height of the ground under it; `None` without a map.
    ground: Option<Ground>,
}

impl Candidate {
    pub(super) fn new(
        trajectory: Trajectory,
        start: Pose,
        car: &Car,
        horizon: usize,
        ground: Option<Ground>,
    ) -> Self {
        let mirror = car.mirrored;
        let points = &trajectory.points()[..horizon];
        let profile = match car.convention {
            Convention::Paper => paper::profile_from(points, &start, car.reverses),
            Convention::Release => release::profile(points),
        };
        let boxes = boxes(points, &profile.axis, car.size);
        let mirrored: Option<Vec<OrientedBox>> =
            mirror.then(|| boxes.iter().map(OrientedBox::mirrored).collect());
        let chunks = chunks(mirrored.as_ref().unwrap_or(&boxes));
        let bounds = chunks.iter().fold(Aabb::EMPTY, |all, chunk| all.union(chunk));
        Self {
            trajectory,
            profile,
            start,
            convention: car.convention,
            nll: None,
            boxes,
            mirrored,
            bounds,
            chunks,
            ground,
        }
    }

    /// The candidate with other headings, rad, of a recording in which the car drives backwards.
    pub(super) fn with_headings(mut self, headings: &[f64], size: [f64; 2]) -> Self {
        let headings = &headings[..self.horizon()];
        let before = std::iter::once(&headings[0]).chain(headings);
        let turns = headings.iter().zip(before).map(|(now, before)| wrap_angle(now - before));
        let profile = &mut self.profile;
        profile.yaw_rate = turns.clone().map(|turn| turn / DT).collect();
        profile.total_turn = turns.sum();
        profile.axis = release::axes(headings);
        profile.heading = headings.iter().map(|heading| wrap_angle(*heading)).collect();
        self.boxes = boxes(&self.trajectory.points()[..headings.len()], &self.profile.axis, size);
        self.mirrored = self.mirrored.map(|_| self.boxes.iter().map(OrientedBox::mirrored).collect());
        self.chunks = chunks(self.map_boxes());
        self.bounds = self.chunks.iter().fold(Aabb::EMPTY, |all, chunk| all.union(chunk));
        self
    }

    /// The candidate with its negative log-likelihood under the prior, nats, if the proposer computed it.
    pub fn with_nll(self, nll: Option<f64>) -> Self {
        Self { nll, ..self }
    }

    /// Negative log-likelihood under the prior, nats, up to a constant that the candidates of a scene
    /// share.
    pub fn nll(&self) -> Option<f64> {
        self.nll
    }

    /// The planned positions, all 80.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// Number of steps that are evaluated: the context's horizon. Boxes and profile have this length.
    pub fn horizon(&self) -> usize {
        self.boxes.len()
    }

    /// Convention of its profile.
    pub fn convention(&self) -> Convention {
        self.convention
    }

    /// The steps that are evaluated, 1 to the horizon. Loops run over them, never to 80, so that a shorter recording has no
    /// step too many.
    pub fn steps(&self) -> RangeInclusive<usize> {
        1..=self.horizon()
    }

    /// The evaluated steps before another one; all without it.
    pub(super) fn steps_before(&self, step: Option<usize>) -> RangeInclusive<usize> {
        1..=step.map_or(self.horizon(), |step| (step - 1).min(self.horizon()))
    }

    /// Whether a height of the ground (metres) is that of its level at a step, 0 (*now*) to the horizon. A trajectory has
    /// no height: it follows the lanes of its level.
    pub(super) fn is_on_level(&self, step: usize, height: f64) -> bool {
        self.ground.as_ref().is_none_or(|ground| {
            ground
                .at(step, || self.boxes.iter().map(|b| b.center))
                .is_none_or(|own| is_one_level(own, height))
        })
    }

    /// First step at which it turns by more than 90° since the step before, which no car can: it goes back without
    /// reversing, or begins in another direction than its front. The published code has no heading *now*.
    pub fn half_turn(&self) -> Option<usize> {
        if self.convention == Convention::Release {
            return None;
        }
        let (sin, cos) = self.start.heading.sin_cos();
        let mut before = [cos, sin];
        self.steps().find(|step| {
            let axis = self.profile.axis[step - 1];
            dot(std::mem::replace(&mut before, axis), axis) < 0.0
        })
    }

    /// The planned positions of the evaluated steps.
    pub fn points(&self) -> &[Point] {
        &self.trajectory.points()[..self.horizon()]
    }

    /// The trajectory, without the derived quantities.
    pub fn into_trajectory(self) -> Trajectory {
        self.trajectory
    }

    /// Speed, heading and the other quantities, by the context's convention.
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// Pose at *now*.
    pub fn start(&self) -> &Pose {
        &self.start
    }

    /// Boxes of steps 1 to the horizon for tests against the ego.
    pub fn boxes(&self) -> &[OrientedBox] {
        &self.boxes
    }

    /// The box at *now*.
    pub fn box_now(&self) -> OrientedBox {
        let (sin, cos) = self.start.heading.sin_cos();
        OrientedBox { center: self.start.position, axis: [cos, sin], ..self.boxes[0] }
    }

    /// Boxes of steps 1 to the horizon for tests against the map and other agents. They equal [`Candidate::boxes`],
    /// except for the published code's mirrored boxes.
    pub fn map_boxes(&self) -> &[OrientedBox] {
        self.mirrored.as_ref().unwrap_or(&self.boxes)
    }

    /// Bounds of the boxes, never mirrored, over each group of [`CHUNK`] steps.
    pub(super) fn true_chunks(&self) -> [Aabb; HORIZON / CHUNK] {
        if self.mirrored.is_none() { self.chunks } else { chunks(&self.boxes) }
    }

    /// Velocity at a step, 1 to 80, by backward difference, m/s.
    pub fn velocity(&self, step: usize) -> Point {
        backward_velocity(self.trajectory.points(), self.start.position, step)
    }

    /// Bounds of all map boxes.
    pub(super) fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    /// Bounds of the map boxes over each group of [`CHUNK`] steps.
    pub(super) fn chunks(&self) -> &[Aabb; HORIZON / CHUNK] {
        &self.chunks
    }
}

/// Boxes of a length and width along a path.
fn boxes(points: &[Point], axes: &[Point], [length, width]: [f64; 2]) -> Vec<OrientedBox> {
    let at = |(&center, &axis): (&Point, &Point)| OrientedBox {
        center,
        axis,
        half_length: 0.5 * length,
        half_width: 0.5 * width,
    };
    points.iter().zip(axes).map(at).collect()
}

/// Bounds of boxes over each group of [`CHUNK`] steps.
fn chunks(boxes: &[OrientedBox]) -> [Aabb; HORIZON / CHUNK] {
    let mut chunks = [Aabb::EMPTY; HORIZON / CHUNK];
    for (step, b) in boxes.iter().enumerate() {
        chunks[step / CHUNK] = chunks[step / CHUNK].union(&b.aabb());
    }
    chunks
}
