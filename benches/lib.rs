//! Benchmarks, and what the comparison of contact queries with other methods' is made of.

pub mod engine;
pub mod scenarios;
