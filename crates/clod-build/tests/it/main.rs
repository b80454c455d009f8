//! The integration tests, linked once: a module a subject.

mod decomposition;
mod hierarchy;
mod nasty;
mod shapes;
mod simplification;
