//! Map and goal subsampling: a network reads fewer map polylines and goals, for speed.

use serde::{Deserialize, Serialize};

use crate::{
    Error,
    features::{CELL, Features, GoalColumn},
};

/// Goals of the ego within this distance are not subsampled, even off the road, metres.
const EGO_GOAL_RADIUS: f32 = 10.0;
/// If fewer goals of the ego than this would remain, its goals are not subsampled.
const FEWEST_EGO_GOALS: usize = 64;

/// Map and goal subsampling. Attacks use the default; training and expectations use [`Subsampling::NONE`].
/// `docs/results/attacks.md` has the measurement behind the default.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Subsampling {
    /// Maximum number of map polylines of the target, the nearest first.
    pub max_polylines: usize,
    /// Beyond this distance every second goal of the target is left out, metres.
    pub dense_goal_radius: f32,
    /// Maximum number of map polylines of the ego, the nearest first.
    pub ego_max_polylines: usize,
    /// Stride of the ego's goals along each axis of the lattice, 1 to 4.
    pub ego_goal_stride: usize,
}

impl Subsampling {
    /// All goals and all map polylines.
    pub const NONE: Self = Self {
        max_polylines: usize::MAX,
        dense_goal_radius: f32::MAX,
        ego_max_polylines: usize::MAX,
        ego_goal_stride: 1,
    };

    /// Refuses values out of range.
    ///
    /// *Errors*: [`Error::Option`] with the field, its value and the range.
    pub fn check(self) -> Result<Self, Error> {
        let fail = |problem| Err(Error::Option(problem));
        for (name, most) in
            [("max_polylines", self.max_polylines), ("ego_max_polylines", self.ego_max_polylines)]
        {
            if most == 0 {
                return fail(format!("`{name}` is 0; expected at least 1"));
            }
        }
        if !(self.dense_goal_radius >= 0.0) {
            let radius = self.dense_goal_radius;
            return fail(format!("`dense_goal_radius` is {radius}; expected 0 metres or more"));
        }
        if !(1..=4).contains(&self.ego_goal_stride) {
            return fail(format!("`ego_goal_stride` is {}; expected 1 to 4", self.ego_goal_stride));
        }
        Ok(self)
    }

    /// Features of a target with fewer polylines and goals.
    pub(crate) fn of_target(self, mut features: Features) -> Features {
        features = features.with_polylines(self.max_polylines);
        let radius = self.dense_goal_radius;
        if radius == f32::MAX {
            return features;
        }
        let keep =
            goals_where(&features, |[i, j], [x, y], _| x * x + y * y < radius * radius || (i + j) % 2 == 0);
        features.with_goals(&keep)
    }

    /// Features of the ego with fewer polylines and with the goals on the road or close to the ego. Other
    /// goals are unlikely; without them the cost is half.
    pub(crate) fn of_ego(self, mut features: Features) -> Features {
        features = features.with_polylines(self.ego_max_polylines);
        let stride = self.ego_goal_stride as i32;
        let keep = goals_where(&features, |[i, j], [x, y], row| {
            let is_on_road = row[GoalColumn::Reachable as usize] > 0.0;
            x * x + y * y < EGO_GOAL_RADIUS * EGO_GOAL_RADIUS
                || (is_on_road && i % stride == 0 && j % stride == 0)
        });
        if keep.len() < FEWEST_EGO_GOALS { features } else { features.with_goals(&keep) }
    }
}

impl Default for Subsampling {
    fn default() -> Self {
        Self { max_polylines: 128, dense_goal_radius: 60.0, ego_max_polylines: 64, ego_goal_stride: 2 }
    }
}

/// Indices of the goals that pass a test of their lattice point, position and row.
fn goals_where(features: &Features, pass: impl Fn([i32; 2], [f32; 2], &[f32]) -> bool) -> Vec<usize> {
    let passes = |goal: &usize| {
        let position = features.goals[*goal];
        let point = position.map(|x| (x / CELL as f32).round() as i32);
        pass(point, position, features.goal_features.row(*goal))
    };
    (0..features.modes()).filter(passes).collect()
}
