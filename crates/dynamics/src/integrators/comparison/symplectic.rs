//! Symplectic Euler, with the discrete rigid-body equation of T. Lee, M. Leok and N. H. McClamroch (*A Lie
//! group variational integrator for the attitude dynamics of a rigid body*, IEEE CCA 2005) for the rotation.

use glam::{DMat3, DVec3};
use palpate_core::Twist;

use crate::algebra::linear_solve::solve;
use crate::algebra::rotation::{SERIES_BELOW, coefficients, skew};
use crate::body::BodyState;
use crate::integrators::Integrator;
use crate::step::{Frame, Step, StepStatus};

/// Symplectic (semi-explicit) Euler: first the momenta, by the wrench at the start of the step, then the
/// placement by the new momenta.
///
/// The rotation of the step, exp(f*), is that of a discrete Lagrangian: h L = a I f + b f × I f with a = sin
/// θ / θ, b = (1 − cos θ) / θ², θ = ‖f‖. So the method is symplectic in the rotation as in the translation,
/// and the energy of a free body neither grows nor shrinks, however thin it is, while its momenta are kept to
/// rounding. Where the equation has no solution within half a turn, the body turns by h I⁻¹ L instead.
/// Springs and dampers act explicitly: it diverges about as [`ForwardEuler`](crate::ForwardEuler) does,
/// without damping later.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct SymplecticEuler;

impl Integrator for SymplecticEuler {
    fn name(&self) -> &'static str {
        "symplectic-euler"
    }

    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step {
        if let Some(refused) = frame.refused(state, dt) {
            return refused;
        }
        let (load, active) = frame.load(state);
        let (impulse, inverse) = (load * dt, frame.body.inertia.inverse());
        let guess = frame.pushed(state, &impulse, &inverse, &state.pose);

        let rotation = DMat3::from_quat(state.pose.rotation);
        let inertia = rotation * frame.body.inertia * rotation.transpose();
        let momentum = frame.body.angular_momentum(state) + impulse.torque;
        let (turned, solves) = turn(&inertia, momentum * dt, guess.angular * dt);
        let mean = Twist { linear: guess.linear, angular: turned.map_or(guess.angular, |f| f / dt) };

        let pose = state.pose.moved(&mean, dt);
        let twist = frame.pushed(state, &impulse, &inverse, &pose);
        let status = StepStatus { unconverged: turned.is_none(), solves, ..StepStatus::default() };
        frame.ended(state, &BodyState { pose, twist }, active, status)
    }
}

/// Largest number of Newton iterations for the rotation of a step.
const ITERATIONS: u32 = 12;

/// The f for which a I f + b f × I f is `target` (kg·m²), by Newton's method from a guess (rad), if it is
/// found within half a turn; and the number of iterations.
fn turn(inertia: &DMat3, target: DVec3, guess: DVec3) -> (Option<DVec3>, u32) {
    let mut f = guess;
    for i in 0..ITERATIONS {
        let (value, derivative) = discrete_momentum(inertia, f);
        let rows = std::array::from_fn(|r| derivative.row(r).to_array());
        let Some(change) = solve(rows, (target - value).to_array()) else {
            return (None, i + 1);
        };
        let change = DVec3::from_array(change);
        f += change;
        if change.length() <= 1e-13 * (1.0 + f.length()) {
            return (Some(f).filter(|f| f.length() <= std::f64::consts::PI), i + 1);
        }
    }
    (None, ITERATIONS)
}

/// The coefficients a = sin θ / θ and b = (1 − cos θ) / θ² for a squared angle, and their derivatives by it.
fn turn_coefficients(t: f64) -> ((f64, f64), (f64, f64)) {
    let (a, b, c) = coefficients(t);
    if t < SERIES_BELOW {
        let a_slope = -(1.0 - t / 10.0 * (1.0 - t / 28.0 * (1.0 - t / 54.0))) / 6.0;
        let b_slope = -(1.0 - t / 15.0 * (1.0 - t * 3.0 / 112.0 * (1.0 - t / 67.5))) / 24.0;
        return ((a, b), (a_slope, b_slope));
    }
    // cos θ = 1 − b t, and 1 − a = c t.
    ((a, b), (0.5 * (c - b), (0.5 * a - b) / t))
}

/// a I f + b f × I f, and its derivative by f.
fn discrete_momentum(inertia: &DMat3, f: DVec3) -> (DVec3, DMat3) {
    let ((a, b), (a_slope, b_slope)) = turn_coefficients(f.length_squared());
    let spun = *inertia * f;
    let crossed = f.cross(spun);
    // The coefficients change along f only.
    let along = (spun * a_slope + crossed * b_slope) * 2.0;
    let derivative = *inertia * a
        + (skew(f) * *inertia - skew(spun)) * b
        + DMat3::from_cols(along * f.x, along * f.y, along * f.z);
    (spun * a + crossed * b, derivative)
}

#[cfg(test)]
mod tests {
    use rand::{SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::differences::{largest, random_direction};

    #[test]
    fn derivative_of_the_discrete_momentum_equals_central_differences() {
        let seed = 91;
        let mut rng = StdRng::seed_from_u64(seed);
        let inertia = DMat3::from_diagonal(DVec3::new(1.0, 2.0, 2.5));
        for angle in [0.0, 1e-6, 0.05, 0.0999, 0.1001, 0.5, 2.0, 3.1] {
            let f = random_direction(&mut rng) * angle;
            let (_, found) = discrete_momentum(&inertia, f);
            let h = 1e-5;
            let columns = DVec3::AXES.map(|e| {
                (discrete_momentum(&inertia, f + e * h).0 - discrete_momentum(&inertia, f - e * h).0)
                    / (2.0 * h)
            });
            let expected = DMat3::from_cols(columns[0], columns[1], columns[2]);
            let error = largest(&(found - expected)) / largest(&expected);
            assert!(error < 1e-8, "seed {seed}, angle {angle}: {error}");
        }
    }

    #[test]
    fn a_turn_that_has_no_solution_is_given_up() {
        let inertia = DMat3::from_diagonal(DVec3::new(1.0, 2.0, 2.5));
        // sin θ is at most 1.
        assert_eq!(turn(&inertia, DVec3::X * 1.5, DVec3::X * 1.5).0, None);
        let (found, _) = turn(&inertia, DVec3::X * 0.5, DVec3::X * 0.5);
        assert!((found.unwrap() - DVec3::X * 0.5_f64.asin()).length() < 1e-12);
    }
}
