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

use palpate::device::{Emulation, Hand, IntendedPath};
use palpate::glam::{DQuat, DVec3};
use palpate::{ContactTiming, HandlePlacement, HapticRenderer, Pose, Twist};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::super::grid::Plan;
use super::super::page::{Section, Table, Verdict, row};
use super::account::{Counted, Energy};
use super::ball::BallOnTable;
use super::driven::{PERIOD, constrained};

/// Numbers of hands drawn at random, of those that climb, and of the steps that they climb, in full and
/// quick.
const HANDS: (usize, usize) = (10_000, 60);
const CLIMBERS: (usize, usize) = (20, 2);
const CLIMBS: (usize, usize) = (50, 3);
/// Number of hands of the negative control, and the stiffness of its coupling over that which is passive.
const CONTROLS: (usize, usize) = (200, 40);
const TOO_STIFF: f64 = 4.0;
/// Duration of a session, and of the rise of its wrench at the start, s.
const DURATION: f64 = 0.4;
const ENGAGEMENT: f64 = 0.02;
/// Height of the ball at the start, m.
const HEIGHT: f64 = 5e-4;
/// Rates of contacts, Hz.
const RATES: [f64; 4] = [50.0, 100.0, 500.0, 1000.0];
/// Longest delay of the device, s, and largest coefficient of friction.
const MAX_DELAY: f64 = 5e-3;
const MAX_FRICTION: f64 = 0.8;
/// Standard deviation of the changes with which the search climbs.
const CHANGE: f64 = 0.1;

/// Searches for hands that draw energy.
///
/// # Errors
/// If a session cannot start.
pub fn map(plan: &Plan, section: &mut Section) -> Result<(), String> {
    let of = |(full, quick): (usize, usize)| if plan.quick { quick } else { full };
    let pressed = BallOnTable::new()?;
    let drawn: Vec<Genes> = (0..of(HANDS)).map(|seed| Genes::random(seed as u64)).collect();
    let found = plan.each("port: hands", &drawn, |genes| genes.run(&pressed, None))?;
    let mut all: Vec<(Genes, Drawn)> = drawn.into_iter().zip(found).collect();
    all.sort_by(|a, b| b.1.nearness().total_cmp(&a.1.nearness()));
    let random = all[0].1;
    let climbers: Vec<(usize, (Genes, Drawn))> = all.iter().take(of(CLIMBERS)).copied().enumerate().collect();
    let climbed = plan.each("port: climbing", &climbers, |&(index, mut best)| {
        for climb in 0..of(CLIMBS) {
            let genes = best.0.changed((1 + index * 1000 + climb) as u64);
            let drawn = genes.run(&pressed, None)?;
            if drawn.nearness() > best.1.nearness() {
                best = (genes, drawn);
            }
        }
        Ok(best)
    })?;
    all.extend(climbed);
    all.sort_by(|a, b| b.1.nearness().total_cmp(&a.1.nearness()));
    let beyond = all.iter().filter(|(_, drawn)| !drawn.holds()).count();
    let worst = all[0].1;
    // The same hands with a coupling that is not passive: the search must find it.
    let controls: Vec<Genes> = (0..of(CONTROLS)).map(|seed| Genes::random(seed as u64)).collect();
    let control = plan.each("port: control", &controls, |genes| genes.run(&pressed, Some(too_stiff())))?;
    let caught = control.iter().filter(|drawn| !drawn.holds()).count();
    section.paragraphs.push(format!(
        "{} hands of random mass, damping and stiffness, on random paths, press a ball on a table in sessions of 0.4 s, \
         with random delays, encoder steps, friction and rates of contacts. The {} that came nearest to drawing energy are then \
         changed a little, {} times each, and the better ones kept. What a hand has given to device and session may never \
         be negative, beyond the energy by which encoder steps can deceive the session at any moment: (K + B/(τ + T)) Δ² \
         by axis.",
        of(HANDS),
        of(CLIMBERS),
        of(CLIMBS),
    ));
    let rows = all.iter().take(200).map(|(genes, drawn)| {
        row![
            genes.delay(),
            genes.encoders(),
            genes.rate(),
            genes.friction(),
            drawn.least,
            drawn.tolerance,
            drawn.most,
            drawn.share
        ]
    });
    section.tables.push(Table {
        name: "port-hands".to_owned(),
        columns: vec![
            "delay_s",
            "encoder_steps",
            "contact_rate_hz",
            "friction",
            "least_energy_j",
            "tolerance_j",
            "most_energy_j",
            "share_of_heat",
        ],
        rows: rows.collect(),
    });
    section.verdicts.push(Verdict::new(
        "no hand draws energy",
        beyond == 0,
        format!(
            "{beyond} of {} do; the nearest gave {:.3} of the heat in the device, before climbing {:.3}, and {:.2e} J at \
             the least, with a tolerance of {:.2e} J",
            all.len(),
            worst.share,
            random.share,
            worst.least,
            worst.tolerance,
        ),
    ));
    section.verdicts.push(Verdict::new(
        format!("with a coupling of {TOO_STIFF} times the stiffness that is passive, hands draw energy"),
        caught > 0,
        format!("{caught} of {} do", control.len()),
    ));
    Ok(())
}

/// Stiffness of the coupling of the negative control, N/m.
pub fn too_stiff() -> f64 {
    TOO_STIFF * Emulation::default().handle.damping / (0.5 * PERIOD)
}

/// Number of parameters of a hand with its session.
const GENES: usize = 23;

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

    /// How near the hand came to drawing energy: more than 1 if it did.
    pub fn nearness(&self) -> f64 {
        if self.holds() { -self.share } else { -self.least / self.tolerance }
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

    /// Coefficient of friction of the contacts: none in half of the sessions.
    pub fn friction(&self) -> f64 {
        (2.0 * self.0[22] - 1.0).max(0.0) * MAX_FRICTION
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
    pub fn run(&self, pressed: &BallOnTable, stiffness: Option<f64>) -> Result<Drawn, String> {
        let mut settings = constrained();
        settings.timing.engagement = ENGAGEMENT;
        settings.coupling.stiffness = stiffness;
        settings.contact.friction = self.friction();
        let mut emulation = Emulation { hand: self.hand(), ..Emulation::default() };
        let specification = &mut emulation.specification;
        specification.delay = self.delay();
        if !self.encoders() {
            (specification.encoder_step, specification.angular_encoder_step) = (0.0, 0.0);
        }
        let steps = (specification.encoder_step, specification.angular_encoder_step);
        let place = HandlePlacement::new(&settings, &pressed.ball, &emulation.specification);
        let path = self.path(place.device_pose(&BallOnTable::above(HEIGHT)));
        let device = emulation.open(path).map_err(|error| error.to_string())?;
        let (device, account) = Counted::new(device);
        let renderer =
            HapticRenderer::new(pressed.ball.clone(), pressed.scene.clone(), Box::new(device), settings)
                .map_err(|error| error.to_string())?;
        let mut session = renderer.lockstep(ContactTiming::busy(self.rate()));
        for _ in 0..(DURATION / PERIOD) as usize {
            session.step_device();
        }
        let Energy { least, most, share, .. } = account.energy();
        let haptic = session.haptic();
        let (coupling, lags) = (haptic.coupling(), haptic.velocity_lags());
        let own = Emulation::default().specification.velocity_delay;
        let short = |stiffness: f64, damping: f64, lag: f64, step: f64| {
            let lag = if lag > 0.0 { lag } else { own };
            3.0 * (stiffness + damping / (lag + PERIOD)) * step * step
        };
        let tolerance = short(coupling.linear_stiffness, coupling.linear_damping, lags.0, steps.0)
            + short(coupling.angular_stiffness, coupling.angular_damping, lags.1, steps.1);
        Ok(Drawn { least, tolerance: tolerance + ROUNDING, most, share })
    }
}

/// Rounding of the account, J.
const ROUNDING: f64 = 1e-12;
