//! The stiffest stable coupling to a body that is held by contact, against the eigenvalues of the exact
//! discrete system (Hulin, Preusche and Hirzinger 2006; Gil, Sánchez, Hulin, Preusche and Hirzinger 2009).
//!
//! A handle of mass m and damping b on a soft spring obeys a linear differential equation, whose solution
//! under a force that is held between samples, and arrives a time t_d late, is exact in matrix exponentials.
//! With the coupling's law, K x + B v with the lagged difference v, that gives a matrix from one sample to
//! the next. The session is stable as long as no eigenvalue of it is outside the unit circle.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use nalgebra::{DMatrix, Matrix3};
use palpate::device::{Emulation, Hand, IntendedPath};
use palpate::dynamics::{PortAxes, PortLimits, Sampling, VirtualCoupling};
use palpate::glam::DVec3;
use palpate::{ContactTiming, HandlePlacement, HapticRenderer, Pose, Twist};

use super::super::grid::{Plan, pairs};
use super::super::metered::Metered;
use super::super::page::{Section, Table, Verdict, row};
use super::ball::BallOnTable;
use super::driven::{PERIOD, constrained};

/// Spring that pushes the handle, N/m, and its force, N.
const PUSH_STIFFNESS: f64 = 20.0;
const PUSH: f64 = 1.0;
/// Height of the ball at the start, m, and time in which the push comes up, s: with more, or faster, it
/// bounces.
const START: f64 = 2e-6;
const RISE: f64 = 0.8;
/// Disturbance: a share of the push that is missing for a time from a time on, s.
const DISTURBANCE: f64 = 0.1;
const DISTURBED: (f64, f64) = (1.0, 1.02);
/// Times between which amplitudes are compared, s.
const WINDOWS: [f64; 3] = [1.2, 1.7, 2.2];
/// Amplitude below which a motion has died away, m, and largest ratio of amplitudes of one that decays.
const GONE: f64 = 1e-9;
const DECAYS: f64 = 0.99;
/// Integration step of the device, s.
const SUBSTEP: f64 = 1e-5;
/// Factor on each side of the theory's limit in which the measured one is searched, and number of bisections.
const SEARCH: f64 = 1.3;
const HALVINGS: usize = 6;
/// Largest relative deviation from theory.
const MAX_DEVIATION: f64 = 0.05;

/// Maps the stability of a pressed coupling against exact eigenvalues.
///
/// # Errors
/// If a session cannot start.
pub fn map(plan: &Plan, section: &mut Section) -> Result<(), String> {
    let devices = plan.choose(&[(0.075, 1.0), (0.075, 0.5), (0.3, 1.0), (0.3, 2.0)], &[(0.075, 1.0)]);
    let delays = plan.choose(&[0.0, 5e-4, 1e-3, 2e-3, 5e-3], &[0.0, 1.5e-3]);
    let dampings = plan.choose(&[5.0, 15.0], &[5.0]);
    let cases: Vec<Case> = pairs(&devices, &pairs(&delays, &dampings))
        .into_iter()
        .map(|((mass, device_damping), (delay, damping))| Case { mass, device_damping, damping, delay })
        .collect();
    let pressed = BallOnTable::new()?;
    let found = plan.each("port: limits", &cases, |case| Ok((case.limit(), case.measured(&pressed)?)))?;
    let ratios: Vec<f64> = found.iter().map(|(limit, measured)| measured / limit).collect();
    let beyond = ratios.iter().filter(|ratio| (**ratio - 1.0).abs() > MAX_DEVIATION).count();
    let (low, high) =
        ratios.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &r| (low.min(r), high.max(r)));
    section.paragraphs.push(
        "A ball is pressed on a table by a handle without friction on a soft spring, and the push falters for 20 ms. The \
         stiffest coupling with which the swing that follows decays is found by bisection in sessions, and compared \
         with the eigenvalues of the exact discrete system, with its delay and the lag that the engine chooses for the \
         damper."
            .to_owned(),
    );
    let rows = cases.iter().zip(&found).map(|(case, (limit, measured))| {
        row![case.mass, case.device_damping, case.damping, case.delay, limit, measured, measured / limit]
    });
    section.tables.push(Table {
        name: "port-limits".to_owned(),
        columns: vec![
            "mass_kg",
            "device_damping_ns_m",
            "damping_ns_m",
            "delay_s",
            "limit_n_m",
            "measured_n_m",
            "ratio",
        ],
        rows: rows.collect(),
    });
    section.verdicts.push(Verdict::new(
        "the stiffest stable coupling is within 5 % of that of the exact eigenvalues",
        beyond == 0,
        format!("{beyond} of {} are not; {low:.3} to {high:.3} of it", ratios.len()),
    ));
    Ok(())
}

/// A device and the coupling's damper.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub mass: f64,
    /// Damping of the device, N·s/m, and of the coupling.
    pub device_damping: f64,
    pub damping: f64,
    pub delay: f64,
}

impl Case {
    /// The stiffest stable coupling by the exact eigenvalues, N/m.
    pub fn limit(&self) -> f64 {
        let (mut low, mut high) = (1.0, 1e5);
        for _ in 0..40 {
            let middle = f64::sqrt(low * high);
            if self.spectral_radius(middle) < 1.0 { low = middle } else { high = middle }
        }
        low
    }

    /// Largest modulus of an eigenvalue with a stiffness (N/m).
    fn spectral_radius(&self, stiffness: f64) -> f64 {
        let continuous = Matrix3::new(
            0.0,
            1.0,
            0.0,
            -PUSH_STIFFNESS / self.mass,
            -self.device_damping / self.mass,
            1.0 / self.mass,
            0.0,
            0.0,
            0.0,
        );
        let over = |time: f64| (continuous * time).exp();
        let whole = (self.delay / PERIOD + 1e-6).floor();
        let part = (self.delay / PERIOD - whole).max(0.0);
        let whole = whole as usize;
        let (all, first, rest) = (over(PERIOD), over(part * PERIOD), over((1.0 - part) * PERIOD));
        // State: x, ẋ, the last x, the last v, and the forces of the last samples, the newest first.
        let size = 4 + whole + 1;
        let gain = PERIOD / (self.lag(stiffness) + PERIOD);
        let mut velocity = DMatrix::zeros(1, size);
        velocity[0] = gain / PERIOD;
        velocity[2] = -gain / PERIOD;
        velocity[3] = 1.0 - gain;
        let mut force = &velocity * -self.damping;
        force[0] -= stiffness;
        let mut next = DMatrix::zeros(size, size);
        for row in 0..2 {
            next[(row, 0)] = all[(row, 0)];
            next[(row, 1)] = all[(row, 1)];
            let older = rest[(row, 0)] * first[(0, 2)] + rest[(row, 1)] * first[(1, 2)];
            next[(row, 4 + whole)] += older;
            let newer = rest[(row, 2)];
            if whole == 0 {
                for column in 0..size {
                    next[(row, column)] += newer * force[column];
                }
            } else {
                next[(row, 3 + whole)] += newer;
            }
        }
        next[(2, 0)] = 1.0;
        next.row_mut(3).copy_from(&velocity);
        next.row_mut(4).copy_from(&force);
        for past in 1..=whole {
            next[(4 + past, 3 + past)] = 1.0;
        }
        next.complex_eigenvalues().iter().map(|value| value.norm()).fold(0.0, f64::max)
    }

    /// Lag of the velocity that the engine chooses for a stiffness, s.
    fn lag(&self, stiffness: f64) -> f64 {
        let specification = self.emulation().specification;
        let axes = PortAxes {
            stiffness: specification.stiffness,
            damping: specification.damping,
            viscous: Some(self.device_damping),
            friction: Some(0.0),
            peak: specification.peak_force,
            step: 0.0,
        };
        let sampling =
            Sampling { period: PERIOD, delay: self.delay, velocity_delay: specification.velocity_delay };
        let limits = PortLimits { translation: axes, rotation: axes, lever: 0.0, sampling };
        let coupling = VirtualCoupling {
            linear_stiffness: stiffness,
            linear_damping: self.damping,
            angular_stiffness: 0.0,
            angular_damping: 0.0,
            grasp: Pose::IDENTITY,
            max_force: f64::INFINITY,
            max_torque: f64::INFINITY,
        };
        let lag = limits.velocity_lags(&coupling).0;
        if lag > 0.0 { lag } else { specification.velocity_delay }
    }

    /// The stiffest stable coupling of sessions, by bisection, N/m.
    ///
    /// # Errors
    /// If a session cannot start.
    pub fn measured(&self, pressed: &BallOnTable) -> Result<f64, String> {
        let limit = self.limit();
        let (mut low, mut high) = (limit / SEARCH, limit * SEARCH);
        for _ in 0..HALVINGS {
            let middle = (low * high).sqrt();
            if self.settles(middle, pressed)? { low = middle } else { high = middle }
        }
        Ok((low * high).sqrt())
    }

    /// Whether a disturbance of the pressed handle decays: the motion gets smaller, and is smaller than what
    /// a push that falters can cause.
    pub fn settles(&self, stiffness: f64, pressed: &BallOnTable) -> Result<bool, String> {
        let mut settings = constrained();
        settings.coupling.stiffness = Some(stiffness);
        settings.coupling.damping = Some(self.damping);
        let emulation = self.emulation();
        let place = HandlePlacement::new(&settings, &pressed.ball, &emulation.specification);
        let start = place.device_pose(&BallOnTable::above(START));
        let path = IntendedPath::function(move |time| {
            let x = (time / RISE).min(1.0);
            let pause = if (DISTURBED.0..DISTURBED.1).contains(&time) { DISTURBANCE } else { 0.0 };
            let share = x * x * (3.0 - 2.0 * x) - pause;
            let drawn = DVec3::NEG_Z * (share * PUSH / PUSH_STIFFNESS);
            (Pose { translation: start.translation + drawn, ..start }, Twist::ZERO)
        });
        let device = emulation.open(path).map_err(|error| error.to_string())?;
        let (device, meter) = Metered::new(device);
        let renderer =
            HapticRenderer::new(pressed.ball.clone(), pressed.scene.clone(), Box::new(device), settings)
                .map_err(|error| error.to_string())?;
        let mut ends = [(f64::INFINITY, f64::NEG_INFINITY); 2];
        let stop = AtomicBool::new(false);
        let Ok(_) = renderer.run_lockstep(WINDOWS[2], ContactTiming::busy(500.0), &stop, |record| {
            let height = meter.seen().pose.translation.z;
            for (window, ends) in ends.iter_mut().enumerate() {
                if (WINDOWS[window]..WINDOWS[window + 1]).contains(&record.time) {
                    *ends = (ends.0.min(height), ends.1.max(height));
                }
            }
            Ok::<_, Infallible>(())
        });
        let [before, after] = ends.map(|(low, high)| high - low);
        let swing = 4.0 * DISTURBANCE * PUSH / stiffness;
        Ok(after < GONE || (after < DECAYS * before && after < swing))
    }

    fn emulation(&self) -> Emulation {
        let hand =
            Hand { stiffness: PUSH_STIFFNESS, angular_stiffness: 0.3, angular_damping: 0.005, ..Hand::NONE };
        let mut emulation = Emulation { substep: SUBSTEP, hand, ..Emulation::default() };
        let handle = &mut emulation.handle;
        (handle.friction, handle.angular_friction) = (0.0, 0.0);
        (handle.mass, handle.damping) = (self.mass, self.device_damping);
        let specification = &mut emulation.specification;
        (specification.encoder_step, specification.angular_encoder_step) = (0.0, 0.0);
        specification.delay = self.delay;
        specification.handle = Some(emulation.handle);
        emulation
    }
}
