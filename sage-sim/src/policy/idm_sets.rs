//! Car following with the parameters of public benchmarks: nuPlan's planner, and V-Max's driver. They drive along the
//! logged route without lane changes, and do not look at traffic lights.

use sage_core::motion::idm::Idm;

use super::idm::IdmOptions;

/// nuPlan's planner where a lane has no limit, m/s.
const NUPLAN_SPEED: f64 = 10.0;

fn published(model: Idm, limits: [f64; 2]) -> IdmOptions {
    IdmOptions { model, limits, lane_changes: None, red_lights: false, ..IdmOptions::default() }
}

/// The options of `idm-nuplan`.
pub(super) fn nuplan() -> IdmOptions {
    let model = Idm {
        desired_speed: NUPLAN_SPEED,
        time_gap: 1.5,
        standing_gap: 1.0,
        acceleration: 1.0,
        deceleration: 3.0,
        exponent: 4.0,
    };
    published(model, [-3.0, 1.0])
}

/// The options of `idm-vmax`.
pub(super) fn vmax() -> IdmOptions {
    let model = Idm {
        time_gap: 2.0,
        standing_gap: 2.0,
        acceleration: 2.0,
        deceleration: 4.0,
        exponent: 4.0,
        ..IdmOptions::default().model
    };
    published(model, [-6.0, 6.0])
}

#[cfg(test)]
mod tests {
    use sage_core::motion::idm::Leader;

    use super::*;

    #[test]
    fn accelerations_are_those_of_the_published_formulas() {
        // At (speed, speed of the leader, gap) with a target of 13.4112 m/s.
        let cases = [[10.0, 10.0, 30.0], [10.0, 5.0, 20.0], [10.0, 0.0, 40.0], [5.0, 5.0, 8.0]];
        for (options, expected) in [
            (nuplan(), [0.4064, -1.6247, -0.5673, -0.1482]),
            (vmax(), [0.3062, -3.3734, -0.5861, -2.5386]),
            (published(IdmOptions::default().model, [-3.0, 1.0]), [0.3698, -1.7793, -0.6240, -0.4295]),
        ] {
            let model = Idm { desired_speed: 13.4112, ..options.model };
            for ([speed, leader, gap], expected) in cases.into_iter().zip(expected) {
                let found = model.acceleration(speed, Some(Leader { gap, speed: leader }));
                let [low, high] = options.limits;
                assert!(
                    (found.clamp(low, high) - expected).abs() < 1e-4,
                    "{speed}, {leader}, {gap}: {found}"
                );
            }
        }
    }
}
