//! Messages to a planner that is a program: one line of JSON each.

use sage_core::motion::DT;
use serde::Serialize;

/// Version of the protocol.
pub(super) const PROTOCOL: u64 = 1;

/// A message as a line.
pub(super) fn line(name: &str, content: &impl Serialize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(1 << 13);
    bytes.extend_from_slice(b"{\"");
    bytes.extend_from_slice(name.as_bytes());
    bytes.extend_from_slice(b"\":");
    // Writing plain values into memory does not fail.
    let _ = serde_json::to_writer(&mut bytes, content);
    bytes.extend_from_slice(b"}\n");
    bytes
}

/// The first message to a program.
pub(super) fn hello() -> Vec<u8> {
    format!("{{\"hello\":{PROTOCOL},\"dt\":{DT}}}\n").into_bytes()
}
