//! Integration tests, linked once, with a module per subject.

mod bodies;
mod colliders;
mod momentum;
mod rest;
mod session;
