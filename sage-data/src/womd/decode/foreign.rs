//! Names what a record holds if it is no `Scenario`.

use crate::womd::message_error::{MessageError, MessageProblem, Place};
use crate::womd::wire::{Field, Message, Value};

/// The error for a record that is no `Scenario`, for `reason`.
pub(super) fn refused(record: &[u8], reason: &str) -> MessageError {
    let text = known(record).unwrap_or_else(|| format!("the record is no Scenario message: {reason}"));
    MessageError { offset: 0, field: String::new(), problem: MessageProblem::Foreign(text) }
}

/// The error of a record whose first fields are not those of a `Scenario`.
pub(super) fn explained(record: &[u8], error: MessageError) -> MessageError {
    match (known(record), error) {
        (Some(text), error) => MessageError {
            offset: error.offset,
            field: String::new(),
            problem: MessageProblem::Foreign(text),
        },
        // A value of the right type is the better explanation: only a `Scenario` has it.
        (None, error @ MessageError { problem: MessageProblem::Value { .. }, .. }) => error,
        (None, error) => {
            let text = format!("the record is no Scenario message, or damaged: {error}");
            MessageError {
                offset: error.offset,
                field: String::new(),
                problem: MessageProblem::Foreign(text),
            }
        }
    }
}

/// What a record is, if it begins like another message of the Waymo Open Dataset.
fn known(record: &[u8]) -> Option<String> {
    let outer = first(record)?;
    let inner = first(outer)?;
    let is_text = |bytes: &[u8], allowed: fn(u8) -> bool| {
        (4..200).contains(&bytes.len()) && bytes.iter().all(|byte| allowed(*byte))
    };
    // Example { features { feature { key, value } } }: keys such as `roadgraph_samples/xyz`.
    if first(inner).is_some_and(|key| is_text(key, |b| b.is_ascii_alphanumeric() || b"_/".contains(&b))) {
        return Some(
            "the record is a tf.Example; use the files of the folder `scenario/` of the Waymo Open Motion Dataset instead of those of `tf_example/`"
                .to_owned(),
        );
    }
    // Frame { context { name } }.
    is_text(inner, |b| b.is_ascii_alphanumeric() || b"_-".contains(&b)).then(|| {
        "the record is a Frame of the Waymo perception dataset, which has no scenes; use the files of the folder `scenario/` of the Waymo Open Motion Dataset"
            .to_owned()
    })
}

/// The bytes of the first field of a message if it is field 1 of bytes.
fn first(bytes: &[u8]) -> Option<&[u8]> {
    match (Message { bytes, offset: 0 }).fields().next(&Place::ROOT) {
        Ok(Some(Field { number: 1, value: Value::Bytes(bytes), .. })) => Some(bytes),
        _ => None,
    }
}
