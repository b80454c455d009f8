//! The integration tests, linked once: a module a subject.

mod commands;
#[cfg(all(feature = "view", target_os = "linux"))]
mod view;
