//! Benchmarks, and what the comparison of contact queries with other methods' (`peers`) is made of.

pub mod engine;
pub mod point_shell;
pub mod scenarios;
