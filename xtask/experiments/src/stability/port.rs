//! Map of the device's port: whether a session, with the device, is passive for whatever hand holds it.
//!
//! # What is tested
//!
//! The hand holds a handle of mass and damping diag(b, b_θ) = D. At each sample k the session reads its
//! displacement x_k, of six components, and answers with a wrench w_k = −H x that is held for a period T from
//! a time t_d = (n + φ) T on. [`driven`] tells the handle where to be and records the wrenches, so that H is
//! measured alone, contacts, filters and all. The mass stores energy and needs no measurement.
//!
//! Between two samples the handle moves by Δ = x_{k+1} − x_k, and has to be at y after a time φ T, when the
//! wrench changes from w_{k−n−1} to w_{k−n}. The damping takes least energy on the way if both parts are
//! straight (Colgate and Schenkel 1997). With y at its worst, the sum over k of
//!
//! Δᵀ D Δ/T − Δᵀ (φ w_{k−n−1} + (1 − φ) w_{k−n}) − ¼ T φ (1 − φ) (w_{k−n} − w_{k−n−1})ᵀ D⁻¹ (w_{k−n} −
//! w_{k−n−1})
//!
//! is what the hand has to give. It is not negative, for every motion, if and only if
//!
//! C(ω) = D − Herm(q σ) − ¼ T² φ (1 − φ) Hᴴ D⁻¹ H with q = T/(2 (1 − cos ωT)) (1 − z⁻¹) z⁻ⁿ H(z), σ = 1 − φ
//! + φ z⁻¹ and z = e^(jωT)
//!
//! has no negative eigenvalue up to half the sampling rate, Herm(A) being (A + Aᴴ)/2. For one axis that is
//! the condition in `palpate_dynamics`'s `port.rs`. 2 C is Z + Zᴴ for the impedance Z = D + T/(z − 1) z⁻ⁿ σ
//! H, from the mean velocity in a period to the mean wrench. The impedance is tested and not its inverse, the
//! admittance: a session takes motions and gives wrenches, one is positive real where the other is, and the
//! inverse would carry the noise of directions in which little is felt. Eigenvalues are those of D^(−½) C
//! D^(−½), the part of the device's damping that is left.
//!
//! # Encoder steps and the device's friction
//!
//! Without encoder steps the device's friction is left out. With them it has to absorb the rounding of
//! positions and the lag of the estimates between steps ([`multisine`] moves by several steps), so that it
//! counts: D is raised by the damping that takes as much energy from the multisines as the friction does, f_c
//! times the mean speed over the mean square of the speed. The table also has the least eigenvalue without
//! it.
//!
//! # Friction of contacts
//!
//! Small motions about rest leave most contacts stuck, so that a state with friction is nearly linear, and
//! what slips is counted as noise. About a steady sliding the small-signal response says nothing of energy: a
//! force that is μ times what presses responds to the pressing alone, so that its response is not symmetric
//! and looks active at low frequencies, but the sliding itself pays for it. Sliding is for the search of
//! [`hands`], which counts all energy.

mod account;
mod ball;
mod boundary;
mod certificate;
pub mod driven;
mod frozen;
mod hands;
mod multisine;
mod passivity;
mod rendered;
mod states;
#[cfg(test)]
mod tests;

use super::grid::Plan;
use super::page::Section;

/// Makes the map.
///
/// # Errors
/// If a model cannot be made, or a session cannot start.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let mut section = Section { title: "Port: passive for every hand", ..Section::default() };
    passivity::map(plan, &mut section)?;
    boundary::map(plan, &mut section)?;
    hands::map(plan, &mut section)?;
    Ok(section)
}
