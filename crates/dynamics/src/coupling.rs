//! The virtual coupling: a spring and damper between the haptic device and the grasped body (§5.3).
//!
//! With a = R c the lever arm of the grasp point in world axes,
//!
//! - F_c = k_c (x_h − x − a) + b_c (v_h − v − ω × a)          (Eq. 5.15),
//! - T_c = a × F_c + k_θ u_c + b_θ (ω_h − ω)                  (Eq. 5.16),
//! - u_c the rotation vector of the short way round from the grasp frame R q_c to the device frame (Eq. 5.17–5.19).
//!
//! Departures: Eq. 5.15 prints the lever arm in body axes; Eq. 5.18 lacks a normalisation; the derivatives
//! are by rotation vector, not quaternion, and Eq. 5.25 gives way to −J_r⁻¹(u_c) (see the crate's `rotation`
//! module). Both springs may saturate (Eq. 5.30–5.31); the dampers do not.
//!
//! At ‖u_c‖ = π the short way round changes sides, and a spring's torque with it. So the angular spring fades
//! from 150° and exerts nothing at 180° ([`angular_spring_torque`](crate::angular_spring_torque)): the torque is
//! continuous through a half turn, beyond which the body is drawn on to the next whole turn.

use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use crate::body::{Body, BodyState, principal_moments};
use crate::jacobian::{Block6, WrenchJacobian, outer};
use crate::rotation::{cross_columns, inverse_right_jacobian, skew, skew_skew};
use crate::saturation::{angular_spring_energy, angular_spring_torque, spring_energy, spring_force};

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
    /// The device frame in the body frame when grasped: the coupling position **c** about the centre of mass,
    /// m, and the coupling orientation q_c, both in body axes.
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

/// The coupling's wrench with what its derivatives are made of, in the two parts that the step treats apart.
///
/// Stiffness and damping have a negative semidefinite symmetric part; they are those of a spring and damper that resist
/// motion of the point at `arm` in all directions alike, less the `bend`, and those of the angular ones.
pub(crate) struct CouplingLinearisation {
    pub on_body: Wrench,
    pub arm: DVec3,
    /// N/m.
    pub stiffness: f64,
    /// N·s/m.
    pub damping: f64,
    /// What the spring is stiffer along its deviation, N/m (negative, and zero where it is linear), and that direction.
    pub bend: (f64, DVec3),
    /// Of the couple against φ, N·m/rad.
    pub angular_stiffness: DMat3,
    /// N·m·s/rad.
    pub angular_damping: f64,
    /// By φ alone: from the turning of the lever arm under a constant force and velocity, and the negative
    /// stiffness of an angular spring that fades (force, torque). Indefinite.
    pub geometric: (DMat3, DMat3),
}

impl CouplingLinearisation {
    /// The derivatives by stiffness and damping.
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
        let (bend, axis) = self.bend;
        let lever = self.arm.cross(axis);
        let mut pose = at_arm(self.stiffness) + Block6::outer((axis, lever), (axis * -bend, lever * -bend));
        pose.torque_angular -= self.angular_stiffness;
        let mut twist = at_arm(self.damping);
        twist.torque_angular -= scalar(self.angular_damping);
        WrenchJacobian { pose, twist }
    }

    /// What the springs add to the wrench when the body moves by a small displacement (m, rad).
    pub fn drift(&self, displacement: &Twist) -> Wrench {
        let way = displacement.velocity_at(self.arm);
        let (bend, axis) = self.bend;
        let force = way * -self.stiffness - axis * (bend * axis.dot(way));
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
    /// A coupling of the given stiffnesses (N/m, N·m/rad), damped critically for `body` held at `grasp`, with
    /// springs that do not saturate.
    ///
    /// b_c = 2 √(k_c m (1 + ρ)); b_θ = 2 √(k_θ J (1 + ρ)) with J the largest principal moment of inertia about
    /// the grasp point, for that is where the linear spring holds the body, and ρ = a √(m/J) for a grasp point
    /// at a from the centre of mass. Held at the centre of mass (ρ = 0) the translation is damped critically,
    /// and so is the slowest rotation; the others are overdamped. Held elsewhere, translation and rotation
    /// swing together: their masses are no larger than those of two separate motions 1 + ρ times as heavy,
    /// ρ < 1. No mode of a rod held anywhere is damped less than 0.9 of critically then, against 0.72 without
    /// the factor (the test `no_mode_of_a_rod_is_underdamped`).
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

    /// The grasp frame that holds a body at `body` by a device at `device`, each in the world (§5.3.1, Fig.
    /// 5.3a).
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
        let mut jacobian = parts.material();
        jacobian.pose.force_angular += parts.geometric.0;
        jacobian.pose.torque_angular += parts.geometric.1;
        CouplingResponse { on_body, on_device, jacobian }
    }

    /// Energy held in the two springs, J.
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
        // The tangent stiffness is secant · 1 + bend · û ûᵀ, û along the deviation.
        let (stiffness, bend, along) = tangent_stiffness(self.linear_stiffness, d.offset, self.max_force);
        // Likewise S_θ J_r⁻¹, where ûᵀ J_r⁻¹ = ûᵀ.
        let (secant, angular_bend, axis) =
            angular_tangent_stiffness(self.angular_stiffness, d.turn, self.max_torque);
        let mut angular_stiffness = inverse_right_jacobian(d.turn) * secant;
        // Where the spring fades its slope is negative: that part is not semidefinite.
        let falling = (secant + angular_bend).min(0.0);
        let mut faded = DMat3::ZERO;
        if angular_bend != 0.0 {
            angular_stiffness += outer(axis, axis * (angular_bend - falling));
            faded = outer(axis, axis * falling);
        }
        // The damper sees the arm turn too: −b_c ω* (∂a/∂φ), the term that Eq. 5.23 lacks.
        let swept = skew_skew(state.twist.angular * self.linear_damping, d.arm);
        CouplingLinearisation {
            on_body: Wrench { force: d.force, torque: d.arm.cross(d.force) + d.couple },
            arm: d.arm,
            stiffness,
            damping: self.linear_damping,
            bend: (bend, along),
            angular_stiffness,
            angular_damping: self.angular_damping,
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

/// Eq. 5.31: the derivative of [`spring`] by the deviation is f′ along it and f/ρ across it, returned as the
/// f/ρ that is in all directions, what f′ is more than that, and the direction.
fn tangent_stiffness(stiffness: f64, deviation: DVec3, limit: f64) -> (f64, f64, DVec3) {
    if limit == f64::INFINITY {
        return (stiffness, 0.0, DVec3::ZERO);
    }
    let length = deviation.length();
    tangent(spring_force(stiffness, length, limit), length, deviation)
}

/// The same of [`angular_spring`], by the rotation vector.
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
mod tests {
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::differences::{
        random_direction, random_pose, random_twist, random_vector, relative_error, wrench_jacobian,
    };

    fn random_coupling(rng: &mut StdRng) -> VirtualCoupling {
        VirtualCoupling {
            linear_stiffness: rng.random_range(50.0..2000.0),
            linear_damping: rng.random_range(0.1..5.0),
            angular_stiffness: rng.random_range(0.05..5.0),
            angular_damping: rng.random_range(1e-4..0.01),
            grasp: random_pose(rng, 0.1),
            max_force: f64::INFINITY,
            max_torque: f64::INFINITY,
        }
    }

    /// A device displaced from the body's grasp frame by a random offset and by `angle` about a random axis.
    fn device_at(
        rng: &mut StdRng,
        coupling: &VirtualCoupling,
        state: &BodyState,
        angle: f64,
    ) -> DeviceMotion {
        let grasp = state.pose * coupling.grasp;
        let turn = DQuat::from_scaled_axis(random_direction(rng) * angle);
        let pose =
            Pose::new(grasp.translation + random_vector(rng, 0.05), (turn * grasp.rotation).normalize());
        DeviceMotion { pose, twist: random_twist(rng, 0.3, 3.0) }
    }

    #[test]
    #[expect(clippy::print_stdout, reason = "a measured figure, shown by --nocapture")]
    fn jacobian_equals_central_differences_at_any_rotation() {
        let seed = 31;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut worst: f64 = 0.0;
        for case in 0..600 {
            let mut coupling = random_coupling(&mut rng);
            let state =
                BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.3, 5.0) };
            let angle = [0.0, 1e-7, 1e-3, 0.1, 0.5, 1.5, 2.5, 2.9, 3.0][case % 9];
            if case % 3 == 0 {
                // No smaller than the lever arm: the differences then never meet the kink at a zero arm.
                coupling.grasp.translation += DVec3::splat(0.05);
            }
            let device = device_at(&mut rng, &coupling, &state, angle);
            let found = coupling.evaluate(&state, &device).jacobian;
            let expected = wrench_jacobian(|s| coupling.wrenches(s, &device).0, &state);
            let error = relative_error(&found, &expected);
            assert!(error < 1e-6, "seed {seed}, case {case}, angle {angle}: relative error {error}");
            worst = worst.max(error);
        }
        println!("worst relative error {worst:.2e}");
    }

    #[test]
    fn jacobian_of_saturated_springs_equals_central_differences() {
        let seed = 32;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut bent = 0;
        for case in 0..600 {
            let mut coupling = random_coupling(&mut rng);
            let state =
                BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.3, 5.0) };
            let angle = rng.random_range(0.2..2.5);
            let device = device_at(&mut rng, &coupling, &state, angle);
            let offset = coupling.deviation(&state, &device).offset.length();
            // Limits from far beyond to far below the present deviation: linear, bent and flat. The
            // differences must not straddle a joint, where the law has no second derivative.
            let share = [0.2, 0.65, 0.85, 1.0, 1.15, 1.5][case % 6];
            coupling.max_force = coupling.linear_stiffness * offset / share;
            coupling.max_torque = coupling.angular_stiffness * angle / share;
            if offset < 0.03 {
                continue;
            }
            bent += usize::from((0.75..1.25).contains(&share));
            let found = coupling.evaluate(&state, &device).jacobian;
            let expected = wrench_jacobian(|s| coupling.wrenches(s, &device).0, &state);
            let error = relative_error(&found, &expected);
            assert!(error < 1e-6, "seed {seed}, case {case}, share {share}: relative error {error}");
        }
        assert!(bent > 100, "only {bent} cases on the bent piece");
    }

    #[test]
    fn signs_pull_the_body_to_the_device_and_the_device_to_the_body() {
        let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
        let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 100.0, 2.0);
        let state = BodyState::default();
        let device =
            DeviceMotion::at_rest(Pose::new(DVec3::X * 0.01, DQuat::from_scaled_axis(DVec3::Z * 0.25)));
        let (on_body, on_device) = coupling.wrenches(&state, &device);
        assert!((on_body.force - DVec3::X).length() < 1e-12);
        assert!((on_body.torque - DVec3::Z * 0.5).length() < 1e-12);
        assert_eq!(on_device, -on_body);
    }

    #[test]
    fn force_at_a_grasp_off_centre_makes_a_torque_about_the_centre_of_mass_only() {
        let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
        let grasp = Pose::from_translation(DVec3::Y * 0.2);
        let coupling = VirtualCoupling::critically_damped(&body, grasp, 100.0, 2.0);
        // Body turned a quarter about z: the grasp point lies at −x.
        let state =
            BodyState::at_rest(Pose::new(DVec3::ZERO, DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2)));
        let held = state.pose * grasp;
        let device = DeviceMotion::at_rest(Pose::new(held.translation + DVec3::Y * 0.01, held.rotation));
        let (on_body, on_device) = coupling.wrenches(&state, &device);
        assert!((on_body.force - DVec3::Y).length() < 1e-12);
        assert!((on_body.torque - DVec3::Z * -0.2).length() < 1e-12);
        assert!((on_device.force + DVec3::Y).length() < 1e-12 && on_device.torque.length() < 1e-12);
    }

    #[test]
    fn relaxed_coupling_exerts_nothing_wherever_it_holds() {
        let seed = 33;
        let mut rng = StdRng::seed_from_u64(seed);
        for _ in 0..200 {
            let (body, device) = (random_pose(&mut rng, 0.5), random_pose(&mut rng, 0.5));
            let mut coupling = random_coupling(&mut rng);
            coupling.grasp = VirtualCoupling::grasp_at(&body, &device);
            let (on_body, _) = coupling.wrenches(&BodyState::at_rest(body), &DeviceMotion::at_rest(device));
            assert!(on_body.force.length() < 1e-11 && on_body.torque.length() < 1e-12, "seed {seed}");
            let relaxed = coupling.relaxed_pose(&device);
            assert!((relaxed.translation - body.translation).length() < 1e-14, "seed {seed}");
        }
    }

    #[test]
    fn spring_wrench_is_the_gradient_of_the_energy() {
        let seed = 34;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..400 {
            let mut coupling = random_coupling(&mut rng);
            (coupling.linear_damping, coupling.angular_damping) = (0.0, 0.0);
            (coupling.max_force, coupling.max_torque) =
                (rng.random_range(1.0..30.0), rng.random_range(0.1..2.0));
            let state = BodyState::at_rest(random_pose(&mut rng, 0.5));
            let device = device_at(&mut rng, &coupling, &state, [0.4, 1.2, 2.5, 2.9][case % 4]);
            let motion = random_twist(&mut rng, 0.05, 1.0);
            let energy = |s| {
                let moved = BodyState::at_rest(state.pose.moved(&motion, s));
                coupling.potential_energy(&moved, &device)
            };
            let h = 1e-5;
            let slope = (energy(h) - energy(-h)) / (2.0 * h);
            let power = coupling.wrenches(&state, &device).0.power(&motion);
            assert!((slope + power).abs() < 1e-6 * (1.0 + power.abs()), "seed {seed}, case {case}");
        }
    }

    #[test]
    fn default_damping_is_critical() {
        let body = Body::new(0.04, DMat3::from_diagonal(DVec3::new(1e-5, 2e-5, 2.5e-5))).unwrap();
        let c = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 400.0, 0.9);
        assert!((c.linear_damping - 8.0).abs() < 1e-12);
        assert!((c.angular_damping - 2.0 * (0.9_f64 * 2.5e-5).sqrt()).abs() < 1e-15);
        // About a grasp point at 5 cm the z moment is 2.5e-5 + 0.04 · 0.05² = 1.25e-4.
        let c =
            VirtualCoupling::critically_damped(&body, Pose::from_translation(DVec3::X * 0.05), 400.0, 0.9);
        let shared = 1.0 + 0.05 * (0.04 / 1.25e-4_f64).sqrt();
        assert!((c.linear_damping - 8.0 * shared.sqrt()).abs() < 1e-12);
        assert!((c.angular_damping - 2.0 * (0.9 * 1.25e-4 * shared).sqrt()).abs() < 1e-15);
    }

    /// The smallest damping ratio of the modes in which a rod of `mass` and `moment` (about its centre), held at
    /// `arm` from it, moves across its length and turns: by the roots of det(M s² + B s + K), found all at once
    /// by the iteration of Durand and Kerner.
    fn smallest_ratio(mass: f64, moment: f64, arm: f64, c: &VirtualCoupling) -> f64 {
        let about = moment + mass * arm * arm;
        let (k, t, b, d) = (c.linear_stiffness, c.angular_stiffness, c.linear_damping, c.angular_damping);
        let lead = mass * about - (mass * arm).powi(2);
        let raw = [
            1.0,
            (mass * d + b * about) / lead,
            (mass * t + k * about + b * d) / lead,
            (b * t + k * d) / lead,
            k * t / lead,
        ];
        let rate = raw[4].powf(0.25);
        let scaled: Vec<f64> = (0..5).map(|i| raw[i] / rate.powi(i as i32)).collect();
        let multiply = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
        let mut roots = [(1.0, 0.0), (0.4, 0.9), (-0.65, 0.72), (-0.908, -0.297)];
        for _ in 0..500 {
            for i in 0..4 {
                let value = scaled.iter().fold((0.0, 0.0), |sum, x| {
                    let next = multiply(sum, roots[i]);
                    (next.0 + x, next.1)
                });
                let others = (0..4).filter(|j| *j != i).fold((1.0, 0.0), |product, j| {
                    multiply(product, (roots[i].0 - roots[j].0, roots[i].1 - roots[j].1))
                });
                let size = others.0 * others.0 + others.1 * others.1;
                let quotient = multiply(value, (others.0 / size, -others.1 / size));
                roots[i] = (roots[i].0 - quotient.0, roots[i].1 - quotient.1);
            }
        }
        roots.iter().map(|r| -r.0 / r.0.hypot(r.1)).fold(f64::INFINITY, f64::min)
    }

    #[test]
    #[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
    fn no_mode_of_a_rod_is_underdamped() {
        let seed = 35;
        let mut rng = StdRng::seed_from_u64(seed);
        let (mut worst, mut separate) = (f64::INFINITY, f64::INFINITY);
        for case in 0..2000 {
            let (mass, length) =
                (10_f64.powf(rng.random_range(-4.0..2.0)), 10_f64.powf(rng.random_range(-2.0..0.0)));
            let arm = length * rng.random_range(0.0..0.5);
            // From weight at the middle to a thicker end: 1/12 for a rod.
            let moment = mass * length * length * rng.random_range(0.02..0.12);
            let body = Body::new(mass, DMat3::from_diagonal(DVec3::new(0.1, 1.0, 1.0)) * moment).unwrap();
            let grasp = Pose::from_translation(DVec3::X * arm);
            let stiffness = 10_f64.powf(rng.random_range(1.5..3.5));
            let angular = 10_f64.powf(rng.random_range(-1.0..1.5));
            let mut coupling = VirtualCoupling::critically_damped(&body, grasp, stiffness, angular);
            let ratio = smallest_ratio(mass, moment, arm, &coupling);
            assert!(ratio > 0.9, "seed {seed}, case {case}: damping ratio {ratio}");
            worst = worst.min(ratio);
            let shared = (1.0 + arm * (mass / (moment + mass * arm * arm)).sqrt()).sqrt();
            coupling.linear_damping /= shared;
            coupling.angular_damping /= shared;
            separate = separate.min(smallest_ratio(mass, moment, arm, &coupling));
        }
        println!(
            "smallest damping ratio {worst:.3}, {separate:.3} if translation and rotation were separate"
        );
        assert!(separate < 0.75, "the factor is needed: {separate}");
    }

    #[test]
    fn torque_is_continuous_through_a_half_turn() {
        let axis = DVec3::new(0.3, -0.5, 0.8).normalize();
        for max_torque in [0.1, 1.0, f64::INFINITY] {
            let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
            let mut coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 100.0, 0.5);
            coupling.max_torque = max_torque;
            let torque = |angle: f64| {
                let device = Pose::new(DVec3::ZERO, DQuat::from_axis_angle(axis, angle));
                coupling.wrenches(&BodyState::default(), &DeviceMotion::at_rest(device)).0.torque
            };
            let (step, mut previous, mut largest) = (1e-3, torque(0.0), 0.0_f64);
            for i in 1..=6283 {
                let next = torque(f64::from(i) * step);
                // The steepest part of the fade falls three times as fast as the spring rose to 150°, at most.
                assert!((next - previous).length() < 8.0 * 0.5 * step, "limit {max_torque}, step {i}");
                largest = largest.max(next.length());
                previous = next;
            }
            assert!(largest > 0.99 * max_torque.min(0.5 * 2.6), "limit {max_torque}: {largest}");
            assert!(torque(std::f64::consts::PI).length() < 1e-9);
        }
    }

    #[test]
    fn a_body_let_go_anywhere_near_a_half_turn_comes_to_rest_at_the_device() {
        let body = Body::new(1e-3, DMat3::from_diagonal(DVec3::new(1e-8, 2e-8, 2.5e-8))).unwrap();
        let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 400.0, 10.0);
        let contacts = crate::LinearContactModel::empty(&Pose::IDENTITY, 0.0);
        for past in [-0.4, -0.1, -0.01, -1e-4, 1e-4, 0.01, 0.4] {
            let angle = std::f64::consts::PI + past;
            let device = DeviceMotion::at_rest(Pose::new(DVec3::ZERO, DQuat::from_rotation_y(angle)));
            let mut state = BodyState::default();
            for step in 0..2000 {
                let next = crate::semi_implicit_step(
                    &body,
                    &state,
                    &device,
                    &coupling,
                    &contacts,
                    DVec3::ZERO,
                    1e-3,
                );
                assert!(next.status.is_ok(), "angle {angle}, step {step}: {:?}", next.status);
                state = next.state;
            }
            let left = state.pose.rotation_vector_to(&device.pose).length();
            assert!(left < 1e-6, "angle {angle}: {left} rad left");
        }
    }
}
