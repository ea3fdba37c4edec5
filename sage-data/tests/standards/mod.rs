//! Readers and rules of the written files, independent of the writers.

pub mod map;
pub mod play;
pub mod rules;
pub mod scenes;
pub mod xml;
