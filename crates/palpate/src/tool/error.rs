//! Why a tool cannot be held.

use palpate_dynamics::{BodyError, IntegratorKind, JointError};

use crate::settings::SettingsError;

/// Why a tool cannot be held with the settings.
#[derive(Debug, thiserror::Error)]
pub enum ToolError {
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A body has no usable mass or inertia.
    #[error("{name}: {source}")]
    Body {
        /// The object's name.
        name: String,
        /// The reason.
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
    /// Tools with a hinge have an integrator of their own.
    #[error(
        "the integrator is {integrator}; a tool with a hinge takes only {}",
        IntegratorKind::SemiImplicit
    )]
    Integrator {
        /// The integrator in the settings.
        integrator: IntegratorKind,
    },
}
