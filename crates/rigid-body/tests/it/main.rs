//! The integration tests, linked once: a module a subject.

mod analytic;
mod drops;
mod worlds;
