//! Goals of GOOSE: what a plan achieves, and its reward.

use sage_core::{
    geometry::Point,
    motion::{Pose, kinematics::paper},
};

/// Least distance of the centres of ego and adversary (m), largest acceleration (m/s²) and yaw rate (rad/s) of the
/// adversary's whole plan, from its second step on; as a desired goal, what they should stay below.
pub type Goal = [f64; 3];

/// The goal of attacks.
pub const DESIRED: Goal = [0.0, 8.0, 0.7];
/// A distance that counts as a contact, metres.
const TOUCHES: f64 = 1.0;
/// Penalty of each unit beyond the desired goal.
const PENALTIES: Goal = [0.1, 0.01, 0.05];
/// Number of goals in hindsight for each step.
pub const HINDSIGHT: usize = 6;

/// The goals from which those in hindsight are drawn.
pub const HINDSIGHT_GOALS: [Goal; 9] = {
    const DISTANCES: [f64; 3] = [4.0, 8.0, 20.0];
    const KINEMATICS: [[f64; 2]; 3] = [[8.0, 0.7], [20.0, 2.0], [1000.0, 20.0]];
    let mut goals = [[0.0; 3]; 9];
    let mut k = 0;
    while k < 9 {
        let [acceleration, yaw_rate] = KINEMATICS[k / 3];
        goals[k] = [DISTANCES[k % 3], acceleration, yaw_rate];
        k += 1;
    }
    goals
};

/// Reward of a step, and whether the goal is reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// 0 for a goal that is reached, else −1 or less.
    pub reward: f64,
    /// Whether the goal is reached.
    pub is_done: bool,
}

/// Outcome of what a plan achieves, by the goal of attacks; `is_hit` says that the ego had a contact with the adversary.
pub fn attack_outcome(achieved: &Goal, is_hit: bool) -> Outcome {
    let is_near = is_hit || achieved[0] < TOUCHES;
    outcome_of(achieved, &DESIRED, is_near && is_smooth(achieved, &DESIRED), TOUCHES)
}

/// The same by a goal in hindsight.
pub fn outcome_in_hindsight(achieved: &Goal, desired: &Goal) -> Outcome {
    outcome_of(achieved, desired, achieved[0] < desired[0] && is_smooth(achieved, desired), 0.0)
}

fn is_smooth(achieved: &Goal, desired: &Goal) -> bool {
    achieved[1] < desired[1] && achieved[2] < desired[2]
}

fn outcome_of(achieved: &Goal, desired: &Goal, is_done: bool, slack: f64) -> Outcome {
    let beyond: Goal = std::array::from_fn(|k| {
        let limit = desired[k] + if k == 0 { slack } else { 0.0 };
        (achieved[k] - limit).max(0.0)
    });
    let penalty: f64 = 1.0 + PENALTIES.iter().zip(&beyond).map(|(p, x)| p * x).sum::<f64>();
    Outcome { reward: if is_done { 0.0 } else { -penalty }, is_done }
}

/// Largest acceleration and yaw rate of a plan alone, as driven from its second step on: its first step is the change from
/// the recording to the plan.
pub fn kinematics(plan: &[Point], now: &Pose) -> [f64; 2] {
    let profile = paper::profile(plan, now);
    let most = |values: &[f64]| values.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    [most(&profile.acceleration), most(&profile.yaw_rate)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rewards_of_worked_cases() {
        // 3 m away: 1 + 0.1 (3 − 1); 10 m/s² and 1.7 rad/s: + 0.01 · 2 + 0.05 · 1.
        let outcome = attack_outcome(&[3.0, 10.0, 1.7], false);
        assert!((outcome.reward + 1.27).abs() < 1e-12 && !outcome.is_done);
        // A contact between larger cars, and one by distance.
        assert_eq!(attack_outcome(&[2.5, 7.9, 0.69], true), Outcome { reward: 0.0, is_done: true });
        assert_eq!(attack_outcome(&[0.9, 7.9, 0.69], false), Outcome { reward: 0.0, is_done: true });
        // A contact that is not smooth is not the goal: 1 + 0.1 (2.5 − 1) + 0.01 · 1.
        let rough = attack_outcome(&[2.5, 9.0, 0.1], true);
        assert!((rough.reward + 1.16).abs() < 1e-12 && !rough.is_done);
        assert!(!attack_outcome(&[0.5, 8.0, 0.1], true).is_done);
    }

    #[test]
    fn hindsight_has_no_slack() {
        let outcome = outcome_in_hindsight(&[5.0, 10.0, 0.5], &[4.0, 8.0, 0.7]);
        assert!((outcome.reward + 1.12).abs() < 1e-12 && !outcome.is_done);
        assert!(outcome_in_hindsight(&[5.0, 10.0, 0.5], &[8.0, 20.0, 2.0]).is_done);
        assert!(!outcome_in_hindsight(&[8.0, 10.0, 0.5], &[8.0, 20.0, 2.0]).is_done);
        let goals: Vec<Goal> = HINDSIGHT_GOALS.to_vec();
        assert_eq!(goals[0], [4.0, 8.0, 0.7]);
        assert_eq!(goals[5], [20.0, 20.0, 2.0]);
        assert_eq!(goals[6], [4.0, 1000.0, 20.0]);
    }

    #[test]
    fn the_step_from_the_recording_to_the_plan_is_not_counted() {
        // 10 m/s along y, whatever the car did before.
        let plan: Vec<Point> = (1..=80).map(|k| [0.0, f64::from(k)]).collect();
        assert_eq!(kinematics(&plan, &Pose::new(0.0, 0.0, 0.0)), [0.0, 0.0]);
        // From 10 to 20 m/s within a step, and a turn by 90 degrees.
        let bent = |k: i32| if k <= 40 { [0.0, f64::from(k)] } else { [2.0 * f64::from(k - 40), 40.0] };
        let plan: Vec<Point> = (1..=80).map(bent).collect();
        let [acceleration, yaw_rate] = kinematics(&plan, &Pose::new(0.0, 0.0, 0.0));
        assert!((acceleration - 100.0).abs() < 1e-9, "{acceleration}");
        assert!((yaw_rate - 5.0 * std::f64::consts::PI).abs() < 1e-9, "{yaw_rate}");
    }
}
