//! Spring and damper that hold a contact's point along its plane, within [Coulomb's law](super::coulomb).

use glam::{DMat3, DQuat, DVec3};
use palpate_core::Wrench;

use super::contact::{ContactState, PenaltyContact, SurfaceMotion};
use super::coulomb::Strain;
use crate::algebra::rotation::{skew, skew_skew};
use crate::body::BodyState;
use crate::jacobian::{Block6, WrenchJacobian, outer};

/// Friction on the body at one state.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FrictionForce {
    /// F_t on the body, N.
    pub force: DVec3,
    /// Moment on the body about the contact's normal, N·m.
    pub moment: f64,
    /// k ξ + b v_t, N.
    pub trial: Strain,
    /// v_t, m/s.
    pub slide: Strain,
    /// s: share of the trial force that friction holds.
    pub share: f64,
}

impl PenaltyContact {
    /// Strain of the spring: ξ, m, and ρ τ, m.
    #[inline(always)]
    pub(super) fn stretch(&self, state: &BodyState, at: &ContactState) -> Strain {
        let along = self.along_plane(state.pose.translation + at.arm - self.anchor.point);
        if self.radius == 0.0 {
            return Strain { along, spin: 0.0 };
        }
        Strain { along, spin: self.twisted(state) }
    }

    /// ρ τ, m, with 2 sin(τ/2) in place of τ.
    #[inline(never)]
    fn twisted(&self, state: &BodyState) -> f64 {
        let (turn, real) = self.turned(state);
        self.radius * 2.0 * real.signum() * turn.dot(self.normal)
    }

    /// Strain rate: v_t, m/s, and ρ ω_n, m/s.
    #[inline]
    pub(super) fn slide(&self, state: &BodyState, at: &ContactState) -> Strain {
        let angular = state.twist.angular - self.surface.angular;
        self.velocity_strain(at.velocity, self.normal.dot(at.velocity), angular)
    }

    /// Strain rate (m/s) of a motion, given the velocity of the point, its part along the normal, and the
    /// angular velocity.
    #[inline]
    pub(crate) fn velocity_strain(&self, velocity: DVec3, rate: f64, angular: DVec3) -> Strain {
        Strain { along: velocity - self.normal * rate, spin: self.radius * self.normal.dot(angular) }
    }

    /// Strain rate (m/s) that the surface's own motion takes off.
    #[inline]
    fn surface_strain(&self) -> Strain {
        let SurfaceMotion { velocity, angular, .. } = self.surface;
        self.velocity_strain(velocity, self.normal.dot(velocity), angular)
    }

    fn along_plane(&self, vector: DVec3) -> DVec3 {
        vector - self.normal * self.normal.dot(vector)
    }

    /// Vector and real part of the rotation from the anchor's orientation.
    fn turned(&self, state: &BodyState) -> (DVec3, f64) {
        let turn = state.pose.rotation * self.anchor.rotation.conjugate();
        (turn.xyz(), turn.w)
    }

    /// Friction while the contact pushes with λ (N).
    #[inline(always)]
    pub(super) fn friction_force(
        &self,
        state: &BodyState,
        at: &ContactState,
        normal_force: f64,
    ) -> FrictionForce {
        self.friction_force_before(0.0, state, at, normal_force)
    }

    /// Friction with the surface where it was a time (s) before, and the body at the same state.
    #[inline(always)]
    pub(crate) fn friction_force_before(
        &self,
        time: f64,
        state: &BodyState,
        at: &ContactState,
        normal_force: f64,
    ) -> FrictionForce {
        let slide = self.slide(state, at);
        let stretch = self.stretch(state, at).plus(&self.surface_strain().scaled(time));
        let trial = stretch.scaled(self.stiffness).plus(&slide.scaled(self.damping));
        let share = self.friction.share(&trial, &slide, normal_force);
        // F_t = −s (k ξ + b v_t).
        let held = trial.scaled(-share);
        FrictionForce { force: held.along, moment: self.radius * held.spin, trial, slide, share }
    }

    /// Derivatives of friction by the body's placement and velocity.
    ///
    /// With the trial force f = k ξ + b v_t along the unit direction d, ∂F_t = −∂f while the contact sticks.
    /// While it slides, F_t = −μ λ d, and so ∂F_t = −(s ∂f + d (∂(μ λ) − s dᵀ ∂f)) with s = μ λ / ‖f‖.
    pub(super) fn friction_jacobian(
        &self,
        state: &BodyState,
        at: &ContactState,
        normal_force: f64,
        friction: &FrictionForce,
    ) -> WrenchJacobian {
        let (n, angular) = (self.normal, state.twist.angular);
        // P = 1 − n nᵀ projects the point's motion onto the plane: ∂ξ/∂x = P, ∂ξ/∂φ = −P a*, and ∂v_t/∂φ =
        // −P ω* a*, since the arm a turns with the body.
        let plane = DMat3::IDENTITY - outer(n, n);
        let by_turn = plane * -skew(at.arm);
        let swept = plane * skew(angular) * -skew(at.arm);
        let spin_by_turn = if self.radius > 0.0 {
            let (turn, real) = self.turned(state);
            (n * real + turn.cross(n)) * (self.radius * real.signum())
        } else {
            DVec3::ZERO
        };
        // ∂f by placement and by velocity.
        let mut pose = StrainBy {
            linear: plane * self.stiffness,
            angular: by_turn * self.stiffness + swept * self.damping,
            spin: Row { linear: DVec3::ZERO, angular: spin_by_turn * self.stiffness },
        };
        let mut twist = StrainBy {
            linear: plane * self.damping,
            angular: by_turn * self.damping,
            spin: Row { linear: DVec3::ZERO, angular: n * (self.radius * self.damping) },
        };
        if friction.share < 1.0 {
            let direction = friction.trial.scaled(1.0 / friction.trial.length());
            let [limit_by_pose, limit_by_twist] =
                self.limit_by(at, angular, normal_force, &friction.slide, &swept);
            pose.limit(friction.share, &direction, &limit_by_pose);
            twist.limit(friction.share, &direction, &limit_by_twist);
        }
        let mut pose = pose.wrench(at, n, self.radius);
        // The arm turns too: ∂(a × F_t)/∂φ at a constant F_t is F_t* a*.
        pose.torque_angular += skew_skew(friction.force, at.arm);
        WrenchJacobian { pose, twist: twist.wrench(at, n, self.radius) }
    }

    /// ∂(μ λ) = μ ∂λ + λ ∂μ of a sliding contact, by placement and by velocity, with ∂μ = (dμ/dv / v) v_t ·
    /// ∂v_t.
    fn limit_by(
        &self,
        at: &ContactState,
        angular: DVec3,
        normal_force: f64,
        slide: &Strain,
        swept: &DMat3,
    ) -> [Row; 2] {
        let n = self.normal;
        let coefficient = self.friction.coefficient(slide.length_squared());
        let falling = self.friction.falling(slide.length_squared()) * normal_force;
        let normal_by_turn = at.moment * self.stiffness + self.swept(at, angular);
        let sliding =
            Row { linear: slide.along, angular: at.arm.cross(slide.along) + n * (self.radius * slide.spin) };
        let by_pose = Row {
            linear: n * (coefficient * self.stiffness),
            angular: normal_by_turn * coefficient + swept.transpose() * slide.along * falling,
        };
        let by_twist = Row {
            linear: n * (coefficient * self.damping) + sliding.linear * falling,
            angular: at.moment * (coefficient * self.damping) + sliding.angular * falling,
        };
        [by_pose, by_twist]
    }

    /// Moves the anchor along if the spring exceeds the Coulomb limit.
    #[inline]
    pub(super) fn settle(&mut self, state: &BodyState, rotation: &DMat3) {
        let at = self.at(state, rotation);
        let stretch = self.stretch(state, &at);
        let share = self.share_of_spring(state, &at, &stretch);
        if share < 1.0 {
            self.set_anchor(state, &at, &stretch.scaled(share));
        }
    }

    /// Share of the spring's force alone, without the damper's, that friction holds.
    #[inline]
    pub(super) fn share_of_spring(&self, state: &BodyState, at: &ContactState, stretch: &Strain) -> f64 {
        let spring = stretch.scaled(self.stiffness);
        self.friction.share(&spring, &self.slide(state, at), self.gripping_force(at))
    }

    /// Wrench that gives the spring a strain, about the centre of mass.
    pub(super) fn spring_wrench(&self, at: &ContactState, stretch: &Strain) -> Wrench {
        let spring = stretch.scaled(self.stiffness);
        let couple = self.normal * (self.radius * spring.spin);
        Wrench::new(spring.along, at.arm.cross(spring.along) + couple)
    }

    /// Puts the anchor where the contact has a given strain.
    pub(super) fn set_anchor(&mut self, state: &BodyState, at: &ContactState, stretch: &Strain) {
        self.anchor.point = state.pose.translation + at.arm - stretch.along;
        if self.radius > 0.0 {
            let half = (0.5 * stretch.spin / self.radius).clamp(-1.0, 1.0);
            let turn = DQuat::from_vec4((self.normal * half).extend((1.0 - half * half).sqrt()));
            self.anchor.rotation = (turn.conjugate() * state.pose.rotation).normalize();
        }
    }
}

/// Derivative of a strain by a motion.
#[derive(Clone, Copy)]
struct StrainBy {
    linear: DMat3,
    angular: DMat3,
    spin: Row,
}

/// Derivative of a number by a motion.
#[derive(Clone, Copy)]
struct Row {
    linear: DVec3,
    angular: DVec3,
}

impl StrainBy {
    /// Turns the derivative ∂f of a force into that of the limited force: s ∂f + d (∂limit − s ∂‖f‖), with d
    /// = f/‖f‖ and s = limit/‖f‖.
    fn limit(&mut self, share: f64, direction: &Strain, limit: &Row) {
        let d = direction.along;
        let across = direction.spin;
        // ∂‖f‖ = dᵀ ∂f.
        let linear = self.linear.transpose() * d + self.spin.linear * across;
        let angular = self.angular.transpose() * d + self.spin.angular * across;
        let linear = limit.linear - linear * share;
        let angular = limit.angular - angular * share;
        self.linear = self.linear * share + outer(d, linear);
        self.angular = self.angular * share + outer(d, angular);
        self.spin.linear = self.spin.linear * share + linear * across;
        self.spin.angular = self.spin.angular * share + angular * across;
    }

    /// Derivative of the wrench of the force −f at the contact, without the turning of the arm.
    fn wrench(&self, at: &ContactState, normal: DVec3, radius: f64) -> Block6 {
        let arm = skew(at.arm);
        Block6 {
            force_linear: -self.linear,
            force_angular: -self.angular,
            torque_linear: -(arm * self.linear) - outer(normal, self.spin.linear * radius),
            torque_angular: -(arm * self.angular) - outer(normal, self.spin.angular * radius),
        }
    }
}
