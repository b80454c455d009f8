//! The virtual coupling: a spring and damper between the haptic device and the grasped body (§5.3).
//!
//! With a = R c the lever arm of the grasp point in world axes,
//!
//! - F_c = k_c (x_h − x − a) + b_c (v_h − v − ω × a)          (Eq. 5.15),
//! - T_c = a × F_c + k_θ u_c + b_θ (ω_h − ω)                  (Eq. 5.16),
//! - u_c the rotation vector of the short way round from the grasp frame R q_c to the device frame (Eq. 5.17–5.19).
//!
//! Departures: Eq. 5.15 prints the lever arm in body axes; Eq. 5.18 lacks a normalisation; the derivatives are by
//! rotation vector, not quaternion, and Eq. 5.25 gives way to −J_r⁻¹(u_c) (see the crate's `rotation` module). Both
//! springs may saturate (Eq. 5.30–5.31); the dampers do not.
//!
//! Near ‖u_c‖ = π the short way round changes sides and the torque with it: a grasp must be given up before that.

use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use crate::body::{Body, BodyState, principal_moments};
use crate::jacobian::{Block6, WrenchJacobian, outer};
use crate::rotation::{inverse_right_jacobian, skew, skew_skew};
use crate::saturation::{spring_energy, spring_force};

/// Where the haptic device is in the virtual world and how it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeviceMotion {
    /// Placement of the device's handle: **x**_h and q_h.
    pub pose: Pose,
    /// Velocity of the handle's origin **v**_h and angular velocity **ω**_h, world axes.
    pub twist: Twist,
}

impl DeviceMotion {
    /// A device that does not move.
    pub const fn at_rest(pose: Pose) -> Self {
        Self { pose, twist: Twist::ZERO }
    }

    /// Whether the pose is a rigid placement and every number is finite.
    pub fn is_valid(&self) -> bool {
        self.pose.is_valid() && self.twist.is_finite()
    }
}

/// Gains of the virtual coupling and where it holds the body.
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
    /// The device frame in the body frame when grasped: the coupling position **c** about the centre of mass, m, and the
    /// coupling orientation q_c, both in body axes.
    pub grasp: Pose,
    /// Limit of the linear spring's force, N; infinite for a linear spring.
    pub max_force: f64,
    /// Limit of the angular spring's torque, N·m; infinite for a linear spring.
    pub max_torque: f64,
}

/// What the coupling does at one state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CouplingResponse {
    /// F_c and T_c on the body, about its centre of mass.
    pub on_body: Wrench,
    /// The reaction on the device, about the handle's origin: −F_c and −(k_θ u_c + b_θ (ω_h − ω)).
    pub on_device: Wrench,
    /// Derivatives of `on_body` by the body's placement and velocity.
    pub jacobian: WrenchJacobian,
}

/// The coupling's wrench with its derivatives, the latter in the two parts that the step treats apart.
pub(crate) struct CouplingLinearisation {
    pub on_body: Wrench,
    /// Stiffness and damping: symmetric part negative semidefinite.
    pub material: WrenchJacobian,
    /// By φ alone, from the turning of the lever arm under a constant force and velocity (force, torque): indefinite.
    pub geometric: (DMat3, DMat3),
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
    /// A coupling of the given stiffnesses (N/m, N·m/rad), damped critically for `body` held at `grasp`, with springs
    /// that do not saturate.
    ///
    /// b_c = 2 √(k_c m); b_θ = 2 √(k_θ J) with J the largest principal moment of inertia about the grasp point, for
    /// that is where the linear spring holds the body. The translation of the centre of mass is then damped critically,
    /// and so is the slowest rotation; the others are overdamped.
    pub fn critically_damped(
        body: &Body,
        grasp: Pose,
        linear_stiffness: f64,
        angular_stiffness: f64,
    ) -> Self {
        let moment = principal_moments(&body.inertia_about(grasp.translation)).z;
        Self {
            linear_stiffness,
            linear_damping: 2.0 * (linear_stiffness * body.mass).sqrt(),
            angular_stiffness,
            angular_damping: 2.0 * (angular_stiffness * moment).sqrt(),
            grasp,
            max_force: f64::INFINITY,
            max_torque: f64::INFINITY,
        }
    }

    /// The grasp frame that holds a body at `body` by a device at `device`, each in the world (§5.3.1, Fig. 5.3a).
    pub fn grasp_at(body: &Pose, device: &Pose) -> Pose {
        body.inverse() * *device
    }

    /// The body's placement in which the coupling is relaxed for a device at `device`.
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

    /// F_c, T_c, the reaction on the device, and the derivatives (§5.3.2 as corrected).
    pub fn evaluate(&self, state: &BodyState, device: &DeviceMotion) -> CouplingResponse {
        let (on_body, on_device) = self.wrenches(state, device);
        let parts = self.linearise(state, device);
        let mut jacobian = parts.material;
        jacobian.pose.force_angular += parts.geometric.0;
        jacobian.pose.torque_angular += parts.geometric.1;
        CouplingResponse { on_body, on_device, jacobian }
    }

    /// Energy held in the two springs, J.
    pub fn potential_energy(&self, state: &BodyState, device: &DeviceMotion) -> f64 {
        let d = self.deviation(state, device);
        spring_energy(self.linear_stiffness, d.offset.length(), self.max_force)
            + spring_energy(self.angular_stiffness, d.turn.length(), self.max_torque)
    }

    fn deviation(&self, state: &BodyState, device: &DeviceMotion) -> Deviation {
        let arm = state.pose.transform_vector(self.grasp.translation);
        let offset = device.pose.translation - state.pose.translation - arm;
        let held: DQuat = state.pose.rotation * self.grasp.rotation;
        let turn = Pose::new(DVec3::ZERO, held).rotation_vector_to(&device.pose);
        let force = spring(self.linear_stiffness, offset, self.max_force)
            + self.linear_damping * (device.twist.linear - state.twist.velocity_at(arm));
        let couple = spring(self.angular_stiffness, turn, self.max_torque)
            + self.angular_damping * (device.twist.angular - state.twist.angular);
        Deviation { arm, offset, turn, force, couple }
    }

    pub(crate) fn linearise(&self, state: &BodyState, device: &DeviceMotion) -> CouplingLinearisation {
        let d = self.deviation(state, device);
        let arm = skew(d.arm);
        let stiffness = tangent_stiffness(self.linear_stiffness, d.offset, self.max_force);
        let turning = tangent_stiffness(self.angular_stiffness, d.turn, self.max_torque)
            * inverse_right_jacobian(d.turn);
        let by_turn = stiffness * arm;
        let pose = Block6 {
            force_linear: -stiffness,
            force_angular: by_turn,
            torque_linear: -(arm * stiffness),
            torque_angular: arm * by_turn - turning,
        };
        let damping = self.linear_damping;
        let damped_arm = arm * damping;
        let twist = Block6 {
            force_linear: DMat3::from_diagonal(DVec3::splat(-damping)),
            force_angular: damped_arm,
            torque_linear: -damped_arm,
            torque_angular: skew_skew(d.arm, d.arm) * damping
                - DMat3::from_diagonal(DVec3::splat(self.angular_damping)),
        };
        // The damper sees the arm turn too: −b_c ω* (∂a/∂φ), the term that Eq. 5.23 lacks.
        let swept = skew(state.twist.angular) * damped_arm;
        CouplingLinearisation {
            on_body: Wrench { force: d.force, torque: d.arm.cross(d.force) + d.couple },
            material: WrenchJacobian { pose, twist },
            geometric: (swept, arm * swept + skew_skew(d.force, d.arm)),
        }
    }
}

/// The spring's force (or torque) for a deviation.
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

/// Eq. 5.31: the derivative of [`spring`] by the deviation, f′ along it and f/ρ across it.
fn tangent_stiffness(stiffness: f64, deviation: DVec3, limit: f64) -> DMat3 {
    if limit == f64::INFINITY {
        return DMat3::from_diagonal(DVec3::splat(stiffness));
    }
    let length = deviation.length();
    let (force, slope) = spring_force(stiffness, length, limit);
    if length == 0.0 {
        return DMat3::from_diagonal(DVec3::splat(slope));
    }
    let axis = deviation / length;
    let secant = force / length;
    DMat3::from_diagonal(DVec3::splat(secant)) + outer(axis, axis) * (slope - secant)
}
