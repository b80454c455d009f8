//! Inertia of two bodies with a hinge, for the motion (ω, q̇) about their centre of mass, and its derivative
//! by the angle.
//!
//! With I_1, I_2 the bodies' own inertias in world axes and μ = m_1 m_2/(m_1 + m_2), the kinetic energy
//! about the centre of mass is ½ ω · I_c ω + q̇ g · ω + ½ J q̇² with
//!
//! I_c = I_1 + I_2 + μ (‖d‖² − d dᵀ),  g = I_2 e + μ d × (e × b),  J = e · I_2 e + μ ‖e × b‖²,
//!
//! the composite inertia (Featherstone 2008, §6.2) of a tree of two bodies. Turning the second body about e
//! changes d by e × b, e × b by e × (e × b) and I_2 by e* I_2 − I_2 e*; J does not change.

use glam::{DMat3, DVec3};

use super::linkage::Linkage;
use crate::algebra::rotation::cross_columns;
use crate::jacobian::outer;

/// Inertia of both bodies about their centre of mass, in world axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct CompositeInertia {
    /// I_c, kg·m².
    pub whole: DMat3,
    /// g, kg·m².
    pub shared: DVec3,
    /// J, kg·m².
    pub hinge: f64,
    /// ∂I_c/∂q.
    whole_slope: DMat3,
    /// ∂g/∂q.
    shared_slope: DVec3,
}

impl CompositeInertia {
    pub fn new(first: &DMat3, second: DMat3, reduced: f64, linkage: &Linkage) -> Self {
        let (axis, sweep) = (linkage.axis, linkage.sweep);
        let between = linkage.centres[1] - linkage.centres[0];
        let spin = second * axis;
        let about = |a: DVec3, b: DVec3| DMat3::from_diagonal(DVec3::splat(a.dot(b))) - outer(a, b);
        let turned = cross_columns(axis, &second);
        Self {
            whole: *first + second + about(between, between) * reduced,
            shared: spin + between.cross(sweep) * reduced,
            hinge: axis.dot(spin) + sweep.length_squared() * reduced,
            whole_slope: turned
                + turned.transpose()
                + (about(between, sweep) + about(sweep, between)) * reduced,
            shared_slope: axis.cross(spin) + between.cross(axis.cross(sweep)) * reduced,
        }
    }

    /// I_c ω + g q̇: the angular momentum about the centre of mass, kg·m²/s.
    pub fn momentum(&self, angular: DVec3, rate: f64) -> DVec3 {
        self.whole * angular + self.shared * rate
    }

    /// g · ω + J q̇: the hinge's momentum, kg·m²/s.
    pub fn hinge_momentum(&self, angular: DVec3, rate: f64) -> f64 {
        self.shared.dot(angular) + self.hinge * rate
    }

    /// Derivative of the angular momentum by the angle, kg·m²/s.
    pub fn momentum_slope(&self, angular: DVec3, rate: f64) -> DVec3 {
        self.whole_slope * angular + self.shared_slope * rate
    }

    /// ∂g/∂q · ω.
    pub fn shared_slope(&self, angular: DVec3) -> f64 {
        self.shared_slope.dot(angular)
    }

    /// Derivative of the kinetic energy by the angle, ½ ω · ∂I_c/∂q ω + q̇ ∂g/∂q · ω, N·m.
    pub fn energy_slope(&self, angular: DVec3, rate: f64) -> f64 {
        angular.dot(self.whole_slope * angular * 0.5 + self.shared_slope * rate)
    }
}

#[cfg(test)]
mod tests {
    use rand::{SeedableRng as _, rngs::StdRng};

    use super::super::tests::{random_state, random_tool};
    use super::*;
    use crate::differences::largest;

    #[test]
    fn slopes_equal_central_differences() {
        let seed = 113;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..200 {
            let tool = random_tool(&mut rng, 0.1);
            let state = random_state(&mut rng);
            let rotation = state.first.pose.rotation;
            let turn = DMat3::from_quat(rotation);
            let first = turn * tool.first.inertia * turn.transpose();
            let at = |angle: f64| tool.inertia(&first, &tool.linkage(rotation, angle));
            let (here, h) = (at(state.angle), 1e-5);
            let (low, high) = (at(state.angle - h), at(state.angle + h));
            let whole = (high.whole - low.whole) * (0.5 / h);
            let shared = (high.shared - low.shared) * (0.5 / h);
            let size = largest(&here.whole);
            assert!(largest(&(whole - here.whole_slope)) < 1e-8 * size, "seed {seed}, case {case}");
            assert!((shared - here.shared_slope).length() < 1e-8 * size, "seed {seed}, case {case}");
            assert!((high.hinge - low.hinge).abs() < 1e-13 * size, "seed {seed}, case {case}");
        }
    }

    #[test]
    fn energy_and_momentum_are_those_of_the_bodies() {
        let seed = 114;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..200 {
            let tool = random_tool(&mut rng, 0.1);
            let state = random_state(&mut rng);
            let rotation = state.first.pose.rotation;
            let turn = DMat3::from_quat(rotation);
            let first = turn * tool.first.inertia * turn.transpose();
            let inertia = tool.inertia(&first, &tool.linkage(rotation, state.angle));
            let (linear, angular) = tool.momenta(&state);
            let spin = state.first.twist.angular;
            let found = inertia.momentum(spin, state.rate);
            assert!((found - angular).length() < 1e-12 * angular.length(), "seed {seed}, case {case}");
            let energy = 0.5 * linear.length_squared() / tool.mass()
                + 0.5 * spin.dot(found)
                + 0.5 * state.rate * inertia.hinge_momentum(spin, state.rate);
            let expected = tool.kinetic_energy(&state);
            assert!((energy / expected - 1.0).abs() < 1e-12, "seed {seed}, case {case}");
        }
    }
}
