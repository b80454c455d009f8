//! The engine's coupling at the end of a lever: a body that stands still, grasped away from the handle of a device that no hand
//! holds, or that a hand keeps from moving but lets turn.
//!
//! The handle's damping is to its angular damping as its mass is to its moment of inertia. Such a device is as bad as any
//! hand: where a mode of handle and springs is stable, it is passive.

use palpate::device::{Emulation, Hand, HapticDevice, IntendedPath};
use palpate::dynamics::{BodyState, DeviceMotion, VirtualCoupling};
use palpate::glam::{DQuat, DVec3};
use palpate::{Pose, Twist};

use super::conditions::SampledWall;
use super::wall::lever_arm;

/// One simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeverCase {
    /// From the handle to the grasp, ℓ, m.
    pub lever: f64,
    /// Whether a hand keeps the handle from moving.
    pub held: bool,
    /// T and t_d, s.
    pub period: f64,
    pub delay: f64,
    /// b, N·s/m.
    pub device_damping: f64,
    /// What rotation sees of the springs, k_θ + k_c ℓ², N·m/rad. With a lever half of it is the force's.
    pub stiffness: f64,
}

/// The device's integration step, s.
const SUBSTEP: f64 = 1e-5;
/// Where the handle is at the start, m and rad.
const START: (f64, f64) = (1e-4, 2e-3);
/// What keeps a handle from moving, N/m and N·s/m.
const KEPT: (f64, f64) = (1e6, 1e5);
/// Simulated time, s; of its last two parts of that length the amplitudes are compared.
const DURATION: f64 = 3.0;
const PART: f64 = 1.0;
/// A handle that has turned by so much has left, rad.
const FAR: f64 = 1.0;

impl LeverCase {
    /// The case in the terms of the conditions of theory, but for the lever.
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

    /// k_c and k_θ, N/m and N·m/rad.
    fn springs(&self) -> (f64, f64) {
        let square = self.lever * self.lever;
        if square > 0.0 {
            (0.5 * self.stiffness / square, 0.5 * self.stiffness)
        } else {
            // Translation has as much of its damping.
            (self.stiffness / lever_arm().powi(2), self.stiffness)
        }
    }

    /// k_θ + k_c ℓ² of the stiffest springs that theory allows, N·m/rad.
    ///
    /// Of the springs' matrix against the damping's, diag(b, b_θ), no eigenvalue may be above 1/(T/2 + t_d).
    pub fn stiffest(&self) -> f64 {
        let (linear, angular) = Self { stiffness: 1.0, ..*self }.springs();
        let (b, turning) = (self.device_damping, self.device_damping * lever_arm().powi(2));
        let rotation = (angular + linear * self.lever * self.lever) / turning;
        let largest = if self.held {
            rotation
        } else {
            let (translation, mixed) = (linear / b, (linear * self.lever).powi(2) / (b * turning));
            0.5 * (translation + rotation) + (0.25 * (translation - rotation).powi(2) + mixed).sqrt()
        };
        1.0 / (largest * (0.5 * self.period + self.delay))
    }

    /// Whether a disturbance dies away.
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
            if turn > FAR || !away.is_finite() {
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
        let kept = Hand { stiffness: KEPT.0, damping: KEPT.1, ..Hand::NONE };
        Emulation { hand: if self.held { kept } else { Hand::NONE }, ..emulation }
    }
}

/// A hand that means to be where the handle is at the start, across the lever, and no longer.
fn start() -> IntendedPath {
    IntendedPath::function(|time| {
        if time > 0.0 {
            return (Pose::IDENTITY, Twist::ZERO);
        }
        let (place, turn) = START;
        (Pose::new(DVec3::Z * place, DQuat::from_rotation_y(turn)), Twist::ZERO)
    })
}
