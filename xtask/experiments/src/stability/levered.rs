//! The engine's coupling at the end of a lever: a body that stands still, grasped away from the handle of a
//! device. No hand holds the device, or a hand keeps it from moving but lets it turn.
//!
//! The ratio of the handle's damping to its angular damping is that of its mass to its moment of inertia.
//! Such a device is the worst case for any hand: where all modes of handle and springs are stable, it is
//! passive.

use palpate::device::{Emulation, Hand, HapticDevice, IntendedPath};
use palpate::dynamics::{BodyState, DeviceMotion, VirtualCoupling};
use palpate::glam::{DQuat, DVec3};
use palpate::{Pose, Twist};

use super::conditions::SampledWall;
use super::wall::lever_arm;

/// One simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeverCase {
    /// Distance from the handle to the grasp ℓ, m.
    pub lever: f64,
    /// Whether a hand keeps the handle from translating.
    pub held: bool,
    /// Sampling period T and delay t_d, s.
    pub period: f64,
    pub delay: f64,
    /// Damping of the device b, N·s/m.
    pub device_damping: f64,
    /// Angular stiffness of both springs, k_θ + k_c ℓ², N·m/rad. With a lever, half of it is that of the
    /// linear spring.
    pub stiffness: f64,
}

/// Integration step of the device, s.
const SUBSTEP: f64 = 1e-5;
/// Displacement and rotation of the handle at the start, m and rad.
const START: (f64, f64) = (1e-4, 2e-3);
/// Stiffness and damping that keep a handle from translating, N/m and N·s/m.
const HOLDING_IMPEDANCE: (f64, f64) = (1e6, 1e5);
/// Simulated time, s; and length of its last two parts, whose amplitudes are compared.
const DURATION: f64 = 3.0;
const PART: f64 = 1.0;
/// Rotation from which a handle counts as diverged, rad.
const MAX_ROTATION: f64 = 1.0;

impl LeverCase {
    /// Returns the case in the terms of the conditions, without the lever.
    pub fn sampled(&self) -> SampledWall {
        let Self { period, delay, device_damping, stiffness, .. } = *self;
        SampledWall {
            device_damping,
            friction: 0.0,
            stiffness,
            damping: 0.0,
            lag: 0.0,
            period,
            delay,
            quantum: 0.0,
        }
    }

    /// Returns k_c and k_θ, N/m and N·m/rad.
    fn springs(&self) -> (f64, f64) {
        let square = self.lever * self.lever;
        if square > 0.0 {
            (0.5 * self.stiffness / square, 0.5 * self.stiffness)
        } else {
            // Without a lever both springs get the same ratio of stiffness to damping.
            (self.stiffness / lever_arm().powi(2), self.stiffness)
        }
    }

    /// Returns k_θ + k_c ℓ² of the stiffest stable springs in theory, N·m/rad.
    ///
    /// With K the springs' matrix and D = diag(b, b_θ), no eigenvalue of D⁻¹K may exceed 1/(T/2 + t_d).
    pub fn stiffest(&self) -> f64 {
        let (linear, angular) = Self { stiffness: 1.0, ..*self }.springs();
        let (b, turning) = (self.device_damping, self.device_damping * lever_arm().powi(2));
        let rotation = (angular + linear * self.lever * self.lever) / turning;
        // The larger eigenvalue of the symmetric 2 × 2 matrix D^(-½) K D^(-½), in closed form.
        let largest = if self.held {
            rotation
        } else {
            let (translation, mixed) = (linear / b, (linear * self.lever).powi(2) / (b * turning));
            0.5 * (translation + rotation) + (0.25 * (translation - rotation).powi(2) + mixed).sqrt()
        };
        1.0 / (largest * (0.5 * self.period + self.delay))
    }

    /// Returns whether a disturbance decays.
    ///
    /// # Errors
    /// If the device refuses its parameters.
    pub fn settles(&self) -> Result<bool, String> {
        let mut device = self.emulation().open(start()).map_err(|error| error.to_string())?;
        let (linear_stiffness, angular_stiffness) = self.springs();
        let coupling = VirtualCoupling {
            linear_stiffness,
            linear_damping: 0.0,
            angular_stiffness,
            angular_damping: 0.0,
            grasp: Pose::IDENTITY,
            max_force: f64::INFINITY,
            max_torque: f64::INFINITY,
        };
        let grasp = DVec3::X * self.lever;
        let body = BodyState::at_rest(Pose::from_translation(grasp));
        let (steps, part) = ((DURATION / self.period) as usize, (PART / self.period) as usize);
        let mut amplitudes = [0.0_f64; 2];
        for step in 0..steps {
            let state = device.read(step as f64 * self.period).map_err(|error| error.to_string())?;
            let arm = state.pose.transform_vector(grasp);
            let motion = DeviceMotion {
                pose: Pose { translation: state.pose.translation + arm, ..state.pose },
                twist: Twist::new(state.twist.velocity_at(arm), state.twist.angular),
            };
            let (_, at_grasp) = coupling.wrenches(&body, &motion);
            device.write(&at_grasp.about(-arm)).map_err(|error| error.to_string())?;
            let turn = Pose::IDENTITY.rotation_vector_to(&state.pose).length();
            let away = turn * lever_arm() + state.pose.translation.length();
            if turn > MAX_ROTATION || !away.is_finite() {
                return Ok(false);
            }
            if step + 2 * part >= steps {
                let latest = usize::from(step + part >= steps);
                amplitudes[latest] = amplitudes[latest].max(away);
            }
        }
        Ok(amplitudes[1] < amplitudes[0])
    }

    fn emulation(&self) -> Emulation {
        let mut emulation = Emulation { substep: SUBSTEP, ..Emulation::default() };
        let specification = &mut emulation.specification;
        (specification.peak_force, specification.peak_torque) = (f64::INFINITY, f64::INFINITY);
        (specification.encoder_step, specification.angular_encoder_step) = (0.0, 0.0);
        specification.delay = self.delay;
        let handle = &mut emulation.handle;
        (handle.friction, handle.angular_friction) = (0.0, 0.0);
        handle.damping = self.device_damping;
        handle.angular_damping = self.device_damping * lever_arm().powi(2);
        let kept = Hand { stiffness: HOLDING_IMPEDANCE.0, damping: HOLDING_IMPEDANCE.1, ..Hand::NONE };
        Emulation { hand: if self.held { kept } else { Hand::NONE }, ..emulation }
    }
}

/// Returns the path of a hand that aims at the handle's starting place only at time 0.
fn start() -> IntendedPath {
    IntendedPath::function(|time| {
        if time > 0.0 {
            return (Pose::IDENTITY, Twist::ZERO);
        }
        let (place, turn) = START;
        (Pose::new(DVec3::Z * place, DQuat::from_rotation_y(turn)), Twist::ZERO)
    })
}
