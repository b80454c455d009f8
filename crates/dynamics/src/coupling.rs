//! The virtual coupling: a spring and damper between the haptic device and the grasped body (§5.3).
//!
//! With a = R c the lever arm of the grasp point in world axes,
//!
//! - F_c = k_c (x_h − x − a) + b_c (v_h − v − ω × a)          (Eq. 5.15),
//! - T_c = a × F_c + k_θ u_c + b_θ (ω_h − ω)                  (Eq. 5.16),
//! - u_c is the rotation vector of the shorter rotation from the grasp frame R q_c to the device frame (Eq.
//!   5.17–5.19).
//!
//! Departures: Eq. 5.15 prints the lever arm in body axes; Eq. 5.18 lacks a normalisation; the derivatives
//! are by rotation vector, not quaternion, and −J_r⁻¹(u_c) replaces Eq. 5.25 (see the crate's `rotation`
//! module). Both springs may saturate (Eq. 5.30–5.31); the dampers do not.
//!
//! At ‖u_c‖ = π the shorter rotation changes direction, and so would a spring's torque. So the angular spring
//! fades from 150° on and exerts nothing at 180° ([`angular_spring_torque`](crate::angular_spring_torque)):
//! the torque is continuous through a half turn, beyond which the body is drawn to the next whole turn.

use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use crate::algebra::rotation::{cross_columns, inverse_right_jacobian, skew, skew_skew};
use crate::body::{Body, BodyState, principal_moments};
use crate::jacobian::{Block6, WrenchJacobian, outer};
use crate::saturation::{angular_spring_energy, angular_spring_torque, spring_energy, spring_force};

/// Pose and twist of the haptic device in the virtual world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeviceMotion {
    /// Placement of the device's handle: **x**_h and q_h.
    pub pose: Pose,
    /// Velocity of the handle's origin **v**_h and angular velocity **ω**_h, world axes.
    pub twist: Twist,
}

impl DeviceMotion {
    /// A device at rest.
    pub const fn at_rest(pose: Pose) -> Self {
        Self { pose, twist: Twist::ZERO }
    }

    /// Whether the pose is a rigid placement and every number is finite.
    pub fn is_valid(&self) -> bool {
        self.pose.is_valid() && self.twist.is_finite()
    }
}

/// Gains and grasp frame of the virtual coupling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VirtualCoupling {
    /// k_c, N/m.
    pub linear_stiffness: f64,
    /// b_c, N·s/m.
    pub linear_damping: f64,
    /// k_θ, N·m/rad.
    pub angular_stiffness: f64,
    /// b_θ, N·m·s/rad.
    pub angular_damping: f64,
    /// The device frame in the body frame when grasped: the coupling position **c** about the centre of
    /// mass, m, and the coupling orientation q_c, both in body axes.
    pub grasp: Pose,
    /// Limit of the linear spring's force, N; infinite for a linear spring.
    pub max_force: f64,
    /// Limit of the angular spring's torque, N·m; infinite for a linear spring.
    pub max_torque: f64,
}

/// Wrenches of the coupling and their derivatives at one state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CouplingResponse {
    /// F_c and T_c on the body, about its centre of mass.
    pub on_body: Wrench,
    /// The reaction on the device, about the handle's origin: −F_c and −(k_θ u_c + b_θ (ω_h − ω)).
    pub on_device: Wrench,
    /// Derivatives of `on_body` by the body's placement and velocity.
    pub jacobian: WrenchJacobian,
}

/// The coupling's wrench and the terms of its derivatives, in two parts that the step treats differently.
///
/// Stiffness and damping have a negative semidefinite symmetric part. They are those of a spring and damper
/// that resist motion of the point at `arm` in all directions alike, of the `softening` along the deviation,
/// and of the angular spring and damper. The geometric part is indefinite.
pub(crate) struct CouplingLinearisation {
    pub on_body: Wrench,
    pub arm: DVec3,
    /// Secant stiffness of the spring, N/m.
    pub stiffness: f64,
    /// Damping, N·s/m.
    pub damping: f64,
    /// Tangent minus secant stiffness of the spring along its deviation, N/m (negative, or zero while
    /// linear), and that direction.
    pub softening: (f64, DVec3),
    /// Stiffness of the couple against φ, N·m/rad.
    pub angular_stiffness: DMat3,
    /// Angular damping, N·m·s/rad.
    pub angular_damping: f64,
    /// Derivatives (force, torque) by φ alone: from the turning of the lever arm under a constant force and
    /// velocity, and the negative stiffness of an angular spring that fades.
    pub geometric: (DMat3, DMat3),
}

impl CouplingLinearisation {
    /// The derivatives by the stiffness and damping part.
    fn material(&self) -> WrenchJacobian {
        let at_arm = |gain: f64| {
            let arm = skew(self.arm) * gain;
            Block6 {
                force_linear: scalar(-gain),
                force_angular: arm,
                torque_linear: -arm,
                torque_angular: skew_skew(self.arm, self.arm) * gain,
            }
        };
        let (softening, axis) = self.softening;
        let lever = self.arm.cross(axis);
        let mut pose =
            at_arm(self.stiffness) + Block6::outer((axis, lever), (axis * -softening, lever * -softening));
        pose.torque_angular -= self.angular_stiffness;
        let mut twist = at_arm(self.damping);
        twist.torque_angular -= scalar(self.angular_damping);
        WrenchJacobian { pose, twist }
    }

    /// Change of the springs' wrench when the body moves by a small displacement (m, rad).
    pub fn drift(&self, displacement: &Twist) -> Wrench {
        let moved = displacement.velocity_at(self.arm);
        let (softening, axis) = self.softening;
        let force = moved * -self.stiffness - axis * (softening * axis.dot(moved));
        Wrench { force, torque: self.arm.cross(force) - self.angular_stiffness * displacement.angular }
    }
}

/// The quantities that the wrench and its derivatives share.
struct Deviation {
    arm: DVec3,
    offset: DVec3,
    turn: DVec3,
    force: DVec3,
    /// k_θ u_c + b_θ (ω_h − ω).
    couple: DVec3,
}

impl VirtualCoupling {
    /// Makes a coupling with the given stiffnesses (N/m, N·m/rad), damped critically for `body` held at
    /// `grasp`, with springs that do not saturate.
    ///
    /// b_c = 2 √(k_c m (1 + ρ)) and b_θ = 2 √(k_θ J (1 + ρ)), where J is the largest principal moment of
    /// inertia about the grasp point, where the linear spring holds the body, and ρ = a √(m/J) for a grasp
    /// point at the distance a from the centre of mass. Held at the centre of mass (ρ = 0), the translation
    /// and the slowest rotation are damped critically, the other rotations more. Held elsewhere, translation
    /// and rotation are coupled: their masses are no larger than those of two separate motions 1 + ρ times as
    /// heavy, ρ < 1. Then no mode of a rod held anywhere is damped below 0.9 of critical, against 0.72
    /// without the factor (the test `no_mode_of_a_rod_is_underdamped`).
    pub fn critically_damped(
        body: &Body,
        grasp: Pose,
        linear_stiffness: f64,
        angular_stiffness: f64,
    ) -> Self {
        let moment = principal_moments(&body.inertia_about(grasp.translation)).z;
        let shared = 1.0 + grasp.translation.length() * (body.mass / moment).sqrt();
        Self {
            linear_stiffness,
            linear_damping: 2.0 * (linear_stiffness * body.mass * shared).sqrt(),
            angular_stiffness,
            angular_damping: 2.0 * (angular_stiffness * moment * shared).sqrt(),
            grasp,
            max_force: f64::INFINITY,
            max_torque: f64::INFINITY,
        }
    }

    /// The grasp frame with which a device at `device` holds a body at `body`, each in the world (§5.3.1,
    /// Fig. 5.3a).
    pub fn grasp_at(body: &Pose, device: &Pose) -> Pose {
        body.inverse() * *device
    }

    /// The body's placement at which the coupling is relaxed for a device at `device`.
    pub fn relaxed_pose(&self, device: &Pose) -> Pose {
        *device * self.grasp.inverse()
    }

    /// F_c, T_c and the reaction on the device, without derivatives.
    pub fn wrenches(&self, state: &BodyState, device: &DeviceMotion) -> (Wrench, Wrench) {
        let d = self.deviation(state, device);
        (
            Wrench { force: d.force, torque: d.arm.cross(d.force) + d.couple },
            Wrench { force: -d.force, torque: -d.couple },
        )
    }

    /// F_c, T_c, the reaction on the device, and the derivatives (§5.3.2, corrected).
    pub fn evaluate(&self, state: &BodyState, device: &DeviceMotion) -> CouplingResponse {
        let (on_body, on_device) = self.wrenches(state, device);
        let parts = self.linearise(state, device);
        let mut jacobian = parts.material();
        jacobian.pose.force_angular += parts.geometric.0;
        jacobian.pose.torque_angular += parts.geometric.1;
        CouplingResponse { on_body, on_device, jacobian }
    }

    /// Energy stored in the two springs, J.
    pub fn potential_energy(&self, state: &BodyState, device: &DeviceMotion) -> f64 {
        let d = self.deviation(state, device);
        spring_energy(self.linear_stiffness, d.offset.length(), self.max_force)
            + angular_spring_energy(self.angular_stiffness, d.turn.length(), self.max_torque)
    }

    #[inline(always)]
    fn deviation(&self, state: &BodyState, device: &DeviceMotion) -> Deviation {
        let arm = state.pose.transform_vector(self.grasp.translation);
        let offset = device.pose.translation - state.pose.translation - arm;
        let held: DQuat = state.pose.rotation * self.grasp.rotation;
        let turn = Pose::new(DVec3::ZERO, held).rotation_vector_to(&device.pose);
        let force = spring(self.linear_stiffness, offset, self.max_force)
            + self.linear_damping * (device.twist.linear - state.twist.velocity_at(arm));
        let couple = angular_spring(self.angular_stiffness, turn, self.max_torque)
            + self.angular_damping * (device.twist.angular - state.twist.angular);
        Deviation { arm, offset, turn, force, couple }
    }

    #[inline(always)]
    pub(crate) fn linearise(&self, state: &BodyState, device: &DeviceMotion) -> CouplingLinearisation {
        let d = self.deviation(state, device);
        // The tangent stiffness is secant · 1 + softening · û ûᵀ with û along the deviation.
        let (stiffness, softening, along) =
            tangent_stiffness(self.linear_stiffness, d.offset, self.max_force);
        // Likewise S_θ J_r⁻¹, where ûᵀ J_r⁻¹ = ûᵀ.
        let (secant, angular_softening, axis) =
            angular_tangent_stiffness(self.angular_stiffness, d.turn, self.max_torque);
        let mut angular_stiffness = inverse_right_jacobian(d.turn) * secant;
        // A spring that fades has a negative slope: that part is not semidefinite and goes to the geometric
        // one.
        let falling = (secant + angular_softening).min(0.0);
        let mut faded = DMat3::ZERO;
        if angular_softening != 0.0 {
            angular_stiffness += outer(axis, axis * (angular_softening - falling));
            faded = outer(axis, axis * falling);
        }
        // The damper sees the arm turn too: −b_c ω* (∂a/∂φ), the term that Eq. 5.23 lacks.
        let swept = skew_skew(state.twist.angular * self.linear_damping, d.arm);
        CouplingLinearisation {
            on_body: Wrench { force: d.force, torque: d.arm.cross(d.force) + d.couple },
            arm: d.arm,
            stiffness,
            damping: self.linear_damping,
            softening: (softening, along),
            angular_stiffness,
            angular_damping: self.angular_damping,
            // Eq. 5.24 by a turn φ, with a = R c, without the springs: a* ∂F_c/∂φ − F_c* ∂a/∂φ, where ∂a/∂φ =
            // −a*.
            geometric: (swept, cross_columns(d.arm, &swept) + skew_skew(d.force, d.arm) - faded),
        }
    }
}

fn scalar(value: f64) -> DMat3 {
    DMat3::from_diagonal(DVec3::splat(value))
}

/// The linear spring's force for a deviation.
fn spring(stiffness: f64, deviation: DVec3, limit: f64) -> DVec3 {
    if limit == f64::INFINITY {
        return deviation * stiffness;
    }
    let length = deviation.length();
    if length == 0.0 {
        return DVec3::ZERO;
    }
    deviation * (spring_force(stiffness, length, limit).0 / length)
}

/// The angular spring's torque for a rotation vector.
fn angular_spring(stiffness: f64, turn: DVec3, limit: f64) -> DVec3 {
    let angle = turn.length();
    if angle == 0.0 {
        return DVec3::ZERO;
    }
    turn * (angular_spring_torque(stiffness, angle, limit).0 / angle)
}

/// Tangent stiffness of [`spring`] (Eq. 5.31): f′ along the deviation ρ and f/ρ across it. Returns the secant
/// f/ρ, which acts in all directions, the softening f′ − f/ρ, and the deviation's direction.
fn tangent_stiffness(stiffness: f64, deviation: DVec3, limit: f64) -> (f64, f64, DVec3) {
    if limit == f64::INFINITY {
        return (stiffness, 0.0, DVec3::ZERO);
    }
    let length = deviation.length();
    tangent(spring_force(stiffness, length, limit), length, deviation)
}

/// Tangent stiffness of [`angular_spring`] by the rotation vector, likewise.
fn angular_tangent_stiffness(stiffness: f64, turn: DVec3, limit: f64) -> (f64, f64, DVec3) {
    let angle = turn.length();
    tangent(angular_spring_torque(stiffness, angle, limit), angle, turn)
}

fn tangent((force, slope): (f64, f64), length: f64, deviation: DVec3) -> (f64, f64, DVec3) {
    if length == 0.0 {
        return (slope, 0.0, DVec3::ZERO);
    }
    let secant = force / length;
    (secant, slope - secant, deviation / length)
}

#[cfg(test)]
mod tests;
