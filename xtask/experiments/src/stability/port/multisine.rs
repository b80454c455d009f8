//! Response of a port to small motions, measured by multisines.
//!
//! Each of six experiments moves all six axes at once with the sum of the odd harmonics of a period of
//! [`LENGTH`] steps. The phases are random, and shifted from axis to axis and experiment to experiment by the
//! columns of the 6 × 6 Fourier matrix, so that at each frequency the six motions are orthogonal (Guillaume,
//! Pintelon and Schoukens 1996; Dobrowiecki and Schoukens 2007). Part of a period settles, the next period is
//! measured. Then all is repeated with other phases. Sessions in lockstep answer the same phases in the same
//! way; what differs from phases to phases is noise and distortion: contacts that change, encoder steps,
//! queries that come rarely. So more periods of the same phases would tell nothing, but more phases do.
//!
//! Before all that, the motions of the first phases are run through once and not measured: they may bring an
//! object that rested at a corner or an edge to other contacts, where it then stays.

use std::f64::consts::TAU;

use nalgebra::{Complex, SMatrix};
use palpate::glam::{DQuat, DVec3};
use palpate::{Pose, Wrench};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::driven::{PERIOD, Port};
use super::states::ARM;

pub type C64 = Complex<f64>;
pub type Matrix = SMatrix<C64, 6, 6>;

/// Steps of a period: the lowest frequency is that of one period, the highest odd harmonic just below half of
/// the sampling rate.
pub const LENGTH: usize = 200;
/// Steps before them, in which what was before dies away: several queries at 50 Hz.
const SETTLING: usize = 100;
/// Frequency above which amplitudes fall in proportion to it, Hz: velocities are then even, as dampers need.
const CORNER: f64 = 20.0;

/// Size of the motion and number of sets of phases.
#[derive(Clone, Copy, Debug)]
pub struct Design {
    /// Amplitude of the lowest harmonics by axis, m, or m at [`ARM`].
    pub amplitude: f64,
    pub sets: usize,
}

/// Responses at the odd harmonics.
pub struct Response {
    /// By harmonic: the response of the wrench that resists the hand to the displacement (N/m, N, N/m·m,
    /// N·m/rad), for each set of phases.
    pub samples: Vec<Vec<Matrix>>,
}

impl Response {
    /// Takes the samples of another measurement of the same port, with other phases.
    pub fn add(&mut self, other: Self) {
        for (samples, more) in self.samples.iter_mut().zip(other.samples) {
            samples.extend(more);
        }
    }
}

/// The odd harmonics' frequencies, Hz.
pub fn frequencies() -> Vec<f64> {
    harmonics().map(|harmonic| harmonic as f64 / (LENGTH as f64 * PERIOD)).collect()
}

fn harmonics() -> impl Iterator<Item = usize> {
    (1..LENGTH / 2).step_by(2)
}

/// Measures the response of a port about a pose of the handle.
pub fn measure(port: &mut dyn Port, about: &Pose, design: &Design, seed: u64) -> Response {
    let mut rng = StdRng::seed_from_u64(seed);
    let sets: Vec<_> = (0..design.sets).map(|_| phases(&mut rng)).collect();
    if let Some(phases) = sets.first() {
        for experiment in 0..6 {
            let _ = follow(port, about, &path(design, phases, experiment));
        }
    }
    let mut samples = vec![Vec::new(); harmonics().count()];
    for phases in &sets {
        let mut moved = vec![Matrix::zeros(); samples.len()];
        let mut resisted = moved.clone();
        for experiment in 0..6 {
            let path = path(design, phases, experiment);
            let _ = follow(port, about, &path[LENGTH - SETTLING..]);
            let (motion, wrench) = follow(port, about, &path);
            for (line, harmonic) in harmonics().enumerate() {
                moved[line].set_column(experiment, &spectrum(&motion, harmonic));
                resisted[line].set_column(experiment, &spectrum(&wrench, harmonic));
            }
        }
        for (samples, (moved, resisted)) in samples.iter_mut().zip(moved.iter().zip(&resisted)) {
            samples.extend(moved.try_inverse().map(|inverse| resisted * inverse));
        }
    }
    Response { samples }
}

/// Random phases of the harmonics by axis.
fn phases(rng: &mut StdRng) -> Vec<[f64; 6]> {
    harmonics().map(|_| std::array::from_fn(|_| rng.random_range(0.0..TAU))).collect()
}

/// The damping that takes as much energy from the motion as Coulomb friction, for a unit of friction, by
/// translation and rotation: the mean of the speed over that of its square, s/m and s/rad.
pub fn damping_of_friction(design: &Design) -> (f64, f64) {
    let path = path(design, &phases(&mut StdRng::seed_from_u64(0)), 0);
    let over = |from: usize| {
        let speeds = path.windows(2).map(|pair| {
            let squares = (from..from + 3).map(|axis| (pair[1][axis] - pair[0][axis]).powi(2));
            squares.sum::<f64>().sqrt() / PERIOD
        });
        let (sum, squares) = speeds.fold((0.0, 0.0), |(sum, squares), v| (sum + v, squares + v * v));
        sum / squares
    };
    (over(0), over(3))
}

/// Displacements of an experiment, m and rad, over a period.
fn path(design: &Design, phases: &[[f64; 6]], experiment: usize) -> Vec<[f64; 6]> {
    let sample = |step: usize| {
        let mut place = [0.0; 6];
        for (harmonic, phases) in harmonics().zip(phases) {
            let frequency = harmonic as f64 / (LENGTH as f64 * PERIOD);
            let amplitude = design.amplitude / (1.0 + frequency / CORNER);
            for (axis, place) in place.iter_mut().enumerate() {
                let angle = TAU * ((harmonic * step % LENGTH) as f64 / LENGTH as f64);
                let shift = TAU * ((axis * experiment % 6) as f64 / 6.0);
                let arm = if axis < 3 { 1.0 } else { ARM };
                *place += amplitude / arm * (angle + phases[axis] + shift).cos();
            }
        }
        place
    };
    (0..LENGTH).map(sample).collect()
}

/// Moves the handle along a path. Returns its displacements and the wrenches against them.
fn follow(port: &mut dyn Port, about: &Pose, path: &[[f64; 6]]) -> (Vec<[f64; 6]>, Vec<[f64; 6]>) {
    path.iter()
        .map(|&[x, y, z, a, b, c]| {
            let turn = DVec3::new(a, b, c);
            let rotation = DQuat::from_scaled_axis(turn) * about.rotation;
            let handle = Pose::new(about.translation + DVec3::new(x, y, z), rotation);
            let Wrench { force, torque } = port.step(&handle);
            // The power of a torque τ is τ · ω with ω = u̇ + ½ u × u̇ for a small turn u: the load that is
            // conjugate to u is τ + ½ τ × u. Without it a steady torque would look like a stiffness that
            // is not symmetric.
            let torque = torque + 0.5 * torque.cross(turn);
            ([x, y, z, a, b, c], [-force.x, -force.y, -force.z, -torque.x, -torque.y, -torque.z])
        })
        .unzip()
}

/// Complex amplitudes of a harmonic.
fn spectrum(signal: &[[f64; 6]], harmonic: usize) -> SMatrix<C64, 6, 1> {
    let mut sum = SMatrix::<C64, 6, 1>::zeros();
    for (step, values) in signal.iter().enumerate() {
        let turned = C64::from_polar(1.0, -TAU * ((harmonic * step % LENGTH) as f64 / LENGTH as f64));
        for (sum, value) in sum.iter_mut().zip(values) {
            *sum += turned * *value;
        }
    }
    sum
}
