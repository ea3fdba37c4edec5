//! Benchmarks.

pub mod speed;
