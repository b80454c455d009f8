//! Benchmarks, and what the comparisons of contact queries with other methods' (`peers`, `scores`) are made of.

pub mod callgrind;
pub mod continuity;
pub mod engine;
pub mod method;
pub mod parry;
pub mod penalty;
pub mod point_shell;
pub mod reference;
pub mod representative;
pub mod scenarios;
