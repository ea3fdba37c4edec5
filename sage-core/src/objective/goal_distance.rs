//! How far from a goal a plan ends.

use serde::{Deserialize, Serialize};

use super::{ObjectiveSpec, PartSpec, Reward, Situation, TermSpec, Weight};
use crate::{
    geometry::{Point, distance},
    registry::Entry,
};

/// Distance of the last point of a trajectory from a goal, m.
#[derive(Clone, Copy, Debug)]
pub struct GoalDistance(Point);

/// Options of [`GoalDistance`]. They have no default, so no table has this reward unless the selection names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GoalDistanceOptions {
    /// The goal: x and y in metres, world frame.
    pub at: Option<Point>,
}

impl Entry<dyn Reward> for GoalDistance {
    const NAME: &'static str = "goal-distance";
    const SUMMARY: &'static str = "distance of the last point from `at`, m";
    const SOURCE: &'static str = "this project";
    type Options = GoalDistanceOptions;

    fn build(options: GoalDistanceOptions) -> Result<Box<dyn Reward>, String> {
        let at = options.at.ok_or("`at` is missing: the goal, as [x, y] in metres")?;
        if !at.iter().all(|value| value.is_finite()) {
            return Err(format!("`at` is {at:?}; expected finite metres"));
        }
        Ok(Box::new(Self(at)))
    }
}

impl Reward for GoalDistance {
    fn score(&self, situation: &Situation) -> Option<f64> {
        situation.candidate.trajectory().points().last().map(|end| distance(*end, self.0))
    }

    fn depends_on_ego(&self) -> bool {
        false
    }
}

impl ObjectiveSpec {
    /// The feasible plan, by the rule `drivable`, that ends nearest to a goal.
    ///
    /// ```
    /// use sage_core::objective::ObjectiveSpec;
    ///
    /// let spec = ObjectiveSpec::ends_near([12.0, -3.5]);
    /// assert_eq!(spec.terms[0].name, "goal-distance");
    /// ```
    pub fn ends_near(goal: Point) -> Self {
        let mut options = serde_json::Map::new();
        options.insert("at".to_owned(), serde_json::json!(goal));
        Self {
            terms: vec![TermSpec {
                name: GoalDistance::NAME.to_owned(),
                weight: Weight::Constant(-1.0),
                options,
                only_feasible: false,
            }],
            feasibility: PartSpec::named("drivable"),
            violation_weight: 0.0,
            believable_first: false,
        }
    }
}
