//! Integration tests in one binary: one module per subject.

mod analytic;
mod drops;
mod worlds;
