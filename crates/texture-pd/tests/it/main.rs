//! Integration tests in one binary: one module per subject.

mod auto;
mod backends;
mod common;
mod derivatives;
mod domains;
mod energy;
mod folds;
#[cfg(feature = "gpu")]
mod gpu_device;
mod no_allocation;
mod ridges;
