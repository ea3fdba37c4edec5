//! What a planner may answer to a step.

use serde_json::{Map, Value};

use crate::vehicle::{Action, Vehicle};

/// Most poses of a plan.
const MOST_POSES: usize = 200;
/// Farthest position of a plan from the car, metres.
const FARTHEST: f64 = 1000.0;

/// What a planner wants to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Steering and throttle.
    Control(Action),
    /// Poses every 0.1 s from now on, the first 0.1 s ahead, in the frame of the car; for how many steps they are followed.
    Plan {
        /// The poses.
        poses: Vec<PlannedPose>,
        /// Number of steps until the planner is asked again.
        again: usize,
        /// Whether the poses are taken as they are, without a tracker.
        is_exact: bool,
    },
}

/// A pose of a plan in the frame of the car: x ahead, y to the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedPose {
    /// Position, metres.
    pub position: [f64; 2],
    /// Heading, rad; `None` for that between the positions.
    pub heading: Option<f64>,
    /// Speed, m/s; `None` for that between the positions.
    pub speed: Option<f64>,
}

/// What is expected as an answer, in messages.
pub(in crate::policy) const EXPECTED: &str = "{\"steer\": …, \"throttle\": …}, {\"acceleration\": …, \"steering_angle\": …} or {\"plan\": [[x, y, heading], …]}";

impl Answer {
    /// The answer of an object of the protocol, to the driver of a car. Fields that are not known are ignored. `shown` is the
    /// answer in messages.
    ///
    /// *Errors*: what is wrong with it, in words.
    pub fn of_object(object: &Map<String, Value>, car: &Vehicle, shown: &str) -> Result<Self, String> {
        if let Some(error) = error_of(object) {
            return Err(error);
        }
        let is_given = |name: &str| object.contains_key(name);
        let kinds = [
            is_given("plan"),
            is_given("steer") || is_given("throttle"),
            is_given("acceleration") || is_given("steering_angle"),
        ];
        if kinds.iter().filter(|is_given| **is_given).count() > 1 {
            return Err(format!("`{shown}` is more than one kind of answer; expected one of {EXPECTED}"));
        }
        let again = again(object)?;
        if again > 1 && !kinds[0] {
            return Err("`again` is for plans; a control counts for one step".to_owned());
        }
        if is_given("follow") && !kinds[0] {
            return Err("`follow` is for plans; a control is carried out as it is".to_owned());
        }
        match kinds {
            [true, ..] => {
                let (poses, is_exact) = (plan(&object["plan"])?, is_exact(object)?);
                Ok(Self::Plan { poses, again, is_exact })
            }
            [_, true, _] => {
                let (steer, throttle) = (number(object, "steer")?, number(object, "throttle")?);
                Ok(Self::Control(Action { steer, throttle }.limited()))
            }
            [.., true] => {
                let throttle = car.throttle_for(number(object, "acceleration")?);
                let steer = number(object, "steering_angle")? / car.max_steering;
                Ok(Self::Control(Action { steer, throttle }.limited()))
            }
            _ => Err(format!("it answered `{shown}`; expected {EXPECTED}")),
        }
    }
}

/// The error that a planner says instead of an answer.
pub(in crate::policy) fn error_of(object: &Map<String, Value>) -> Option<String> {
    object.get("error").map(|error| match error {
        Value::String(error) => format!("it says: {}", shortened(error.as_bytes())),
        error => format!("it says: {}", shortened(error.to_string().as_bytes())),
    })
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

fn is_exact(object: &Map<String, Value>) -> Result<bool, String> {
    match object.get("follow") {
        None => Ok(false),
        Some(Value::String(how)) if how == "exact" || how == "tracked" => Ok(how == "exact"),
        Some(other) => {
            let found = shortened(other.to_string().as_bytes());
            Err(format!("`follow` is {found}; expected \"tracked\" or \"exact\""))
        }
    }
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

/// The beginning of a text as one printable line.
pub(in crate::policy) fn shortened(bytes: &[u8]) -> String {
    const LONGEST: usize = 120;
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(4 * LONGEST)]);
    let line = text.lines().next().unwrap_or_default();
    let shown: String = line.chars().map(|c| if c.is_control() { '?' } else { c }).take(LONGEST).collect();
    if shown.len() < line.len() || bytes.len() > 4 * LONGEST { format!("{shown}…") } else { shown }
}
