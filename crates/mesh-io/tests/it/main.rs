//! The integration tests, linked once: a module a subject.

mod formats;
mod repair;
mod shared_models;
mod textured;
