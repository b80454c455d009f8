//! Errors of measurements.

use palpate::collide::{ContactSetError, QueryError};
use palpate::device::{DeviceError, PathError};
use palpate::errors::RendererError;

/// Reason why something could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The session could not be started.
    #[error(transparent)]
    Renderer(#[from] RendererError),
    /// The emulated device could not be opened.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The hand's path is out of range.
    #[error(transparent)]
    Path(#[from] PathError),
    /// A contact query was refused.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// A contact set was refused.
    #[error(transparent)]
    ContactSet(#[from] ContactSetError),
    /// The objects never came within the tolerance, so there is nothing to compare.
    #[error("{probe} never touches {scene} on this path; give another path")]
    NoContact {
        /// Name of the probe.
        probe: String,
        /// Name of the scene object.
        scene: String,
    },
}
