//! The passivity of a measured port together with the device's damping.

use std::f64::consts::TAU;

use nalgebra::SymmetricEigen;
use palpate::device::Handle;

use super::driven::PERIOD;
use super::multisine::{C64, Matrix, Response, frequencies};

/// Standard errors that count as noise: thousands of eigenvalues are looked at.
pub const ERRORS: f64 = 4.0;
/// Harmonics on each side whose variances are averaged: a few samples alone do not tell it.
const POOLED: usize = 4;

/// Least part of the device's damping that is left, over all frequencies and directions.
#[derive(Clone, Copy, Debug)]
pub struct Certificate {
    /// Smallest eigenvalue, in units of the device's damping: 1 where the session needs none, 0 at the
    /// limit.
    pub least: f64,
    /// Its frequency, Hz, and the measurement's noise there: [`ERRORS`] standard errors.
    pub frequency: f64,
    pub noise: f64,
    /// Smallest sum of an eigenvalue and its noise: the port is not passive if it is negative.
    pub bound: f64,
    /// Largest noise at any frequency.
    pub largest_noise: f64,
}

impl Certificate {
    pub fn holds(&self) -> bool {
        self.bound >= 0.0
    }

    /// Judges a response at a device with a handle and a delay (s).
    pub fn of(response: &Response, handle: &Handle, delay: f64) -> Self {
        let lines: Vec<(f64, f64, f64)> = frequencies()
            .into_iter()
            .zip(&response.samples)
            .map(|(frequency, samples)| {
                let (least, variance) = smallest(samples, frequency, handle, delay);
                (frequency, least, variance / samples.len() as f64)
            })
            .collect();
        let mut found = Self {
            least: f64::INFINITY,
            frequency: 0.0,
            noise: 0.0,
            bound: f64::INFINITY,
            largest_noise: 0.0,
        };
        for (index, &(frequency, least, _)) in lines.iter().enumerate() {
            let near = &lines[index.saturating_sub(POOLED)..(index + POOLED + 1).min(lines.len())];
            let variance = near.iter().map(|line| line.2).sum::<f64>() / near.len() as f64;
            let noise = ERRORS * variance.sqrt();
            found.largest_noise = found.largest_noise.max(noise);
            found.bound = found.bound.min(least + noise);
            if least < found.least {
                (found.least, found.frequency, found.noise) = (least, frequency, noise);
            }
        }
        found
    }
}

/// Smallest eigenvalue of the damping that is left, and the variance of a sample of it.
///
/// Noise lowers the smallest eigenvalue of a mean. So each sample gives the value in the direction that is
/// smallest in the mean of the others: on average that is never below the true smallest eigenvalue.
fn smallest(samples: &[Matrix], frequency: f64, handle: &Handle, delay: f64) -> (f64, f64) {
    let left: Vec<Matrix> = samples.iter().map(|sample| left(sample, frequency, handle, delay)).collect();
    let sum = left.iter().sum::<Matrix>();
    let values = left.iter().map(|judged| {
        let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(sum - judged);
        let direction = eigenvectors.column(eigenvalues.imin());
        (direction.adjoint() * judged * direction)[0].re
    });
    let values: Vec<f64> = values.collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let spread: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, spread / (values.len() - 1) as f64)
}

/// The damping that is left at a frequency (Hz), in units of the device's: the matrix C of
/// [the map](super).
pub fn left(response: &Matrix, frequency: f64, handle: &Handle, delay: f64) -> Matrix {
    let mut scaled = *response;
    let root = |axis: usize| if axis < 3 { handle.damping.sqrt() } else { handle.angular_damping.sqrt() };
    for row in 0..6 {
        for column in 0..6 {
            scaled[(row, column)] /= C64::from(root(row) * root(column));
        }
    }
    let angle = TAU * frequency * PERIOD;
    let whole = (delay / PERIOD + 1e-6).floor();
    let part = (delay / PERIOD - whole).max(0.0);
    let back = C64::from_polar(1.0, -angle);
    let hold = (1.0 - back) * PERIOD / (2.0 * (1.0 - angle.cos()));
    let factor = hold * C64::from_polar(1.0, -whole * angle) * (1.0 - part + back * part);
    let needed = scaled * factor;
    let corner = 0.25 * PERIOD * PERIOD * part * (1.0 - part);
    Matrix::identity()
        - (needed + needed.adjoint()) * C64::from(0.5)
        - scaled.adjoint() * scaled * C64::from(corner)
}
