//! Why something could not be measured.

use palpate::device::{DeviceError, PathError};
use palpate::errors::RendererError;

/// Why something could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The session could not be started.
    #[error(transparent)]
    Renderer(#[from] RendererError),
    /// The emulated device could not.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The hand's path is out of range.
    #[error(transparent)]
    Path(#[from] PathError),
    /// The objects never came within the tolerance, so that there is nothing to compare.
    #[error("{probe} never touches {scene} on the way that was tried; give another path")]
    NoContact {
        /// The probe's name.
        probe: String,
        /// The scene object's name.
        scene: String,
    },
}
