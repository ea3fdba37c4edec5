//! The other road users, besides ego and adversary, over the future.

use crate::{
    geometry::{Aabb, OrientedBox, bounds_between, distance},
    motion::{HORIZON, NOW},
    scene::{Track, TrackKind},
};

/// Number of steps whose bounds are tested together.
pub(super) const CHUNK: usize = 8;
/// Largest distance of a static vehicle from its first valid position, metres.
const STATIC: f64 = 1.0;

/// Logged boxes of one road user, step 0 (*now*) to 80.
pub struct OtherAgent {
    /// Index of its track in the scene.
    pub track: usize,
    /// Whether it is a vehicle.
    pub is_vehicle: bool,
    /// Whether it is a standing vehicle: its valid positions from *now* on stay within 1 m.
    pub is_static: bool,
    boxes: Vec<Option<OrientedBox>>,
    /// Boxes with the published code's orientation against the map; only in `release`.
    mirrored: Option<Vec<Option<OrientedBox>>>,
    /// Bounds of the map boxes.
    bounds: Aabb,
    chunks: [Aabb; HORIZON / CHUNK],
    /// Bounds of the true boxes of each group, with the step before it and the motion between, and of all.
    swept_chunks: [Aabb; HORIZON / CHUNK],
    swept_bounds: Aabb,
}

impl OtherAgent {
    /// Boxes of a track; with `mirror` also in the published code's orientation.
    pub(super) fn new(index: usize, track: &Track, mirror: bool) -> Self {
        let frames = NOW..=NOW + HORIZON;
        let boxes: Vec<Option<OrientedBox>> =
            frames.clone().map(|frame| track.is_valid(frame).then(|| track.oriented_box(frame))).collect();
        let mirrored: Option<Vec<_>> =
            mirror.then(|| boxes.iter().map(|b| b.as_ref().map(OrientedBox::mirrored)).collect());
        let mut chunks = [Aabb::EMPTY; HORIZON / CHUNK];
        for (step, agent) in mirrored.as_ref().unwrap_or(&boxes).iter().enumerate().skip(1) {
            if let Some(agent) = agent {
                let chunk = &mut chunks[(step - 1) / CHUNK];
                *chunk = chunk.union(&agent.aabb());
            }
        }
        let mut swept_chunks = [Aabb::EMPTY; HORIZON / CHUNK];
        for (chunk, bounds) in swept_chunks.iter_mut().enumerate() {
            let steps = &boxes[chunk * CHUNK..=(chunk + 1) * CHUNK];
            *bounds = steps.iter().flatten().fold(Aabb::EMPTY, |all, b| all.union(&b.aabb()));
            for pair in steps.windows(2) {
                if let [Some(from), Some(to)] = pair {
                    *bounds = bounds.union(&bounds_between(from, to));
                }
            }
        }
        let is_vehicle = track.kind == TrackKind::Vehicle;
        let first = frames.clone().find(|&f| track.is_valid(f));
        let stays = first.is_some_and(|first| {
            frames
                .filter(|&f| track.is_valid(f))
                .all(|f| distance(track.point(f), track.point(first)) <= STATIC)
        });
        Self {
            track: index,
            is_vehicle,
            is_static: is_vehicle && stays,
            bounds: chunks.iter().fold(Aabb::EMPTY, |all, chunk| all.union(chunk)),
            boxes,
            mirrored,
            chunks,
            swept_bounds: swept_chunks.iter().fold(Aabb::EMPTY, |all, chunk| all.union(chunk)),
            swept_chunks,
        }
    }

    /// The box at a step, 0 (*now*) to 80, if the frame is valid.
    #[inline]
    pub fn at(&self, step: usize) -> Option<&OrientedBox> {
        self.boxes[step].as_ref()
    }

    /// The box that the frame-by-frame rule tests at a step. It equals [`OtherAgent::at`], except for the
    /// published code's mirrored box.
    #[inline]
    pub(super) fn map_box(&self, step: usize) -> Option<&OrientedBox> {
        self.mirrored.as_ref().unwrap_or(&self.boxes)[step].as_ref()
    }

    /// Bounds of the true boxes over each group of [`CHUNK`] steps, with the step before the group.
    #[inline]
    pub(super) fn swept_chunks(&self) -> &[Aabb; HORIZON / CHUNK] {
        &self.swept_chunks
    }

    /// Bounds of the true boxes over steps 0 to 80.
    #[inline]
    pub(super) fn swept_bounds(&self) -> &Aabb {
        &self.swept_bounds
    }

    /// Bounds of the map boxes over steps 1 to 80.
    #[inline]
    pub(super) fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    /// Bounds of the map boxes over each group of [`CHUNK`] steps, from step 1.
    #[inline]
    pub(super) fn chunks(&self) -> &[Aabb; HORIZON / CHUNK] {
        &self.chunks
    }
}
