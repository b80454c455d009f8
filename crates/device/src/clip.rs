//! Clipping of a commanded wrench to what the device can render.

use glam::DVec3;
use palpate_core::Wrench;

use crate::{Specification, Status};

/// The part of the wrench along actuated axes, clipped to the device's peaks, and what was changed; zero if
/// the wrench is not finite.
pub(crate) fn clipped(wrench: &Wrench, specification: &Specification) -> (Wrench, Status) {
    let (wrench, refused) = finite(wrench);
    let force = DVec3::select(specification.actuated.translation.into(), wrench.force, DVec3::ZERO);
    let torque = DVec3::select(specification.actuated.rotation.into(), wrench.torque, DVec3::ZERO);
    let (force, force_clipped) = shortened(force, specification.peak_force);
    let (torque, torque_clipped) = shortened(torque, specification.peak_torque);
    let status = |clipped, status| if clipped { status } else { Status::OK };
    let events = refused
        | status(force_clipped, Status::FORCE_CLIPPED)
        | status(torque_clipped, Status::TORQUE_CLIPPED);
    (Wrench::new(force, torque), events)
}

/// The wrench, or zero if it is not finite, and whether it was refused.
pub(crate) fn finite(wrench: &Wrench) -> (Wrench, Status) {
    if wrench.is_finite() { (*wrench, Status::OK) } else { (Wrench::ZERO, Status::WRENCH_REFUSED) }
}

/// The vector, shortened to length `peak`, and whether it was.
fn shortened(vector: DVec3, peak: f64) -> (DVec3, bool) {
    let size = vector.abs().max_element();
    if size == 0.0 {
        return (vector, false);
    }
    // Scaled first: the square of a large finite component is not finite.
    let scaled = vector / size;
    if scaled.length() * size <= peak { (vector, false) } else { (scaled.normalize() * peak, true) }
}
