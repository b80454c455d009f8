//! The integration tests, linked once: a module a subject.

mod articulated;
mod free_space;
mod friction;
mod hostile_input;
mod integrators;
mod motion;
mod no_allocation;
mod thirteen_variables;
