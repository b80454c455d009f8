//! Relative placement of the two bodies.

use glam::{DQuat, DVec3};

/// Relative placement of the two bodies at an orientation of the first and an angle; world axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Linkage {
    /// Rotation of the second body.
    pub second: DQuat,
    /// e.
    pub axis: DVec3,
    /// c_1 and c_2.
    pub centres: [DVec3; 2],
    /// e × b.
    pub sweep: DVec3,
}
