//! Integrators of the grasped body's motion behind one trait (§5.2.2).
//!
//! All take one haptic frame, [`Frame`], under the same rules as [`semi_implicit_step`]: the device stands at
//! its sampled pose with its sampled velocity for the whole step, contacts only push, what cannot be computed
//! is refused with a reason, and nothing allocates or panics. They turn the body by the exponential of a
//! rotation vector, and they carry the angular momentum, so that a body of any inertia spins freely.
//!
//! | integrator | order | stiff springs and light bodies |
//! |---|---|---|
//! | [`SemiImplicit`] | 1 | stable; one linear system for each change of contacts |
//! | [`FullyImplicit`] | 1 | stable; some linear systems more |
//! | [`ForwardEuler`] | 1 | diverges: a mode of rate b/m needs dt b/m < 2 |
//! | [`SymplecticEuler`] | 1 | diverges: later than forward Euler without damping, as early with much |
//! | [`RungeKutta4`] | 4 while no contact opens or closes | diverges: dt b/m < 2.785 |
//! | [`QuasiStatic`] | no dynamics | nothing to diverge; the body has no mass |

mod forward_euler;
mod fully_implicit;
mod kind;
mod quasi_static;
mod runge_kutta;
mod symplectic;

use glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use crate::body::BodyState;
use crate::step::{Frame, Step, semi_implicit_step};

pub use forward_euler::ForwardEuler;
pub use fully_implicit::FullyImplicit;
pub use kind::{IntegratorKind, UnknownIntegrator};
pub use quasi_static::QuasiStatic;
pub use runge_kutta::RungeKutta4;
pub use symplectic::SymplecticEuler;

/// A way to advance the grasped body by one haptic frame.
///
/// ```
/// use palpate_core::{Pose, glam::{DMat3, DVec3}};
/// use palpate_dynamics::{
///     Body, BodyState, DeviceMotion, Frame, Integrator, LinearContactModel, RungeKutta4, VirtualCoupling,
/// };
///
/// let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4)))?;
/// let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 200.0, 0.6);
/// let contacts = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
/// let device = DeviceMotion::at_rest(Pose::from_translation(DVec3::X * 0.01));
/// let frame =
///     Frame { body: &body, device: &device, coupling: &coupling, contacts: &contacts, gravity: DVec3::ZERO };
/// let step = RungeKutta4.step(&frame, &BodyState::default(), 1e-3);
/// assert!(step.status.is_ok() && step.state.twist.linear.x > 0.0);
/// # Ok::<(), palpate_dynamics::BodyError>(())
/// ```
pub trait Integrator {
    /// Advances the body by `dt` (s), and evaluates at the new state the wrench for the device. Refuses what
    /// [`semi_implicit_step`] refuses, in the same way.
    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step;
}

/// Semi-implicit backward Euler in six unknowns: [`semi_implicit_step`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct SemiImplicit;

impl Integrator for SemiImplicit {
    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step {
        let Frame { body, device, coupling, contacts, gravity } = *frame;
        semi_implicit_step(body, state, device, coupling, contacts, gravity, dt)
    }
}

impl Frame<'_> {
    /// The wrench on the body about its centre of mass, and the contacts that push.
    fn load(&self, state: &BodyState) -> (Wrench, u64) {
        let touch = self.contacts.evaluate(state);
        let (held, _) = self.coupling.wrenches(state, self.device);
        let weight = Wrench::new(self.gravity * self.body.mass, DVec3::ZERO);
        (held + touch.wrench + weight, touch.active)
    }

    /// The angular velocity (rad/s) of the body at an orientation with an angular momentum (kg·m²/s), in
    /// world axes, where `inverse` is the inverse of the inertia in body axes.
    fn spin(pose: &Pose, inverse: &DMat3, momentum: DVec3) -> DVec3 {
        pose.rotation * (*inverse * (pose.rotation.conjugate() * momentum))
    }

    /// The velocity after the momenta have grown by an impulse, at the orientation of `pose`.
    fn pushed(&self, state: &BodyState, impulse: &Wrench, inverse: &DMat3, pose: &Pose) -> Twist {
        let momentum = self.body.angular_momentum(state) + impulse.torque;
        Twist {
            linear: state.twist.linear + impulse.force / self.body.mass,
            angular: Self::spin(pose, inverse, momentum),
        }
    }
}
