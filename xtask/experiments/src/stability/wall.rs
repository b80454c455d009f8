//! Sampled virtual wall, rendered directly to an emulated device and hand, without a body or a coupling.
//!
//! Rotation is treated as translation at the lever arm ℓ = √(J/m) of the device, at which its inertia J
//! equals the inertia of its mass m: stiffness K ℓ², damping B ℓ², position x/ℓ.

use std::ops::Range;

use palpate::device::{DeviceError, EmulatedDevice, Emulation, Hand, HapticDevice, IntendedPath};
use palpate::glam::{DQuat, DVec3};
use palpate::{Pose, Twist, Wrench};

use palpate_measure::{Outcome, judge};

use super::conditions::SampledWall;

/// Axis along or about which the device meets the wall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    Translation,
    Rotation,
}

impl Motion {
    pub const ALL: [Self; 2] = [Self::Translation, Self::Rotation];

    pub fn word(self) -> &'static str {
        match self {
            Self::Translation => "translation",
            Self::Rotation => "rotation",
        }
    }

    /// Returns pose and twist of a handle at a position (m) and speed (m/s).
    fn at(self, place: f64, speed: f64) -> (Pose, Twist) {
        match self {
            Self::Translation => {
                (Pose::from_translation(DVec3::Z * place), Twist::new(DVec3::Z * speed, DVec3::ZERO))
            }
            Self::Rotation => (
                Pose::new(DVec3::ZERO, DQuat::from_rotation_z(place / lever_arm())),
                Twist::new(DVec3::ZERO, DVec3::Z * (speed / lever_arm())),
            ),
        }
    }
}

/// Source of the velocity for the wall's damper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Velocity {
    /// Velocity that the device reports: low-pass filtered differences of rounded readings.
    Sensed,
    /// Difference of successive readings over the sampling period.
    BackwardDifference,
    /// Backward difference through a first-order lag, s.
    Lagged(f64),
}

impl Velocity {
    pub fn word(self) -> &'static str {
        match self {
            Self::Sensed => "sensed",
            Self::BackwardDifference => "backward difference",
            Self::Lagged(_) => "lagged difference",
        }
    }
}

/// Parameters of a simulation. Lengths, forces, stiffness and damping in rotation are those at the lever arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallCase {
    pub motion: Motion,
    /// Stiffness K, N/m.
    pub stiffness: f64,
    /// Damping B, N·s/m.
    pub damping: f64,
    /// Sampling period T, s; a multiple of [`TICK`], as is the delay.
    pub period: f64,
    /// Delay of the device t_d, from a sample to its force, s.
    pub delay: f64,
    /// Encoder step Δ, m.
    pub quantum: f64,
    pub velocity: Velocity,
    /// Whether the device has its Coulomb friction.
    pub friction: bool,
    /// Viscous damping of the device b, N·s/m.
    pub device_damping: f64,
    /// Force that pushes a device that no hand holds, N.
    pub push: f64,
    /// Position of the handle at the start, m: above zero it is in front of the wall.
    pub start: f64,
    /// Simulated time, s.
    pub duration: f64,
    pub hand: (&'static str, Hand),
}

/// Result of a simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallResult {
    pub outcome: Outcome,
    /// Peak-to-peak motion over the last half second, m.
    pub amplitude: f64,
    /// Lowest net energy that had flowed from the device into the wall, J.
    pub port_energy: f64,
    /// Lowest net energy that had flowed from the hand into the device with the wall, J: energy that went
    /// into the wall, into the device's damping and friction, and into the kinetic energy of the handle.
    pub hand_energy: f64,
    /// Net energy that the hand had extracted from device and wall between the first counted tick and the
    /// end, without the kinetic energy of the handle, J.
    pub gained: f64,
}

/// Time resolution of forces and of the observed motion, s.
pub const TICK: f64 = 1e-4;
/// Number of ticks in the last second, which is judged.
const JUDGED_TICKS: usize = 10_000;
/// Integration step of the device, s.
const SUBSTEP: f64 = 1e-5;
/// Distance from the wall at which the hand starts and at which it ends behind it, m; and its speed, m/s.
const REACH: f64 = 5e-3;
const SPEED: f64 = 0.2;
/// Stiffness of the spring that pushes a device that no hand holds, N/m.
const PUSH_STIFFNESS: f64 = 20.0;
/// Stiffness (N/m) and damping (N·s/m) of a hand that shakes the handle against any wall; amplitude of the
/// shaking, and its depth behind the wall's surface, m.
const SHAKING_IMPEDANCE: (f64, f64) = (1e6, 1e4);
const SHAKE_AMPLITUDE: f64 = 1e-4;
const SHAKE_DEPTH: f64 = 0.05;
/// Largest ratio of the last to the first amplitude of a swing that decays. A steady swing is measured as
/// slightly smaller than it was.
const MAX_DECAY_RATIO: f64 = 0.99;
/// Shortest times to reach a steady motion, and to shake then, s.
const MIN_SETTLING_TIME: f64 = 0.5;
const MIN_SHAKING_TIME: f64 = 1.0;
/// Distance from which a handle counts as diverged, m.
const MAX_DISTANCE: f64 = 0.5;
/// Smallest amplitude that [`WallCase::floor`] returns, m.
const MIN_FLOOR: f64 = 1e-6;

impl WallCase {
    /// Returns the default case: the premium-1.5 at 1 kHz with a relaxed grip, and its own velocity estimate.
    pub fn base(motion: Motion) -> Self {
        let Emulation { specification, handle, .. } = Emulation::default();
        let quantum = match motion {
            Motion::Translation => specification.encoder_step,
            Motion::Rotation => specification.angular_encoder_step * lever_arm(),
        };
        Self {
            motion,
            stiffness: 0.0,
            damping: 0.0,
            period: 1e-3,
            delay: 0.0,
            quantum,
            velocity: Velocity::Sensed,
            friction: true,
            device_damping: match motion {
                Motion::Translation => handle.damping,
                Motion::Rotation => handle.angular_damping / lever_arm().powi(2),
            },
            push: 1.0,
            start: REACH,
            duration: 2.0,
            hand: ("grip", Hand::GRIP),
        }
    }

    /// Returns the case in the terms of the conditions of theory.
    pub fn sampled(&self) -> SampledWall {
        let handle = Emulation::default().handle;
        let friction = match self.motion {
            Motion::Translation => handle.friction,
            Motion::Rotation => handle.angular_friction / lever_arm(),
        };
        SampledWall {
            device_damping: self.device_damping,
            friction: if self.friction { friction } else { 0.0 },
            stiffness: self.stiffness,
            damping: self.damping,
            lag: match self.velocity {
                Velocity::Lagged(lag) => lag,
                Velocity::Sensed | Velocity::BackwardDifference => 0.0,
            },
            period: self.period,
            delay: self.delay,
            quantum: self.quantum,
        }
    }

    /// Returns whether the swing of a handle decays that is released off its equilibrium between wall and
    /// push, by a `part` (0 to 1) of its depth there. With a wall that is not stable it swings out of the
    /// wall.
    ///
    /// # Errors
    /// If the device refuses its parameters.
    pub fn swing_dies_away(&self, part: f64) -> Result<bool, String> {
        let depth = self.push / (self.stiffness + PUSH_STIFFNESS);
        let swing = 2.0 * part * depth;
        Ok(Self { start: (part - 1.0) * depth, ..*self }.run()?.amplitude < MAX_DECAY_RATIO * swing)
    }

    /// Returns the case with a push against the wall at a `depth` (m), by a `part` (0 to 1) of the difference
    /// between the forces of two encoder steps; at 0.5 no step's force is nearer than half of that.
    pub fn pushed(&self, depth: f64, part: f64) -> Self {
        // The push is a spring too, so each step changes the force by the sum of both stiffnesses.
        let step = (self.stiffness + PUSH_STIFFNESS) * self.quantum;
        let steps = (depth / self.quantum).floor();
        Self { push: (steps + part) * step, ..*self }
    }

    /// Returns the amplitude up to which a motion counts as rest, m: two encoder steps, or the width of the
    /// dead zone in which friction holds the handle against the wall, 2 f_c/K.
    pub fn floor(&self) -> f64 {
        (2.0 * self.quantum).max(2.0 * self.sampled().friction / self.stiffness).max(MIN_FLOOR)
    }

    /// Drives the device into the wall by the hand, and judges the motion.
    ///
    /// # Errors
    /// If the device refuses its parameters.
    pub fn run(&self) -> Result<WallResult, String> {
        let ticks = (self.duration / TICK).round() as u64;
        self.run_with(&mut self.device().map_err(|error| error.to_string())?, 0..ticks)
    }

    /// Runs the case on a device, which may differ from the default one, and counts the gained energy over a
    /// range of ticks.
    fn run_with(&self, device: &mut EmulatedDevice, counted: Range<u64>) -> Result<WallResult, String> {
        let period = (self.period / TICK).round() as u64;
        let theory = self.sampled();
        let mut trace = Vec::with_capacity(counted.end as usize);
        let (mut last, mut lagged, mut gained) = (f64::NAN, 0.0, 0.0);
        let (mut most_work, mut lost, mut hand_energy): (f64, f64, f64) = (0.0, 0.0, 0.0);
        for tick in 0..counted.end {
            let state = device.read(tick as f64 * TICK).map_err(|error| error.to_string())?;
            if tick % period == 0 {
                let (position, sensed) = (self.position(&state.pose), self.speed(&state.twist));
                let difference = if last.is_nan() { 0.0 } else { (position - last) / self.period };
                last = position;
                lagged += (difference - lagged) * self.period / (theory.lag + self.period);
                let speed = if self.velocity == Velocity::Sensed { sensed } else { lagged };
                let wrench = self.wrench(self.force(position, speed));
                device.write(&wrench).map_err(|error| error.to_string())?;
            }
            let (pose, twist) = device.handle();
            let (position, speed) = (self.position(&pose), self.speed(&twist));
            most_work = most_work.max(device.work());
            // From the travel in the tick: where the motion reverses, the speed at its end is no measure of
            // it.
            let travel = trace.last().map_or(0.0, |[before]: &[f64; 1]| (position - before).abs());
            // Heat in a tick: (b ẋ + f_c) Δx with ẋ = Δx/Δt.
            lost += (theory.device_damping * travel / TICK + theory.friction) * travel;
            let moving = 0.5 * Emulation::default().handle.mass * speed * speed;
            hand_energy = hand_energy.min(lost + moving - device.work());
            trace.push([position]);
            if tick == counted.start {
                gained = device.work() - lost;
            }
            if position.is_nan() || position.abs() > MAX_DISTANCE {
                return Ok(WallResult {
                    outcome: Outcome::Diverged,
                    amplitude: f64::INFINITY,
                    port_energy: -most_work,
                    hand_energy,
                    gained: f64::INFINITY,
                });
            }
        }
        let (outcome, amplitude) = judge(&trace[trace.len() - JUDGED_TICKS..], self.floor());
        let gained = device.work() - lost - gained;
        Ok(WallResult { outcome, amplitude, port_energy: -most_work, hand_energy, gained })
    }

    /// Returns the wall's force, which never pulls.
    fn force(&self, position: f64, speed: f64) -> f64 {
        if position < 0.0 { (-self.stiffness * position - self.damping * speed).max(0.0) } else { 0.0 }
    }

    fn position(&self, pose: &Pose) -> f64 {
        match self.motion {
            Motion::Translation => pose.translation.z,
            Motion::Rotation => Pose::IDENTITY.rotation_vector_to(pose).z * lever_arm(),
        }
    }

    fn speed(&self, twist: &Twist) -> f64 {
        match self.motion {
            Motion::Translation => twist.linear.z,
            Motion::Rotation => twist.angular.z * lever_arm(),
        }
    }

    fn wrench(&self, force: f64) -> Wrench {
        match self.motion {
            Motion::Translation => Wrench::new(DVec3::Z * force, DVec3::ZERO),
            Motion::Rotation => Wrench::new(DVec3::ZERO, DVec3::Z * (force * lever_arm())),
        }
    }

    fn device(&self) -> Result<EmulatedDevice, DeviceError> {
        let held = self.hand.1 != Hand::NONE;
        let hand = if held {
            self.hand.1
        } else {
            Hand {
                stiffness: PUSH_STIFFNESS,
                angular_stiffness: PUSH_STIFFNESS * lever_arm().powi(2),
                ..Hand::NONE
            }
        };
        let (motion, drawn, start) = (self.motion, self.push / PUSH_STIFFNESS, self.start);
        self.emulation(hand).open(IntendedPath::function(move |time| {
            let (position, speed) = if held { approach(time) } else { (-drawn, 0.0) };
            motion.at(if time == 0.0 { start } else { position }, speed)
        }))
    }

    fn emulation(&self, hand: Hand) -> Emulation {
        let mut emulation = Emulation { substep: SUBSTEP, ..Emulation::default() };
        let specification = &mut emulation.specification;
        specification.peak_force = f64::INFINITY;
        specification.peak_torque = f64::INFINITY;
        specification.delay = self.delay;
        specification.encoder_step = 0.0;
        specification.angular_encoder_step = 0.0;
        match self.motion {
            Motion::Translation => specification.encoder_step = self.quantum,
            Motion::Rotation => specification.angular_encoder_step = self.quantum / lever_arm(),
        }
        if !self.friction {
            emulation.handle.friction = 0.0;
            emulation.handle.angular_friction = 0.0;
        }
        emulation.handle.damping = self.device_damping;
        emulation.handle.angular_damping = self.device_damping * lever_arm().powi(2);
        Emulation { hand, ..emulation }
    }

    /// Returns the net energy that a hand of any strength extracts from device and wall, J, over whole
    /// periods of the worst motion behind the wall's surface; negative where device and wall absorb energy.
    ///
    /// # Errors
    /// If the device refuses its parameters.
    pub fn shaken(&self) -> Result<f64, String> {
        let (motion, theory) = (self.motion, self.sampled());
        let shake = theory.worst_shake();
        let angular = lever_arm().powi(2);
        let hand = Hand {
            stiffness: SHAKING_IMPEDANCE.0,
            damping: SHAKING_IMPEDANCE.1,
            angular_stiffness: SHAKING_IMPEDANCE.0 * angular,
            angular_damping: SHAKING_IMPEDANCE.1 * angular,
            ..Hand::NONE
        };
        let path = IntendedPath::function(move |time| {
            let (place, speed) = theory.worst_path(shake, time);
            motion.at(SHAKE_AMPLITUDE * place - SHAKE_DEPTH, SHAKE_AMPLITUDE * speed)
        });
        let mut device = self.emulation(hand).open(path).map_err(|error| error.to_string())?;
        let turn = f64::from(shake.samples) * self.period;
        let ticks = |turns: f64| (turns * turn / TICK).round() as u64;
        let settled = (MIN_SETTLING_TIME / turn).ceil();
        let counted = ticks(settled)..ticks(settled + (MIN_SHAKING_TIME / turn).ceil());
        // The end of the range is a tick that has to be simulated, too.
        Ok(self.run_with(&mut device, counted.start..counted.end + 1)?.gained)
    }
}

/// Returns the hand's intended position and speed: straight into the wall, then still.
fn approach(time: f64) -> (f64, f64) {
    let position = REACH - SPEED * time;
    if position > -REACH { (position, -SPEED) } else { (-REACH, 0.0) }
}

/// Returns the lever arm ℓ, m.
pub fn lever_arm() -> f64 {
    let handle = Emulation::default().handle;
    (handle.inertia / handle.mass).sqrt()
}
