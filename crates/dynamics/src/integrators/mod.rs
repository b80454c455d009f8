//! Integrators of the grasped body's motion behind one trait (§5.2.2).
//!
//! All take one haptic frame, [`Frame`], under the same rules as [`semi_implicit_step`]: the device stands at
//! its sampled pose with its sampled velocity for the whole step, contacts only push, a step that cannot be
//! computed is refused with a reason, and nothing allocates or panics. They turn the body by the exponential
//! of a rotation vector, and they carry the angular momentum, so that a body of any inertia spins freely.

#[cfg(feature = "integrators")]
mod comparison;

use std::fmt::Debug;

use crate::body::BodyState;
use crate::step::{Frame, Step, semi_implicit_step};

#[cfg(feature = "integrators")]
pub use comparison::{
    ForwardEuler, FullyImplicit, IntegratorKind, QuasiStatic, RungeKutta4, SymplecticEuler, UnknownIntegrator,
};

/// A method that advances the grasped body by one haptic frame.
///
/// ```
/// use palpate_core::{Pose, glam::{DMat3, DVec3}};
/// use palpate_dynamics::{
///     Body, BodyState, DeviceMotion, Frame, Integrator, LinearContactModel, SemiImplicit, VirtualCoupling,
/// };
///
/// let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4)))?;
/// let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 200.0, 0.6);
/// let contacts = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
/// let device = DeviceMotion::at_rest(Pose::from_translation(DVec3::X * 0.01));
/// let frame =
///     Frame { body: &body, device: &device, coupling: &coupling, contacts: &contacts, gravity: DVec3::ZERO };
/// let step = SemiImplicit.step(&frame, &BodyState::default(), 1e-3);
/// assert!(step.status.is_ok() && step.state.twist.linear.x > 0.0);
/// # Ok::<(), palpate_dynamics::BodyError>(())
/// ```
pub trait Integrator: Debug + Send + Sync {
    /// The method's name.
    fn name(&self) -> &'static str;

    /// Advances the body by `dt` (s), and evaluates the wrench for the device at the new state. Refuses the
    /// same inputs as [`semi_implicit_step`].
    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step;
}

/// Semi-implicit backward Euler in six unknowns: [`semi_implicit_step`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct SemiImplicit;

impl Integrator for SemiImplicit {
    fn name(&self) -> &'static str {
        "semi-implicit"
    }

    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step {
        let Frame { body, device, coupling, contacts, gravity } = *frame;
        semi_implicit_step(body, state, device, coupling, contacts, gravity, dt)
    }
}
