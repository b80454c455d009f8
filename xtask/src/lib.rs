//! What project tasks share with tests and benchmarks.

pub mod linked;
