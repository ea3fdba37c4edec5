//! What a planner answers: one line of JSON for each message. Fields that are not known are ignored.

use serde_json::{Map, Value};

use super::{messages::PROTOCOL, program::shortened};
use crate::vehicle::{Action, Vehicle};

/// Most poses of a plan.
const MOST_POSES: usize = 200;
/// Farthest position of a plan from the car, metres.
const FARTHEST: f64 = 1000.0;

/// What a planner says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Greeting {
    /// Whether it wants the numbers that learning drivers see.
    pub(super) wants_observation: bool,
}

/// What a planner wants to do.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Answer {
    /// Steering and throttle.
    Control(Action),
    /// Poses every 0.1 s from now on, the first 0.1 s ahead, in the frame of the car; for how many steps they are followed.
    Plan {
        /// The poses.
        poses: Vec<PlannedPose>,
        /// Number of steps until the planner is asked again.
        again: usize,
    },
}

/// A pose of a plan in the frame of the car: x ahead, y to the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlannedPose {
    /// Position, metres.
    pub(super) position: [f64; 2],
    /// Heading, rad; `None` for that between the positions.
    pub(super) heading: Option<f64>,
    /// Speed, m/s; `None` for that between the positions.
    pub(super) speed: Option<f64>,
}

/// The object of a line.
fn object(line: &[u8], expected: &str) -> Result<Map<String, Value>, String> {
    let shown = shortened(line);
    let value: Value = serde_json::from_slice(line)
        .map_err(|error| format!("it answered `{shown}`, which is no JSON ({error}); expected {expected}"))?;
    let Value::Object(object) = value else {
        return Err(format!("it answered `{shown}`; expected {expected}"));
    };
    match object.get("error") {
        Some(Value::String(error)) => Err(format!("it says: {}", shortened(error.as_bytes()))),
        Some(error) => Err(format!("it says: {}", shortened(error.to_string().as_bytes()))),
        None => Ok(object),
    }
}

/// The answer to `hello`.
pub(super) fn greeting(line: &[u8]) -> Result<Greeting, String> {
    let expected = format!("{{\"hello\": {PROTOCOL}}}");
    let object = object(line, &expected)?;
    match object.get("hello").map(|version| (version, version.as_u64())) {
        Some((_, Some(PROTOCOL))) => {}
        Some((version, _)) => {
            return Err(format!(
                "it speaks version {} of the protocol; this program speaks version {PROTOCOL}",
                shortened(version.to_string().as_bytes())
            ));
        }
        None => {
            return Err(format!("it answered `{}` without `hello`; expected {expected}", shortened(line)));
        }
    }
    let wants_observation = match object.get("observation") {
        None | Some(Value::Bool(false)) => false,
        Some(Value::Bool(true)) => true,
        Some(other) => {
            return Err(format!(
                "`observation` is {}; expected true or false",
                shortened(other.to_string().as_bytes())
            ));
        }
    };
    Ok(Greeting { wants_observation })
}

/// The answer to `reset`.
pub(super) fn ready(line: &[u8]) -> Result<(), String> {
    const EXPECTED: &str = "{\"ready\": true}";
    let object = object(line, EXPECTED)?;
    if object.get("ready") == Some(&Value::Bool(true)) {
        return Ok(());
    }
    Err(format!("it answered `{}` to `reset`; expected {EXPECTED}", shortened(line)))
}

/// The answer to `step`, of the driver of a car.
pub(super) fn step(line: &[u8], car: &Vehicle) -> Result<Answer, String> {
    const EXPECTED: &str = "{\"steer\": …, \"throttle\": …}, {\"acceleration\": …, \"steering_angle\": …} or {\"plan\": [[x, y, heading], …]}";
    let object = object(line, EXPECTED)?;
    let is_given = |name: &str| object.contains_key(name);
    let kinds = [
        is_given("plan"),
        is_given("steer") || is_given("throttle"),
        is_given("acceleration") || is_given("steering_angle"),
    ];
    if kinds.iter().filter(|is_given| **is_given).count() > 1 {
        return Err(format!(
            "`{}` is more than one kind of answer; expected one of {EXPECTED}",
            shortened(line)
        ));
    }
    let again = again(&object)?;
    if again > 1 && !kinds[0] {
        return Err("`again` is for plans; a control counts for one step".to_owned());
    }
    match kinds {
        [true, ..] => Ok(Answer::Plan { poses: plan(&object["plan"])?, again }),
        [_, true, _] => Ok(Answer::Control(
            Action { steer: number(&object, "steer")?, throttle: number(&object, "throttle")? }.limited(),
        )),
        [.., true] => {
            let throttle = car.throttle_for(number(&object, "acceleration")?);
            let steer = number(&object, "steering_angle")? / car.max_steering;
            Ok(Answer::Control(Action { steer, throttle }.limited()))
        }
        _ => Err(format!("it answered `{}`; expected {EXPECTED}", shortened(line))),
    }
}

/// A number of an answer. JSON has no numbers that are not finite.
fn number(object: &Map<String, Value>, name: &str) -> Result<f64, String> {
    match object.get(name) {
        Some(value) => value.as_f64().ok_or_else(|| {
            format!("`{name}` is {}; expected a number", shortened(value.to_string().as_bytes()))
        }),
        None => {
            let given: Vec<String> = object.keys().map(|key| shortened(key.as_bytes())).collect();
            Err(format!("`{name}` is missing; it gives `{}`", given.join("`, `")))
        }
    }
}

fn again(object: &Map<String, Value>) -> Result<usize, String> {
    let Some(value) = object.get("again") else { return Ok(1) };
    let count = value.as_u64().filter(|count| (1..=MOST_POSES as u64).contains(count));
    count.map(|count| count as usize).ok_or_else(|| {
        let found = shortened(value.to_string().as_bytes());
        format!("`again` is {found}; expected a number of steps from 1 to {MOST_POSES}")
    })
}

fn plan(value: &Value) -> Result<Vec<PlannedPose>, String> {
    let expected = format!("1 to {MOST_POSES} rows [x, y], [x, y, heading] or [x, y, heading, speed]");
    let Value::Array(rows) = value else {
        return Err(format!("`plan` is {}; expected {expected}", shortened(value.to_string().as_bytes())));
    };
    if rows.is_empty() || rows.len() > MOST_POSES {
        return Err(format!("`plan` has {} rows; expected {expected}", rows.len()));
    }
    let pose = |(k, row): (usize, &Value)| {
        let wrong =
            || format!("row {k} of `plan` is {}; expected {expected}", shortened(row.to_string().as_bytes()));
        let numbers: Option<Vec<f64>> =
            row.as_array().and_then(|row| row.iter().map(Value::as_f64).collect());
        let numbers = numbers.ok_or_else(wrong)?;
        let [x, y, rest @ ..] = &numbers[..] else { return Err(wrong()) };
        if rest.len() > 2 {
            return Err(wrong());
        }
        if x.hypot(*y) > FARTHEST {
            return Err(format!(
                "row {k} of `plan` is {:.0} m away; expected positions in the frame of the car, within {FARTHEST} m",
                x.hypot(*y)
            ));
        }
        Ok(PlannedPose { position: [*x, *y], heading: rest.first().copied(), speed: rest.get(1).copied() })
    };
    rows.iter().enumerate().map(pose).collect()
}
