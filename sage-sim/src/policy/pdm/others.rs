//! Forecasts of the other road users: constant speed along their present heading, without turning.

use sage_core::{
    geometry::{Aabb, OrientedBox, distance, dot},
    motion::DT,
};

use crate::{
    body::{Body, BodyKind},
    policy::View,
};

/// Distance within which others are looked at, metres.
const REACH: f64 = 50.0;
/// Largest number of each kind, the nearest ones.
const CAPS: [(BodyKind, usize); 4] =
    [(BodyKind::Vehicle, 50), (BodyKind::Pedestrian, 25), (BodyKind::Cyclist, 10), (BodyKind::Object, 50)];
/// Steps between two times of the forecast.
const GRID: usize = 2;

/// A road user and where it will be.
#[derive(Clone, Debug)]
pub(super) struct Other {
    pub(super) kind: BodyKind,
    /// Speed, m/s.
    pub(super) speed: f64,
    area: OrientedBox,
    /// Velocity along its heading, m/s: negative when it rolls backwards.
    along: f64,
}

impl Other {
    fn new(body: &Body) -> Self {
        let (speed, kind) = (body.speed(), body.kind);
        let rolls_back = dot(body.velocity, body.area.axis) < 0.0;
        let along = if kind == BodyKind::Object { 0.0 } else { speed };
        Self { kind, speed, area: body.area, along: if rolls_back { -along } else { along } }
    }

    /// Its box at a step. Forecasts have times of 0, 0.2, 0.4, … s; between them the earlier one counts.
    pub(super) fn at(&self, step: usize) -> OrientedBox {
        let way = self.along * DT * (step - step % GRID) as f64;
        let [x, y] = self.area.center;
        OrientedBox { center: [x + way * self.area.axis[0], y + way * self.area.axis[1]], ..self.area }
    }

    /// Its speed along a direction, m/s; 0 for objects.
    pub(super) fn speed_along(&self, axis: [f64; 2]) -> f64 {
        self.along * dot(self.area.axis, axis)
    }

    /// Whether it stays where it is.
    pub(super) fn stands(&self) -> bool {
        self.along == 0.0
    }

    /// Bounds of all its boxes up to a step.
    pub(super) fn bounds(&self, step: usize) -> Aabb {
        self.area.aabb().union(&self.at(step).aabb())
    }
}

/// The nearest of those in view, without some tracks.
pub(super) fn in_view(view: &View, ignored: &[usize]) -> Vec<Other> {
    let own = view.area().center;
    let mut near: Vec<(f64, &Body)> = view
        .others()
        .filter(|body| !ignored.contains(&body.track))
        .map(|body| (distance(body.area.center, own), body))
        .filter(|(away, _)| *away <= REACH)
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.track.cmp(&b.1.track)));
    let mut left = CAPS;
    near.retain(|(_, body)| {
        let room = left.iter_mut().find(|(kind, _)| *kind == body.kind).map(|(_, room)| room);
        room.is_some_and(|room| {
            let is_free = *room > 0;
            *room = room.saturating_sub(1);
            is_free
        })
    });
    near.into_iter().map(|(_, body)| Other::new(body)).collect()
}
