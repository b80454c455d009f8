//! The integration tests, linked once: a module a subject.

mod cracks;
mod formats;
mod repair;
mod shapes;
mod shared_models;
mod textured;
mod union;
