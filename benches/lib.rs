//! Shared by the benchmarks: methods that contact queries are compared with (`peers`, `scores`), and their
//! scenarios.

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
