//! A trajectory with the derived quantities that every objective needs, computed once.

use super::{Body, Convention, others::CHUNK};
use crate::{
    geometry::{Aabb, OrientedBox, Point},
    motion::{
        HORIZON, Pose, Trajectory, backward_velocity,
        kinematics::{Profile, paper, release},
    },
};

/// A planned trajectory of the adversary, prepared for evaluation.
#[derive(Clone)]
pub struct Candidate {
    trajectory: Trajectory,
    profile: Profile,
    start: Pose,
    nll: Option<f64>,
    boxes: Vec<OrientedBox>,
    mirrored: Option<Vec<OrientedBox>>,
    bounds: Aabb,
    chunks: [Aabb; HORIZON / CHUNK],
}

impl Candidate {
    pub(super) fn new(trajectory: Trajectory, start: Pose, body: &Body, horizon: usize) -> Self {
        let ([length, width], mirror) = (body.size, body.mirrored);
        let points = &trajectory.points()[..horizon];
        let profile = match body.convention {
            Convention::Paper => paper::profile(points, &start),
            Convention::Release => release::profile(points),
        };
        let boxes: Vec<OrientedBox> = points
            .iter()
            .zip(&profile.axis)
            .map(|(&center, &axis)| OrientedBox {
                center,
                axis,
                half_length: 0.5 * length,
                half_width: 0.5 * width,
            })
            .collect();
        let mirrored: Option<Vec<OrientedBox>> =
            mirror.then(|| boxes.iter().map(OrientedBox::mirrored).collect());
        let chunks = chunks(mirrored.as_ref().unwrap_or(&boxes));
        let bounds = chunks.iter().fold(Aabb::EMPTY, |all, chunk| all.union(chunk));
        Self { trajectory, profile, start, nll: None, boxes, mirrored, bounds, chunks }
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

/// Bounds of boxes over each group of [`CHUNK`] steps.
fn chunks(boxes: &[OrientedBox]) -> [Aabb; HORIZON / CHUNK] {
    let mut chunks = [Aabb::EMPTY; HORIZON / CHUNK];
    for (step, b) in boxes.iter().enumerate() {
        chunks[step / CHUNK] = chunks[step / CHUNK].union(&b.aabb());
    }
    chunks
}
