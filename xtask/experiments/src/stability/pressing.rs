//! Hand motion in the maps of simple shapes: it comes down, presses, rubs sideways and holds still.

use std::f64::consts::TAU;

use palpate::glam::DVec3;

/// Height above the touch at which the hand starts, and depth below it that the hand aims at, m.
pub const CLEARANCE: f64 = 3e-3;
pub const PRESS: f64 = 4e-3;
/// Time at which it has come down, and start and end of the rubbing, s.
const DOWN: f64 = 0.2;
const RUB: (f64, f64) = (0.25, 0.75);
/// Amplitude of the rubbing, m, and its frequency, Hz.
const WIDTH: f64 = 6e-3;
const RATE: f64 = 4.0;

/// Returns displacement (m) and velocity (m/s) of the hand from its start.
pub fn path(time: f64) -> (DVec3, DVec3) {
    let x = (time / DOWN).clamp(0.0, 1.0);
    let travel = CLEARANCE + PRESS;
    let (sunk, sinking) = (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / DOWN);
    let phase = TAU * RATE * (time.clamp(RUB.0, RUB.1) - RUB.0);
    let rubbing = if (RUB.0..RUB.1).contains(&time) { TAU * RATE * phase.cos() } else { 0.0 };
    (
        DVec3::new(WIDTH * phase.sin(), 0.0, -travel * sunk),
        DVec3::new(WIDTH * rubbing, 0.0, -travel * sinking),
    )
}
