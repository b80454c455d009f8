//! The integration tests, linked once: a module a subject.

mod assembled_models;
mod implicit_models;
mod stitched_models;
