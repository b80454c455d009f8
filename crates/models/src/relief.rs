//! Fine relief: the geometric texture that is laid over smooth models (§4.5.2).

use std::f64::consts::TAU;

/// Rises smoothly (C¹) from 0 at `from` to 1 at `to`.
pub(crate) fn smooth_step(from: f64, to: f64, value: f64) -> f64 {
    let x = ((value - from) / (to - from)).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// A ridge a turn of `phase`, from -1 to 1, with flattened crests and valleys.
pub(crate) fn ridges(phase: f64) -> f64 {
    let wave = (TAU * phase).cos();
    wave * (3.0 - wave * wave) / 2.0
}

/// Fraction of a relief that a mesh can resolve, 0 to 1: it decreases where fewer than six vertices fall on a
/// wavelength and is 0 below three. So a coarse mesh is the smooth model under the texture, not a random
/// sample of it.
pub(crate) fn resolved(wavelength: f64, edge: f64) -> f64 {
    smooth_step(3.0, 6.0, wavelength / edge)
}
