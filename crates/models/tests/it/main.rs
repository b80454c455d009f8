//! The integration tests, linked once: a module a subject.

mod implicit_models;
mod stitched_models;
