//! A search for hands that draw energy from device and session together.
//!
//! A hand is a mass, damper and spring towards a path of its own, and never gives energy that it did not put
//! in as its path moves. Counted is the energy that it has given to device and session: what the wrenches
//! took from the handle, plus what the handle's damping and friction turned into heat. The kinetic energy of
//! the handle is left out, which only counts against the session. It starts at zero, with all at rest and the
//! coupling relaxed, and may then never be negative.
//!
//! # Tolerance
//!
//! Between encoder steps the session does not know where the handle is. At any time its wrench may be that of
//! a handle a step Δ away, by (K + B/(τ + T)) Δ, along which it gives back (K + B/(τ + T)) Δ² more than it
//! took; friction pays for it only once the handle has moved on. So each of the three axes of translation and
//! of rotation may be short by that much at once, and no more in the long run.

use std::f64::consts::TAU;
use std::sync::{Arc, Mutex, PoisonError};

use palpate::device::{
    DeviceError, DeviceState, EmulatedDevice, Emulation, Hand, HapticDevice, IntendedPath, Specification,
};
use palpate::glam::{DQuat, DVec3};
use palpate::{ContactTiming, HandlePlacement, HapticRenderer, Pose, Twist, Wrench};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::boundary::Table;
use super::driven::{PERIOD, constrained};

/// Duration of a session, and of the rise of its wrench at the start, s.
const DURATION: f64 = 0.4;
const ENGAGEMENT: f64 = 0.02;
/// Height of the ball at the start, m.
const HEIGHT: f64 = 5e-4;
/// Rates of contacts, Hz.
const RATES: [f64; 4] = [50.0, 100.0, 500.0, 1000.0];
/// Longest delay of the device, s.
const MAX_DELAY: f64 = 5e-3;
/// Standard deviation of the changes with which the search climbs.
const CHANGE: f64 = 0.1;

/// Number of parameters of a hand with its session.
const GENES: usize = 22;

/// A hand, with its path and the conditions of its session: numbers from 0 to 1.
#[derive(Clone, Copy, Debug)]
pub struct Genes([f64; GENES]);

/// What a hand got.
#[derive(Clone, Copy, Debug)]
pub struct Drawn {
    /// Least energy that it had given, J.
    pub least: f64,
    /// Tolerance, J.
    pub tolerance: f64,
    /// Most that it had given, J, to see that it did something.
    pub most: f64,
    /// Least part of the heat in the device that the hand gave, once there was enough: 1 where the session
    /// gave and took nothing, negative where a hand draws energy.
    pub share: f64,
}

impl Drawn {
    pub fn holds(&self) -> bool {
        self.least >= -self.tolerance
    }

    /// How near the hand came to drawing energy.
    pub fn nearness(&self) -> f64 {
        (-self.least / self.tolerance).max(-self.share)
    }
}

impl Genes {
    pub fn random(seed: u64) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        Self(std::array::from_fn(|_| rng.random_range(0.0..1.0)))
    }

    /// Changes some of the parameters a little.
    pub fn changed(&self, seed: u64) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        let spread = 3.0_f64.sqrt() * CHANGE;
        Self(self.0.map(|gene| {
            let change = if rng.random_bool(0.5) { rng.random_range(-spread..spread) } else { 0.0 };
            (gene + change).clamp(0.0, 1.0)
        }))
    }

    fn logarithmic(&self, index: usize, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.0[index])
    }

    fn direction(&self, index: usize) -> DVec3 {
        let [x, y, z] = [0, 1, 2].map(|axis| 2.0 * self.0[index + axis] - 1.0);
        DVec3::new(x, y, z)
    }

    fn hand(&self) -> Hand {
        Hand {
            mass: self.logarithmic(0, 1e-3, 2.0),
            damping: self.logarithmic(1, 1e-2, 30.0),
            stiffness: self.logarithmic(2, 1.0, 2000.0),
            inertia: self.logarithmic(3, 1e-6, 1e-2),
            angular_damping: self.logarithmic(4, 1e-5, 0.1),
            angular_stiffness: self.logarithmic(5, 1e-3, 5.0),
            ..Hand::NONE
        }
    }

    pub fn delay(&self) -> f64 {
        (self.0[6] * MAX_DELAY / 1e-4).round() * 1e-4
    }

    pub fn encoders(&self) -> bool {
        self.0[7] < 0.5
    }

    pub fn rate(&self) -> f64 {
        RATES[((self.0[8] * RATES.len() as f64) as usize).min(RATES.len() - 1)]
    }

    /// The intended path from a pose: down onto the table, with a swing and a turn to and fro.
    fn path(&self, start: Pose) -> IntendedPath {
        let (depth, time) = (self.logarithmic(9, 1e-3, 5e-2), self.logarithmic(10, 0.01, 0.2));
        let swing = self.direction(11) * self.logarithmic(14, 1e-5, 1e-2);
        let rate = TAU * self.logarithmic(15, 0.5, 400.0);
        let turn = self.direction(16) * self.logarithmic(19, 1e-4, 0.2);
        let turning = TAU * self.logarithmic(20, 0.5, 400.0);
        let phase = TAU * self.0[21];
        IntendedPath::function(move |now| {
            // Smooth at the start; the hand's path may do what it wants after that.
            let (gone, speed) = if now < time {
                let x = now / time;
                (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / time)
            } else {
                (1.0, 0.0)
            };
            let (sine, cosine) = ((rate * now).sin(), (rate * now).cos());
            let angle = turning * now + phase;
            let (about, spin) = (turn * (angle.sin() - phase.sin()), turn * (angle.cos() * turning));
            let translation = start.translation + swing * sine - DVec3::Z * (depth * gone);
            let linear = swing * (rate * cosine) - DVec3::Z * (depth * speed);
            let rotation = DQuat::from_scaled_axis(about) * start.rotation;
            (Pose::new(translation, rotation), Twist::new(linear, spin))
        })
    }

    /// Runs the session. A stiffness (N/m) replaces that of the engine's coupling.
    ///
    /// # Errors
    /// If the session cannot start.
    pub fn run(&self, table: &Table, stiffness: Option<f64>) -> Result<Drawn, String> {
        let mut settings = constrained();
        settings.timing.engagement = ENGAGEMENT;
        settings.coupling.stiffness = stiffness;
        let mut emulation = Emulation { hand: self.hand(), ..Emulation::default() };
        emulation.specification.delay = self.delay();
        if !self.encoders() {
            emulation.specification.encoder_step = 0.0;
            emulation.specification.angular_encoder_step = 0.0;
        }
        let place = HandlePlacement::new(&settings, table.held(), &emulation.specification);
        let path = self.path(place.device_pose(&Table::above(HEIGHT)));
        let device = emulation.open(path).map_err(|error| error.to_string())?;
        let account = Account::default();
        let device = Counted { device, account: account.clone(), ticks: 0 };
        let renderer =
            HapticRenderer::new(table.held().clone(), table.scene.clone(), Box::new(device), settings)
                .map_err(|error| error.to_string())?;
        let mut session = renderer.lockstep(ContactTiming::busy(self.rate()));
        for _ in 0..(DURATION / PERIOD) as usize {
            session.step_device();
        }
        let Energy { least, most, share, .. } = account.get();
        let haptic = session.haptic();
        let (coupling, lags) = (haptic.coupling(), haptic.velocity_lags());
        let steps = if self.encoders() { Emulation::default().specification } else { no_steps() };
        let short = |stiffness: f64, damping: f64, lag: f64, step: f64| {
            3.0 * (stiffness + damping / (lag + PERIOD)) * step * step
        };
        let tolerance = short(coupling.linear_stiffness, coupling.linear_damping, lags.0, steps.encoder_step)
            + short(coupling.angular_stiffness, coupling.angular_damping, lags.1, steps.angular_encoder_step);
        Ok(Drawn { least, tolerance: tolerance + ROUNDING, most, share })
    }
}

/// Rounding of the account, J.
const ROUNDING: f64 = 1e-12;

fn no_steps() -> Specification {
    Specification { encoder_step: 0.0, angular_encoder_step: 0.0, ..Emulation::default().specification }
}

/// Energy that a hand has given to device and session, J.
#[derive(Clone, Copy, Debug)]
struct Energy {
    heat: f64,
    least: f64,
    most: f64,
    share: f64,
}

impl Default for Energy {
    fn default() -> Self {
        Self { heat: 0.0, least: 0.0, most: 0.0, share: f64::INFINITY }
    }
}

/// Heat from which the share of it counts that the hand gave, J.
const ENOUGH: f64 = 1e-5;

#[derive(Clone, Debug, Default)]
struct Account(Arc<Mutex<Energy>>);

impl Account {
    fn get(&self) -> Energy {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Emulated device whose energy is counted at each of its substeps.
struct Counted {
    device: EmulatedDevice,
    account: Account,
    ticks: u64,
}

impl Counted {
    fn count(&mut self) {
        let Emulation { handle, substep, .. } = *self.device.emulation();
        let twist = self.device.handle().1;
        let (speed, turning) = (twist.linear.length(), twist.angular.length());
        // As the emulation's steps, with the velocity at their end.
        let power = (handle.damping * speed + handle.friction) * speed
            + (handle.angular_damping * turning + handle.angular_friction) * turning;
        let mut energy = self.account.0.lock().unwrap_or_else(PoisonError::into_inner);
        energy.heat += power * substep;
        let given = energy.heat - self.device.work();
        energy.least = energy.least.min(given);
        energy.most = energy.most.max(given);
        if energy.heat > ENOUGH {
            energy.share = energy.share.min(given / energy.heat);
        }
    }
}

impl HapticDevice for Counted {
    fn specification(&self) -> &Specification {
        self.device.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        let substep = self.device.emulation().substep;
        while (self.ticks + 1) as f64 * substep < now - 0.5 * substep {
            self.ticks += 1;
            self.device.read(self.ticks as f64 * substep)?;
            self.count();
        }
        let state = self.device.read(now)?;
        if now > self.ticks as f64 * substep + 0.5 * substep {
            self.ticks += 1;
            self.count();
        }
        Ok(state)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.device.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.device.close()
    }
}
