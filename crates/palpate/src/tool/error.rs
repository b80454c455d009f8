//! Errors in making a tool.

use palpate_dynamics::{BodyError, JointError};

use crate::settings::SettingsError;

/// A tool cannot be held with the settings.
#[derive(Debug, thiserror::Error)]
pub enum ToolError {
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A body has no usable mass or inertia.
    #[error("{name}: {source}")]
    Body {
        /// Name of the object.
        name: String,
        /// Cause.
        source: BodyError,
    },
    /// The hinge is invalid.
    #[error(transparent)]
    Joint(#[from] JointError),
    /// A tool with a hinge needs a gripper.
    #[error(
        "the device has no gripper, which a tool with a hinge needs; hold a rigid object, or give an emulated device a gripper"
    )]
    NoGripper,
}
