//! What a planner's program answers: one line of JSON for each message. Fields that are not known are ignored.

use serde_json::{Map, Value};

use super::messages::PROTOCOL;
use crate::{
    policy::planner::{Answer, EXPECTED, error_of, shortened},
    vehicle::Vehicle,
};

/// Largest difference of two times that are the same, s.
const SAME_TIME: f64 = 1e-6;

/// What a planner says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Greeting {
    /// Whether it wants the numbers that learning drivers see.
    pub(super) wants_observation: bool,
    /// Whether it wants to know where its recording ends.
    pub(super) wants_goal: bool,
    /// The ways of following its plans that it offers, the default first.
    pub(super) follows: Vec<String>,
}

/// Most ways of following that a planner may offer, and their longest name.
const MOST_WAYS: usize = 8;
const LONGEST_WAY: usize = 40;

/// Whether a line is an object of JSON.
pub(super) fn is_object(line: &[u8]) -> bool {
    serde_json::from_slice::<Map<String, Value>>(line).is_ok()
}

/// The object of a line.
fn object(line: &[u8], expected: &str) -> Result<Map<String, Value>, String> {
    let shown = shortened(line);
    let value: Value = serde_json::from_slice(line)
        .map_err(|error| format!("it answered `{shown}`, which is no JSON ({error}); expected {expected}, and logs on standard error"))?;
    let Value::Object(object) = value else {
        return Err(format!("it answered `{shown}`; expected {expected}"));
    };
    match error_of(&object) {
        Some(error) => Err(error),
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
    let wants = |name: &str| match object.get(name) {
        None | Some(Value::Bool(false)) => Ok(false),
        Some(Value::Bool(true)) => Ok(true),
        Some(other) => {
            let found = shortened(other.to_string().as_bytes());
            Err(format!("`{name}` is {found}; expected true or false"))
        }
    };
    Ok(Greeting {
        wants_observation: wants("observation")?,
        wants_goal: wants("goal")?,
        follows: follows(object.get("follows"))?,
    })
}

fn follows(value: Option<&Value>) -> Result<Vec<String>, String> {
    let Some(value) = value else { return Ok(Vec::new()) };
    let is_name = |name: &&str| (1..=LONGEST_WAY).contains(&name.len()) && !name.contains(char::is_control);
    let names = value.as_array().filter(|ways| ways.len() <= MOST_WAYS);
    let names: Option<Vec<&str>> =
        names.and_then(|ways| ways.iter().map(|way| way.as_str().filter(is_name)).collect());
    let is_once = |names: &Vec<&str>| (1..names.len()).all(|k| !names[..k].contains(&names[k]));
    names.filter(is_once).map(|names| names.into_iter().map(str::to_owned).collect()).ok_or_else(|| {
        let found = shortened(value.to_string().as_bytes());
        format!("`follows` is {found}; expected a list of up to {MOST_WAYS} different short names")
    })
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

/// The answer to a step, of the driver of a car, and whether it says which step it is of: by the `t` of its message.
pub(super) fn step(line: &[u8], t: f64, car: &Vehicle) -> Result<(Answer, bool), String> {
    let object = object(line, EXPECTED)?;
    let of = object.get("t").and_then(Value::as_f64);
    if let Some(of) = of.filter(|of| !((of - t).abs() < SAME_TIME)) {
        return Err(format!(
            "it answered to t = {of}, and was asked at t = {t:.1}: it printed more answers than it got messages"
        ));
    }
    Ok((Answer::of_object(&object, car, &shortened(line))?, of.is_some()))
}

/// Whether a line is an answer to a step that has passed, which says so.
pub(super) fn is_late(line: &[u8]) -> bool {
    serde_json::from_slice::<Map<String, Value>>(line).is_ok_and(|object| object.contains_key("t"))
}
