//! Readers and rules of the written files, independent of the writers, and the tests of maps.

mod content_tests;
pub mod map;
mod map_tests;
pub mod play;
pub mod rules;
pub mod scenes;
pub mod xml;
