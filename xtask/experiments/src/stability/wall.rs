//! A sampled virtual wall, rendered directly to an emulated device and hand, without a body or a coupling between.
//!
//! In rotation everything is as in translation at the lever arm ℓ = √(J/m) of the device, at which its inertia J weighs
//! as much as its mass m: K ℓ², B ℓ², x/ℓ.

use std::ops::Range;

use palpate::device::{DeviceError, EmulatedDevice, Emulation, Hand, HapticDevice, IntendedPath};
use palpate::glam::{DQuat, DVec3};
use palpate::{Pose, Twist, Wrench};

use palpate_measure::{Outcome, judge};

use super::conditions::SampledWall;

/// Along or about which axis the device meets the wall.
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

    /// Pose and twist of a handle at a place (m) and speed (m/s).
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

/// What the wall's damper takes for the velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Velocity {
    /// What the device reports: differences of rounded readings through its low-pass filter.
    Sensed,
    /// The difference of successive readings over the sampling period.
    BackwardDifference,
    /// The same through a first-order lag, s.
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

/// One simulation. Lengths, forces, stiffness and damping in rotation are those at the lever arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallCase {
    pub motion: Motion,
    /// K, N/m.
    pub stiffness: f64,
    /// B, N·s/m.
    pub damping: f64,
    /// T, s; a multiple of [`TICK`], as is the delay.
    pub period: f64,
    /// From a sample to its force, t_d, s: the device's.
    pub delay: f64,
    /// Δ, m.
    pub quantum: f64,
    pub velocity: Velocity,
    /// Whether the device has its Coulomb friction.
    pub friction: bool,
    /// b, the viscous damping of the device, N·s/m.
    pub device_damping: f64,
    /// What pushes a device that no hand holds, N.
    pub push: f64,
    /// Where the handle starts, m: in front of the wall where that is above zero.
    pub start: f64,
    /// Simulated time, s.
    pub duration: f64,
    pub hand: (&'static str, Hand),
}

/// What a simulation showed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallResult {
    pub outcome: Outcome,
    /// Peak to peak over the last half second, m.
    pub amplitude: f64,
    /// The least energy that had flowed from the device into the wall, J.
    pub port_energy: f64,
    /// The least energy that had flowed from the hand into the device with the wall, J: what the wall took, what the
    /// device's damping and friction turned to heat, and what the handle's motion holds.
    pub hand_energy: f64,
    /// What the hand had got of device and wall from the tick on from which that is counted to the end, but for what the handle's
    /// motion holds, J.
    pub gained: f64,
}

/// How finely forces are timed and the motion is looked at, s.
pub const TICK: f64 = 1e-4;
/// The ticks of the last second, which is judged.
const LAST: usize = 10_000;
/// The device's integration step, s.
const SUBSTEP: f64 = 1e-5;
/// How far from the wall the hand starts, and how far behind it it ends, m; and how fast it goes, m/s.
const REACH: f64 = 5e-3;
const SPEED: f64 = 0.2;
/// What pushes a device that no hand holds is a spring so soft, N/m.
const SOFT: f64 = 20.0;
/// A hand that shakes the handle as it likes, N/m and N·s/m; by how much, and how far behind the wall's surface, m.
const STRONG: (f64, f64) = (1e6, 1e4);
const SHAKE: f64 = 1e-4;
const DEEP: f64 = 0.05;
/// What is left of a swing that dies away, at most: a steady one is not measured as quite so large as it was.
const DYING: f64 = 0.99;
/// How long it is left to come to a steady motion, and how long it then shakes, at the least, s.
const SETTLING: f64 = 0.5;
const SHAKING: f64 = 1.0;
/// A handle this far away has left, m.
const FAR: f64 = 0.5;
/// The least floor of the amplitude, m.
const STILL: f64 = 1e-6;

impl WallCase {
    /// The premium-1.5 at 1 kHz with a relaxed grip, as it senses.
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

    /// The case in the terms of the conditions of theory.
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

    /// Whether the handle, which is let go at a `part` (0 to 1) of its depth from where the wall and what pushes are in
    /// balance, swings less in the end than at the start. A wall that is not stable makes it swing out of the wall.
    ///
    /// # Errors
    /// If the device refuses its parameters.
    pub fn swing_dies_away(&self, part: f64) -> Result<bool, String> {
        let depth = self.push / (self.stiffness + SOFT);
        let swing = 2.0 * part * depth;
        Ok(Self { start: (part - 1.0) * depth, ..*self }.run()?.amplitude < DYING * swing)
    }

    /// The case with a push that leans on the wall at a `depth` (m), between the force of an encoder step and the next by a
    /// `part`, 0 to 1; half of the way no step's force is nearer than half a step's.
    pub fn pushed(&self, depth: f64, part: f64) -> Self {
        // What pushes is a spring itself, and softer by as much at each step.
        let step = (self.stiffness + SOFT) * self.quantum;
        let steps = (depth / self.quantum).floor();
        Self { push: (steps + part) * step, ..*self }
    }

    /// The amplitude up to which a motion counts as rest, m: two encoder steps, or the width of the dead zone in which
    /// friction holds the handle against the wall, 2 f_c/K.
    pub fn floor(&self) -> f64 {
        (2.0 * self.quantum).max(2.0 * self.sampled().friction / self.stiffness).max(STILL)
    }

    /// Lets the hand drive the device into the wall, and judges what becomes of it.
    ///
    /// # Errors
    /// If the device refuses its parameters.
    pub fn run(&self) -> Result<WallResult, String> {
        let ticks = (self.duration / TICK).round() as u64;
        self.run_with(&mut self.device().map_err(|error| error.to_string())?, 0..ticks)
    }

    /// The same of a device that may do otherwise, with what is gained counted from one tick to another, the end.
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
            // By the way that it went: where it turns back, its speed says nothing of the tick that has passed.
            let way = trace.last().map_or(0.0, |[before]: &[f64; 1]| (position - before).abs());
            lost += (theory.device_damping * way / TICK + theory.friction) * way;
            let moving = 0.5 * Emulation::default().handle.mass * speed * speed;
            hand_energy = hand_energy.min(lost + moving - device.work());
            trace.push([position]);
            if tick == counted.start {
                gained = device.work() - lost;
            }
            if position.is_nan() || position.abs() > FAR {
                return Ok(WallResult {
                    outcome: Outcome::Diverged,
                    amplitude: f64::INFINITY,
                    port_energy: -most_work,
                    hand_energy,
                    gained: f64::INFINITY,
                });
            }
        }
        let (outcome, amplitude) = judge(&trace[trace.len() - LAST..], self.floor());
        let gained = device.work() - lost - gained;
        Ok(WallResult { outcome, amplitude, port_energy: -most_work, hand_energy, gained })
    }

    /// The wall never pulls.
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
            Hand { stiffness: SOFT, angular_stiffness: SOFT * lever_arm().powi(2), ..Hand::NONE }
        };
        let (motion, drawn, start) = (self.motion, self.push / SOFT, self.start);
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

    /// The energy that a hand of any strength gets out of device and wall, J, when it moves the handle to and fro behind the
    /// wall's surface in the way that the device needs most damping for, over whole turns; negative where device and wall take
    /// energy up.
    ///
    /// # Errors
    /// If the device refuses its parameters.
    pub fn shaken(&self) -> Result<f64, String> {
        let (motion, theory) = (self.motion, self.sampled());
        let shake = theory.worst_shake();
        let angular = lever_arm().powi(2);
        let hand = Hand {
            stiffness: STRONG.0,
            damping: STRONG.1,
            angular_stiffness: STRONG.0 * angular,
            angular_damping: STRONG.1 * angular,
            ..Hand::NONE
        };
        let path = IntendedPath::function(move |time| {
            let (place, speed) = theory.worst_path(shake, time);
            motion.at(SHAKE * place - DEEP, SHAKE * speed)
        });
        let mut device = self.emulation(hand).open(path).map_err(|error| error.to_string())?;
        let turn = f64::from(shake.samples) * self.period;
        let ticks = |turns: f64| (turns * turn / TICK).round() as u64;
        let settled = (SETTLING / turn).ceil();
        let counted = ticks(settled)..ticks(settled + (SHAKING / turn).ceil());
        // The last tick is simulated, too.
        Ok(self.run_with(&mut device, counted.start..counted.end + 1)?.gained)
    }
}

/// Where the hand means to be, and how fast: straight into the wall, then still.
fn approach(time: f64) -> (f64, f64) {
    let position = REACH - SPEED * time;
    if position > -REACH { (position, -SPEED) } else { (-REACH, 0.0) }
}

/// ℓ, m.
pub fn lever_arm() -> f64 {
    let handle = Emulation::default().handle;
    (handle.inertia / handle.mass).sqrt()
}
