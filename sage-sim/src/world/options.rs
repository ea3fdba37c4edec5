//! Options of a world.

use serde::{Deserialize, Serialize};

use crate::{lines::LineShapes, traffic::TrafficOptions};

/// Options of a world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldOptions {
    /// The other road users.
    pub traffic: TrafficOptions,
    /// Strength of engine and brake in [0, 1] ([`crate::vehicle::Vehicle::of_strength`]); `None` draws it from the seed.
    pub strength: Option<f64>,
    /// Shape of road lines and edges.
    pub lines: LineShapes,
    /// MetaDrive: the reported pose is one substep (0.02 s) old.
    pub late_pose: bool,
    /// MetaDrive: tyres touch the ground only after four substeps.
    pub airborne_start: bool,
    /// MetaDrive: heights are ignored, so roads above each other meet.
    pub flat: bool,
    /// Keeps every body in the physics, near or not. Slower, with the same result.
    pub whole_physics: bool,
}

impl Default for WorldOptions {
    fn default() -> Self {
        Self {
            traffic: TrafficOptions::default(),
            strength: Some(0.5),
            lines: LineShapes::Exact,
            late_pose: false,
            airborne_start: false,
            flat: false,
            whole_physics: false,
        }
    }
}
