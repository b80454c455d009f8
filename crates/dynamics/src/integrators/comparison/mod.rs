//! Integrators to compare the semi-implicit step with (§5.5.2, Fig. 5.6): not built into the engine unless
//! the feature `integrators` is on.

mod forward_euler;
mod fully_implicit;
mod kind;
mod quasi_static;
mod runge_kutta;
mod symplectic;

use glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use crate::body::BodyState;
use crate::jacobian::Block6;
use crate::step::Frame;

pub use forward_euler::ForwardEuler;
pub use fully_implicit::FullyImplicit;
pub use kind::{IntegratorKind, UnknownIntegrator};
pub use quasi_static::QuasiStatic;
pub use runge_kutta::RungeKutta4;
pub use symplectic::SymplecticEuler;

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

impl Block6 {
    /// Every entry times `factor`.
    fn scaled(&self, factor: f64) -> Self {
        Self {
            force_linear: self.force_linear * factor,
            force_angular: self.force_angular * factor,
            torque_linear: self.torque_linear * factor,
            torque_angular: self.torque_angular * factor,
        }
    }

    /// The rows of the 6×6 matrix.
    fn to_rows(self) -> [[f64; 6]; 6] {
        let row = |left: DVec3, right: DVec3| [left.x, left.y, left.z, right.x, right.y, right.z];
        let force = |i| row(self.force_linear.row(i), self.force_angular.row(i));
        let torque = |i| row(self.torque_linear.row(i), self.torque_angular.row(i));
        [force(0), force(1), force(2), torque(0), torque(1), torque(2)]
    }
}
