//! Vehicle response against curves measured in MetaDrive 0.3.0.1. Needs `SAGE_REFERENCE`.

mod reference;

use sage_sim::vehicle::{Action, Motion, SUBSTEP, SUBSTEPS, Tyres, Vehicle, Wheels};
use serde_json::Value;

/// Reported samples of a drive at 0.1 s: the pose one substep late, as MetaDrive reports it.
struct Sample {
    motion: Motion,
    forward: f64,
}

fn car(row: &Value) -> Vehicle {
    let number = |key: &str, default: f64| row[key].as_f64().unwrap_or(default);
    Vehicle {
        engine_force: number("E", 800.0),
        brake_impulse: number("B", 130.0),
        ..Vehicle::default()
    }
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

fn drive(car: &Vehicle, v0: f64, actions: &[Action]) -> Vec<Sample> {
    let mut motion = Motion { velocity: [v0, 0.0], ..Motion::default() };
    let mut tyres = Tyres::default();
    let mut samples = vec![Sample { motion, forward: v0 }];
    for action in actions {
        let wheels = Wheels::set(car, *action, motion.speed());
        let mut before = motion;
        for _ in 0..SUBSTEPS {
            before = motion;
            motion = motion.coasted(SUBSTEP);
            tyres.apply(car, &wheels, &mut motion);
        }
        let shown = Motion { velocity: motion.velocity, yaw_rate: motion.yaw_rate, ..before };
        samples.push(Sample { motion: shown, forward: motion.body_velocity()[0] });
    }
    samples
}

#[test]
fn print_errors() {
    let Some(all) = reference::json("metadrive_response.json") else { return };
    let rows = |key: &str| all[key].as_array().unwrap().clone();
    for key in ["accelerate", "coast"] {
        let mut worst = 0.0f64;
        for row in rows(key) {
            let speeds = numbers(&row["speed_mps"]);
            let out = drive(&car(&row), row["v0_mps"].as_f64().unwrap_or(0.0), &actions(&row, speeds.len() - 1));
            for (s, v) in out.iter().zip(&speeds) {
                worst = worst.max((s.motion.speed() - v).abs() / v.max(1.0));
            }
        }
        println!("{key}: speed {worst:.4}");
    }
    let mut worst = 0.0f64;
    for row in rows("brake") {
        let x = numbers(&row["x_m"]);
        let out = drive(&car(&row), row["v0_mps"].as_f64().unwrap(), &actions(&row, x.len() - 1));
        let v = numbers(&row["fwd_mps"]);
        let stopped = v.iter().position(|v| *v < 0.1);
        let k = stopped.unwrap_or(x.len() - 1);
        let error = (out[k].motion.position[0] - x[k]).abs() / x[k];
        if error > 0.05 { println!("  brake {} {} {} ours {:.2} theirs {:.2}", row["action"], row["B"], row["v0_mps"], out[k].motion.position[0], x[k]); }
        worst = worst.max(error);
    }
    println!("brake: distance {worst:.4}");
    for row in rows("steer_constant").iter().chain(&rows("steer_combined")) {
        let [x, y, h, v, r] = ["x_m", "y_m", "heading_rad", "fwd_mps", "yaw_rate_rps"].map(|k| numbers(&row[k]));
        let l = numbers(&row["lat_mps"]);
        let out = drive(&car(row), row["v0_mps"].as_f64().unwrap(), &actions(row, x.len() - 1));
        let k = 20;
        let m = out[k].motion;
        let speed = v[k].hypot(l[k]);
        println!("  {} v0 {}: pos {:.3} offset {:.3} of {:.2} = {:.3}  heading {:.4} of {:.3} = {:.3}  speed {:.3}  yaw {:.3}", row["action"], row["v0_mps"],
            (m.position[0]-x[k]).hypot(m.position[1]-y[k]), m.position[1]-y[k], y[k], (m.position[1]-y[k]).abs()/y[k].abs().max(0.1), m.heading-h[k], h[k], (m.heading-h[k]).abs()/h[k].abs(), (m.speed()-speed).abs()/speed, (m.yaw_rate-r[k]).abs()/r[k].abs().max(0.01));
    }
    for row in rows("sequences") {
        let [x, y, h] = ["x_m", "y_m", "heading_rad"].map(|k| numbers(&row[k]));
        let out = drive(&car(&row), row["v0_mps"].as_f64().unwrap(), &actions(&row, x.len() - 1));
        let k = 20;
        let m = out[k].motion;
        println!("  sequence {}: {:.3} m {:.4} rad", row["kind"], (m.position[0]-x[k]).hypot(m.position[1]-y[k]), m.heading-h[k]);
    }
}
