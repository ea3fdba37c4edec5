//! A prior without weights: vehicles follow reachable lanes at about their present speed.
//!
//! A goal is likely if it needs little acceleration along the road and no lane change, and if it lies near
//! the middle of a lane and not beyond a red light. Its trajectory is a cubic that starts at the present
//! speed along the heading and ends along the lane. This prior is the baseline for learned networks.

use std::sync::Arc;

use candle_core::{Device, Tensor};
use sage_core::{
    geometry::Point,
    motion::{DT, HORIZON},
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use crate::{
    Error, Parameters,
    backbone::{Backbone, Definition, MotionModel},
    encoding::Encoding,
    features::{Features, GoalColumn},
    nn::log_softmax,
};

/// Options of [`LaneGraph`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LaneGraphOptions {
    /// Standard deviation of the constant acceleration, m/s².
    pub acceleration: f32,
    /// Cost of a lane change, nats.
    pub lane_change: f32,
    /// Cost of a goal that is not on a reachable lane, nats.
    pub off_route: f32,
    /// Cost of passing a red light, nats.
    pub red_light: f32,
}

impl Default for LaneGraphOptions {
    fn default() -> Self {
        Self { acceleration: 0.6, lane_change: 2.0, off_route: 4.0, red_light: 2.0 }
    }
}

/// The lane-graph prior.
pub struct LaneGraph {
    options: LaneGraphOptions,
    definition: Definition,
}

impl LaneGraph {
    fn score(&self, row: &[f32]) -> f32 {
        let column = |c: GoalColumn| row[c as usize];
        let o = &self.options;
        // The columns have units of 2 m/s² and of two lane changes.
        let effort = |a: f32| -0.5 * (2.0 * a / o.acceleration).powi(2);
        let lateral = -0.5 * (4.0 * column(GoalColumn::LateralAcceleration) / 2.0).powi(2);
        if column(GoalColumn::Reachable) == 0.0 {
            return effort(column(GoalColumn::StraightAcceleration)) + lateral - o.off_route;
        }
        let beyond_light = column(GoalColumn::RedLight) > 0.0 && column(GoalColumn::BeyondStop) > 0.0;
        effort(column(GoalColumn::RouteAcceleration))
            - 2.0 * o.lane_change * column(GoalColumn::Changes)
            - 0.5 * (2.0 * column(GoalColumn::LaneOffset)).powi(2)
            - if beyond_light { o.red_light } else { 0.0 }
    }
}

impl Backbone for LaneGraph {
    fn definition(&self) -> &Definition {
        &self.definition
    }

    fn with_parameters(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error> {
        Ok(Box::new(Self { options: self.options.clone(), definition: self.definition.with(parameters) }))
    }

    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error> {
        Ok(Encoding::new(self.tag(), features, Vec::new()))
    }
}

impl MotionModel for LaneGraph {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error> {
        let features = encoding.features();
        let scores: Vec<f32> =
            (0..features.modes()).map(|k| self.score(features.goal_features.row(k))).collect();
        Ok(log_softmax(&Tensor::from_vec(scores, features.modes(), &Device::Cpu)?)?)
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error> {
        Ok(encoding.features().goals.clone())
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        let features = encoding.features();
        let trajectory = |&mode: &usize| {
            let goal = features.goals[mode].map(f64::from);
            let row = features.goal_features.row(mode);
            let on_lane = row[GoalColumn::OnLane as usize] > 0.0;
            let lane = [row[GoalColumn::LaneCos as usize], row[GoalColumn::LaneSin as usize]].map(f64::from);
            cubic(f64::from(features.velocity[0]), goal, on_lane.then_some(lane))
        };
        let numbers: Vec<f32> = modes.iter().flat_map(trajectory).flatten().map(|x| x as f32).collect();
        Ok(Tensor::from_vec(numbers, (modes.len(), HORIZON, 2), &Device::Cpu)?)
    }
}

impl Entry<dyn Backbone> for LaneGraph {
    const NAME: &'static str = "lane-graph";
    const SUMMARY: &'static str = "no weights: goals along the lanes at about the present speed";
    const SOURCE: &'static str = "this project";
    type Options = LaneGraphOptions;

    fn build(options: LaneGraphOptions) -> Result<Box<dyn Backbone>, String> {
        if !(options.acceleration > 0.0) {
            return Err(format!("`acceleration` is {}; expected a positive number", options.acceleration));
        }
        let definition = Definition::of::<Self, _>(&options, 0, |_| Ok(()))?;
        Ok(Box::new(Self { options, definition }))
    }
}

/// The cubic from the origin, with a start speed along x, to a goal. It ends along the lane; without a lane,
/// along the circle through the goal.
fn cubic(speed: f64, goal: Point, lane: Option<Point>) -> Vec<Point> {
    const T: f64 = HORIZON as f64 * DT;
    let distance = goal[0].hypot(goal[1]);
    let turn = 2.0 * goal[1].atan2(goal[0].max(1e-6));
    let direction = lane.unwrap_or([turn.cos(), turn.sin()]);
    let last = (2.0 * distance / T - speed).max(0.0);
    let axis = |k: usize, s: f64| {
        let [v, mean, end] = [if k == 0 { speed } else { 0.0 }, goal[k] / T, last * direction[k]];
        let c = 6.0 * (0.5 * (end - v) - (mean - v));
        let b = end - v - c;
        T * (v * s + 0.5 * b * s * s + c * s * s * s / 3.0)
    };
    (1..=HORIZON).map(|step| step as f64 / HORIZON as f64).map(|s| [axis(0, s), axis(1, s)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trajectory_reaches_its_goal_along_the_lane() {
        let trajectory = cubic(10.0, [60.0, 20.0], Some([0.0, 1.0]));
        let [a, b] = [trajectory[HORIZON - 2], trajectory[HORIZON - 1]];
        assert!((b[0] - 60.0).abs() < 1e-9 && (b[1] - 20.0).abs() < 1e-9);
        assert!((b[0] - a[0]).abs() < 0.02 && b[1] > a[1], "{a:?} {b:?}");
        assert!((trajectory[0][0] - 1.0).abs() < 0.02);
    }
}
