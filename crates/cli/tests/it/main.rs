//! The integration tests, linked once: a module a subject.

mod commands;
mod hostile_files;
#[cfg(all(feature = "view", target_os = "linux"))]
mod view;
