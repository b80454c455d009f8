//! One contact of a step, linearised at its start.

use glam::DVec3;
use palpate_core::Twist;

use crate::body::BodyState;
use crate::penalty::{ContactState, FrictionForce, PenaltyContact, Strain};

/// A contact in the step's linear systems. D = (direction, moment) is the direction of its wrench, and δ̇ = D
/// · (v, ω).
#[derive(Clone, Copy)]
pub(crate) struct ActiveContact {
    /// Lever arm a of the contact's point, m.
    pub(super) arm: DVec3,
    /// ∂δ/∂x: n if there are no curvature terms.
    pub(super) direction: DVec3,
    /// ∂δ/∂φ: a × n if there are no curvature terms.
    pub(super) moment: DVec3,
    /// h ∂(b δ̇)/∂φ, or zero without geometric stiffness.
    pub(super) swept: DVec3,
    /// dλ/dδ, N/m.
    pub(super) stiffness: f64,
    /// δ + d at the end of the step if the velocity does not change, m.
    pub(super) overlap: f64,
    /// λ at the end of the step if the velocity does not change, before the clamp, N.
    pub(super) force: f64,
    /// λ at the start, N.
    pub(super) force_at_start: f64,
    pub(super) friction: Option<FrictionTerm>,
}

/// Friction of a contact that pushes.
#[derive(Clone, Copy)]
pub(super) struct FrictionTerm {
    /// v_t at the start, m/s.
    slide: Strain,
    /// k ξ + b v_t at the end of the step if the velocity does not change, N.
    pub trial: Strain,
    /// s: share of the trial force that friction holds.
    pub share: f64,
    /// F_t at the start, N.
    pub force_at_start: DVec3,
}

impl FrictionTerm {
    /// Linearises friction. `force` is λ at the end of the step if the velocity does not change, `at_start` λ
    /// at the start, N.
    #[inline(always)]
    fn new(
        c: &PenaltyContact,
        at: &ContactState,
        state: &BodyState,
        [force, at_start]: [f64; 2],
        dt: f64,
    ) -> Self {
        // Anchors have already been moved to where they are at the end of the step.
        let FrictionForce { force: force_at_start, trial, slide, .. } =
            c.friction_force_before(dt, state, at, at_start);
        // The trial force at the end: k (ξ + h v_t) + b v_t.
        let trial = trial.plus(&slide.scaled(c.stiffness * dt));
        Self { slide, trial, share: c.friction.share(&trial, &slide, force.max(0.0)), force_at_start }
    }

    /// s after the strain rate has changed by `gained` (m/s), in a contact that pushes with `force` (N).
    #[inline(always)]
    pub fn share_after(&self, gained: &Strain, c: &PenaltyContact, force: f64, dt: f64) -> f64 {
        let trial = self.trial.plus(&gained.scaled(c.stiffness * dt + c.damping));
        c.friction.share(&trial, &self.slide.plus(gained), force)
    }
}

impl ActiveContact {
    #[inline(always)]
    pub(super) fn new(
        c: &PenaltyContact,
        at: &ContactState,
        state: &BodyState,
        dt: f64,
        geometric: bool,
    ) -> Self {
        let twist = &state.twist;
        let swept = if geometric { c.swept(at, twist.angular) * dt } else { DVec3::ZERO };
        // Planes have already been moved to where they are at the end of the step: at the start, δ is larger
        // by h n · v of the surface.
        let at = &ContactState { overlap: at.overlap + dt * at.direction.dot(c.surface.velocity), ..*at };
        // For an unchanged velocity, δ_n + d = δ_0 + d + h δ̇ and λ_n = k (δ_n + d) + b δ̇ + h ∂(b δ̇)/∂φ ·
        // ω.
        let overlap = at.overlap + dt * at.rate;
        let stiffness = c.stiffness_at(overlap).unwrap_or(c.stiffness);
        let force = stiffness * overlap + c.damping * at.rate + swept.dot(twist.angular);
        let force_at_start = c.normal_force(at);
        let rubs = c.friction.is_some() && (overlap > 0.0 || c.braking_time == 0.0);
        Self {
            arm: at.arm,
            direction: at.direction,
            moment: at.moment,
            swept,
            stiffness,
            overlap,
            force,
            force_at_start,
            friction: rubs.then(|| FrictionTerm::new(c, at, state, [force, c.gripping_force(at)], dt)),
        }
    }

    /// Change of δ̇ by a change of velocity, m/s.
    #[inline(always)]
    pub(super) fn rate_of(&self, change: &Twist) -> f64 {
        self.direction.dot(change.linear) + self.moment.dot(change.angular)
    }
}
