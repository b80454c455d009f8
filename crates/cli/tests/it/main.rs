//! Integration tests in one binary, with one module per subject.

mod cases;
mod commands;
#[cfg(all(feature = "view", target_os = "linux"))]
mod view;
