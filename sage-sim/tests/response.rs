//! Vehicle response against curves measured in MetaDrive 0.3.0.1. Needs `SAGE_REFERENCE`.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

mod reference;

use sage_core::motion::bicycle::Bicycle;
use sage_sim::vehicle::{Action, Motion, SUBSTEP, SUBSTEPS, Tyres, Vehicle, Wheels};
use serde_json::Value;

fn car(row: &Value) -> Vehicle {
    let number = |key: &str, default: f64| row[key].as_f64().unwrap_or(default);
    Vehicle { engine_force: number("E", 800.0), brake_impulse: number("B", 130.0), ..Vehicle::default() }
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().map(|all| all.iter().map(|x| x.as_f64().unwrap()).collect()).unwrap_or_default()
}

fn actions(row: &Value, steps: usize) -> Vec<Action> {
    let action = |pair: &Value| {
        let pair = numbers(pair);
        Action { steer: pair[0], throttle: pair[1] }
    };
    match row["action"].is_array() {
        true => vec![action(&row["action"]); steps],
        false => row["actions"].as_array().unwrap().iter().map(action).collect(),
    }
}

/// Motions at 0.1 s, with the pose one substep late, as MetaDrive reports it.
fn drive(row: &Value, steps: usize) -> Vec<Motion> {
    let (car, v0) = (car(row), row["v0_mps"].as_f64().unwrap_or(0.0));
    let mut motion = Motion { velocity: [v0, 0.0], ..Motion::default() };
    let mut tyres = Tyres::default();
    let mut samples = vec![motion];
    for action in actions(row, steps) {
        let wheels = Wheels::set(&car, action, motion.speed());
        let mut before = motion;
        for _ in 0..SUBSTEPS {
            before = motion;
            motion = motion.coasted(SUBSTEP);
            tyres.apply(&car, &wheels, &mut motion);
        }
        samples.push(Motion { position: before.position, heading: before.heading, ..motion });
    }
    samples
}

fn rows(key: &str) -> Option<Vec<Value>> {
    Some(reference::json("metadrive_response.json")?[key].as_array().unwrap().clone())
}

/// The largest relative error of a quantity, and the error that is allowed.
struct Worst {
    what: &'static str,
    allowed: f64,
    error: f64,
}

impl Worst {
    fn new(what: &'static str, allowed: f64) -> Self {
        Self { what, allowed, error: 0.0 }
    }

    /// Asserts that a value is within the allowed share of another one.
    fn add(&mut self, found: f64, expected: f64, case: &str) {
        let error = (found - expected).abs() / expected.abs().max(1e-9);
        assert!(error <= self.allowed, "{case}, {}: {found}, expected {expected}", self.what);
        self.error = self.error.max(error);
    }
}

impl Drop for Worst {
    fn drop(&mut self) {
        eprintln!("{}: worst {:.2} %, allowed {:.0} %", self.what, 100.0 * self.error, 100.0 * self.allowed);
    }
}

#[test]
fn speeds_when_accelerating_and_coasting_are_within_a_percent() {
    let mut worst = 0.0f64;
    for key in ["accelerate", "coast"] {
        for row in rows(key).unwrap_or_default() {
            let speeds = numbers(&row["speed_mps"]);
            for (found, expected) in drive(&row, speeds.len() - 1).iter().zip(&speeds) {
                // Near standstill a percent of 1 m/s counts.
                let error = (found.speed() - expected).abs() / expected.max(1.0);
                assert!(error <= 0.01, "{key} {}: {} m/s, expected {expected}", row["action"], found.speed());
                worst = worst.max(error);
            }
        }
    }
    eprintln!("speeds: worst {:.2} %, allowed 1 %", 100.0 * worst);
}

#[test]
fn stopping_distances_are_within_8_percent() {
    let mut worst = Worst::new("stopping distance", 0.08);
    for row in rows("brake").unwrap_or_default() {
        let (x, speeds) = (numbers(&row["x_m"]), numbers(&row["fwd_mps"]));
        let stop = speeds.iter().position(|v| *v < 0.1).unwrap_or(x.len() - 1);
        let found = drive(&row, x.len() - 1)[stop].position[0];
        worst.add(found, x[stop], &format!("brake {} from {}", row["action"], row["v0_mps"]));
    }
}

#[test]
fn steering_agrees_below_and_above_the_grip_limit() {
    let all = [rows("steer_constant"), rows("steer_combined")].into_iter().flatten().flatten();
    let (mut below, mut above) = (0, 0);
    let mut grips =
        ["heading below the grip limit", "yaw rate below the grip limit"].map(|what| Worst::new(what, 0.03));
    let mut slides_by = [
        ("offset above the grip limit", 0.05),
        ("speed above the grip limit", 0.05),
        ("heading above the grip limit", 0.13),
        ("yaw rate above the grip limit", 0.21),
    ]
    .map(|(what, allowed)| Worst::new(what, allowed));
    for row in all {
        let [y, heading, forward, left, yaw_rate] =
            ["y_m", "heading_rad", "fwd_mps", "lat_mps", "yaw_rate_rps"].map(|key| numbers(&row[key]));
        let what = format!("steer {} from {}", row["action"], row["v0_mps"]);
        let found = drive(&row, y.len() - 1);
        // Braked to a stop within the 2 s: nothing turns any more.
        if forward[20] < 1.0 {
            continue;
        }
        let speed = forward[20].hypot(left[20]);
        // Lateral acceleration that the path of the front wheels would need at the highest speed.
        let bicycle = Bicycle { front: 1.05234, rear: 1.4166 };
        let fastest = forward[..=20].iter().fold(0.0f64, |a, v| a.max(*v));
        let steer = row["action"][0].as_f64().unwrap() * 40f64.to_radians();
        let slides = fastest * bicycle.yaw_rate(fastest, steer).abs() > 7.5;
        if slides {
            above += 1;
            let pairs = [
                (found[20].position[1], y[20]),
                (found[20].speed(), speed),
                (found[20].heading, heading[20]),
                (found[20].yaw_rate, yaw_rate[20]),
            ];
            slides_by
                .iter_mut()
                .zip(pairs)
                .for_each(|(worst, (found, expected))| worst.add(found, expected, &what));
        } else {
            below += 1;
            grips[0].add(found[20].heading, heading[20], &what);
            grips[1].add(found[20].yaw_rate, yaw_rate[20], &what);
        }
    }
    assert!((below == 0 && above == 0) || (below >= 15 && above >= 10), "{below} below, {above} above");
}

#[test]
fn mixed_sequences_stay_within_30_cm_after_2_s() {
    let mut worst = [0.0f64; 2];
    for row in rows("sequences").unwrap_or_default() {
        let [x, y, heading] = ["x_m", "y_m", "heading_rad"].map(|key| numbers(&row[key]));
        let found = drive(&row, x.len() - 1)[20];
        let away = (found.position[0] - x[20]).hypot(found.position[1] - y[20]);
        assert!(away <= 0.3, "{}: {away} m", row["kind"]);
        let turned = (found.heading - heading[20]).abs();
        assert!(turned <= 0.03, "{}: heading", row["kind"]);
        worst = [worst[0].max(away), worst[1].max(turned)];
    }
    eprintln!("sequences after 2 s: worst {:.3} m, {:.4} rad", worst[0], worst[1]);
}

#[test]
fn a_car_without_forces_coasts_to_a_stop_and_stays() {
    let car = Vehicle::default();
    let (mut motion, mut tyres) = (Motion { velocity: [1.0, 0.0], ..Motion::default() }, Tyres::default());
    let wheels = Wheels::set(&car, Action::default(), 1.0);
    let mut time = 0.0;
    while motion.speed() > 1e-6 {
        tyres.apply(&car, &wheels, &mut motion);
        time += SUBSTEP;
        assert!(time < 3.0);
    }
    // 1 m/s at 0.3636 m/s².
    assert!((time - 1.0 / car.rolling_resistance()).abs() < 0.2, "{time}");
}

#[test]
fn throttle_for_gives_the_acceleration() {
    let car = Vehicle::default();
    for wanted in [-6.0, -2.0, -0.5, 0.5, 1.0, 2.5] {
        let mut motion = Motion { velocity: [10.0, 0.0], ..Motion::default() };
        let mut tyres = Tyres::default();
        let action = Action { steer: 0.0, throttle: car.throttle_for(wanted) };
        let wheels = Wheels::set(&car, action, 10.0);
        for _ in 0..SUBSTEPS {
            tyres.apply(&car, &wheels, &mut motion);
        }
        assert!(((motion.velocity[0] - 10.0) / 0.1 - wanted).abs() < 0.01 * wanted.abs(), "{wanted}");
    }
}
