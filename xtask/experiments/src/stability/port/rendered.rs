//! What is felt of a contact, against the spring and damper that the coupling is meant to be.
//!
//! Contacts without friction push along some wrenches f₁ … f_n. The body stays at rest if every motion of it
//! that the contacts allow is orthogonal to the coupling's change of wrench. The coupling's wrench at rest,
//! f₀, is a sum of such wrenches: if the handle moves along K⁻¹ f₀, further into the contact, the spring's
//! wrench changes along f₀ and the body stays. So whatever the contacts are, a hand that presses on feels the
//! coupling itself there, dᵀ (K + B L(z)) d with d = K⁻¹ f₀ and L the lagged difference by time. The dampers'
//! wrench is along f₀ only as far as B is in proportion to K; where f₀ is mostly a force or mostly a torque
//! that is nearly so.

use std::f64::consts::TAU;

use nalgebra::SMatrix;
use palpate::Wrench;
use palpate::dynamics::VirtualCoupling;

use super::certificate::ERRORS;
use super::driven::PERIOD;
use super::multisine::{C64, Matrix, Response, frequencies};

/// Highest frequency that is compared, Hz.
pub const HIGHEST: f64 = 30.0;

/// Rendered over wanted impedance below [`HIGHEST`].
#[derive(Clone, Copy, Debug)]
pub struct Rendered {
    /// Largest relative deviation of the complex stiffness.
    pub deviation: f64,
    /// The measurement's largest noise, [`ERRORS`] standard errors, and the largest deviation beyond it.
    pub noise: f64,
    pub beyond_noise: f64,
    /// Stiffness at the lowest frequency and damping at the highest one, over those wanted.
    pub stiffness: f64,
    pub damping: f64,
}

impl Rendered {
    /// Compares a response with a coupling whose dampers have lags (s), about a state at which the hand feels
    /// a wrench.
    pub fn of(response: &Response, coupling: &VirtualCoupling, lags: (f64, f64), felt: &Wrench) -> Self {
        let Wrench { force, torque } = *felt;
        let (f, t) = (force / coupling.linear_stiffness, torque / coupling.angular_stiffness);
        let direction =
            SMatrix::<C64, 6, 1>::from_iterator([f.x, f.y, f.z, t.x, t.y, t.z].into_iter().map(C64::from));
        let along = |of: &Matrix| (direction.adjoint() * of * direction)[0];
        let mut result =
            Self { deviation: 0.0, noise: 0.0, beyond_noise: 0.0, stiffness: f64::NAN, damping: f64::NAN };
        for (frequency, samples) in frequencies().into_iter().zip(&response.samples) {
            if frequency > HIGHEST {
                break;
            }
            let wanted = along(&wanted(coupling, lags, frequency));
            let found: Vec<C64> = samples.iter().map(&along).collect();
            let count = found.len() as f64;
            let mean = found.iter().sum::<C64>() / count;
            let spread = found.iter().map(|found| (found - mean).norm_sqr()).sum::<f64>() / (count - 1.0);
            let noise = ERRORS * (spread / count).sqrt() / wanted.norm();
            let deviation = (mean - wanted).norm() / wanted.norm();
            result.deviation = result.deviation.max(deviation);
            result.noise = result.noise.max(noise);
            result.beyond_noise = result.beyond_noise.max(deviation - noise);
            if result.stiffness.is_nan() {
                result.stiffness = mean.re / wanted.re;
            }
            result.damping = mean.im / wanted.im;
        }
        result
    }
}

/// Lag of the velocity that an emulated device reports, which dampers without a lag of their own act on, s.
const OWN_LAG: f64 = 3e-3;

/// Complex stiffness of the coupling to a body at rest.
fn wanted(coupling: &VirtualCoupling, lags: (f64, f64), frequency: f64) -> Matrix {
    let back = C64::from_polar(1.0, -TAU * frequency * PERIOD);
    let rate = |lag: f64| {
        let gain = PERIOD / (if lag > 0.0 { lag } else { OWN_LAG } + PERIOD);
        (1.0 - back) * (gain / PERIOD) / (1.0 - back * (1.0 - gain))
    };
    let linear = rate(lags.0) * coupling.linear_damping + coupling.linear_stiffness;
    let angular = rate(lags.1) * coupling.angular_damping + coupling.angular_stiffness;
    Matrix::from_diagonal(&SMatrix::from_fn(|axis, _| if axis < 3 { linear } else { angular }))
}
