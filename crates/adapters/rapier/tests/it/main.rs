//! The integration tests, linked once: a module a subject.

mod bodies;
mod colliders;
mod momentum;
mod rest;
mod session;
