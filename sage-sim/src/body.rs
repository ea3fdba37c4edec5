//! Other road users at one moment: box, velocity, level.

use sage_core::{
    geometry::{OrientedBox, Point, wrap_angle},
    motion::{DT, NOW},
    scene::{Track, TrackKind},
};
use serde::{Deserialize, Serialize};

use crate::vehicle::Vehicle;

/// Kind of a road user in the simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BodyKind {
    /// Car, van, truck, bus.
    Vehicle,
    /// Person on foot.
    Pedestrian,
    /// Person on a bicycle or the like.
    Cyclist,
    /// Cone, barrier, other.
    Object,
}

impl BodyKind {
    /// Kind of a track.
    pub fn of(track: &Track) -> Self {
        match track.kind {
            TrackKind::Vehicle => Self::Vehicle,
            TrackKind::Pedestrian => Self::Pedestrian,
            TrackKind::Cyclist => Self::Cyclist,
            TrackKind::Other(_) => Self::Object,
        }
    }
}

/// Models of traffic in MetaDrive: sizes and masses instead of the logged ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BodyClass {
    /// Short car.
    Small,
    /// Car.
    Medium,
    /// Van.
    Large,
    /// Truck.
    ExtraLarge,
    /// Bicycle.
    Cyclist,
    /// A disc of radius 0.35 m.
    Pedestrian,
}

impl BodyClass {
    /// Length and width, metres.
    pub fn size(self) -> [f64; 2] {
        match self {
            Self::Small => [4.3, 1.7],
            Self::Medium => [4.6, 1.85],
            Self::Large => [4.87, 2.046],
            Self::ExtraLarge => [5.74, 2.3],
            Self::Cyclist => [1.75, 0.4],
            Self::Pedestrian => [0.7, 0.7],
        }
    }

    /// Mass, kg.
    pub fn mass(self) -> f64 {
        match self {
            Self::Small => 800.0,
            Self::Medium => 1200.0,
            Self::Large => 1300.0,
            Self::ExtraLarge => 1600.0,
            Self::Cyclist => 80.0,
            Self::Pedestrian => 70.0,
        }
    }

    /// The model as a car on tyres; `None` for people and bicycles.
    pub fn vehicle(self) -> Option<Vehicle> {
        let friction = match self {
            Self::Small => 0.9,
            Self::Medium => 0.75,
            Self::Large => 0.8,
            Self::ExtraLarge => 0.7,
            Self::Cyclist | Self::Pedestrian => return None,
        };
        let [length, width] = self.size();
        Some(Vehicle::of_size(length, width, self.mass(), friction))
    }
}

/// A road user at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Index of its track in the scene.
    pub track: usize,
    /// Kind.
    pub kind: BodyKind,
    /// MetaDrive's model, if sizes come from there.
    pub class: Option<BodyClass>,
    /// Area that it covers; for [`BodyClass::Pedestrian`] the square around its disc.
    pub area: OrientedBox,
    /// Heading, rad.
    pub heading: f64,
    /// Velocity, m/s.
    pub velocity: Point,
    /// Yaw rate, rad/s.
    pub yaw_rate: f64,
    /// Height of the ground under it, metres.
    pub ground: f64,
    /// MetaDrive: it has just been created in the air, above the beams of the lidar.
    pub is_falling: bool,
}

impl Body {
    /// A track at a valid frame.
    ///
    /// `shape`: length and width instead of the frame's. The yaw rate is that since the frame before, so that
    /// it holds nothing of the future.
    pub fn of_track(index: usize, track: &Track, frame: usize, shape: BodyShape) -> Self {
        let [x, y, z] = track.position[frame];
        let [length, width, height] = track.size[frame];
        let heading = track.heading[frame];
        let [length, width] = shape.size.unwrap_or([length, width]);
        let last = frame.checked_sub(1).filter(|&last| track.is_valid(last));
        let yaw_rate = last.map_or(0.0, |last| wrap_angle(heading - track.heading[last]) / DT);
        Self {
            track: index,
            kind: BodyKind::of(track),
            class: shape.class,
            area: OrientedBox::new([x, y], heading, length, width),
            heading,
            velocity: track.velocity[frame],
            yaw_rate,
            ground: z - 0.5 * height,
            is_falling: false,
        }
    }

    /// Radius of the disc, if it is one.
    pub fn disc(&self) -> Option<f64> {
        (self.class == Some(BodyClass::Pedestrian)).then_some(self.area.half_width)
    }

    /// Speed, m/s.
    pub fn speed(&self) -> f64 {
        sage_core::geometry::norm(self.velocity)
    }

    /// The body after `dt` seconds at constant velocity and heading.
    pub fn coasted(&self, dt: f64) -> OrientedBox {
        let [x, y] = self.area.center;
        OrientedBox { center: [x + self.velocity[0] * dt, y + self.velocity[1] * dt], ..self.area }
    }

    /// Whether `area`, a later position of this body, touches a car.
    pub fn touches(&self, area: &OrientedBox, car: &OrientedBox) -> bool {
        match self.disc() {
            Some(radius) => {
                let [along, across] = car.box_from_world(area.center);
                let out = [along.abs() - car.half_length, across.abs() - car.half_width].map(|d| d.max(0.0));
                out[0] * out[0] + out[1] * out[1] <= radius * radius
            }
            None => area.intersects(car),
        }
    }
}

/// Length and width instead of a track's logged ones, with MetaDrive's model if they are from there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BodyShape {
    /// Length and width, metres; `None` for the logged ones of each frame.
    pub size: Option<[f64; 2]>,
    /// MetaDrive's model.
    pub class: Option<BodyClass>,
}

impl BodyShape {
    /// Sizes of a class.
    pub fn of_class(class: BodyClass) -> Self {
        Self { size: Some(class.size()), class: Some(class) }
    }

    /// The logged size at *now*, or at the valid frame nearest to it.
    pub fn at_now(track: &Track) -> Self {
        let nearest = (0..track.valid.len()).filter(|&f| track.valid[f]).min_by_key(|f| f.abs_diff(NOW));
        Self { size: nearest.map(|frame| [track.size[frame][0], track.size[frame][1]]), class: None }
    }
}
