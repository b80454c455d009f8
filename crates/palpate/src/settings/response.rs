//! How contacts act.

use serde::{Deserialize, Serialize};

/// How contacts act on the grasped object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Response {
    /// Surfaces do not pass one another: contacts are constraints.
    #[default]
    Constraints,
    /// Springs and dampers push surfaces apart.
    Penalty,
}
