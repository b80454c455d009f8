//! Contacts as constraints: the body passes no surface, in place of springs that push it back (Ortega, Redon
//! and Coquillart 2007; Wang et al. 2013).
//!
//! A step of the body's velocity (v, ω) with matrix A and right-hand side as in
//! [`semi_implicit_step`](crate::semi_implicit_step), which hold mass, coupling and the springs of penalty
//! contacts, is solved under the conditions
//!
//! A Δ = b − Σ Jᵢᵀ pᵢ,   0 ≤ p_n ⊥ g/h − n · (v_p − v_s) + c p_n ≥ 0,   ‖p_t‖ ≤ μ p_n
//!
//! for each contact, with the impulses p = (p_n, p_t) of the body on the surface, the gap g at the start of
//! the step, the velocity v_p = v + ω × a of the contact's point and v_s of the surface. Friction opposes the
//! sliding velocity at the end of the step. An active set from the step before gives the normal impulses
//! exactly; friction is found by projection, in turn with them.
//!
//! # Overlap
//!
//! A contact that is found with an overlap (g < 0) asks for an outward velocity min(−g/T, r), with which the
//! overlap fades in about T = 5 ms. The recovery velocity r sets in for the deepest overlap, up to an r_max
//! that is not felt in the coupling's damper as a push:
//!
//! T ṙ = min(max(−g)/T, r_max) − r
//!
//! If it did not set in gradually, each overlap of a micrometre that is found would be felt as a jump in the
//! coupling's damper. Pushing a body out by the depth in one step, or by a spring, would give it energy that
//! the hand did not put in.
//!
//! Overlaps that cannot all be undone, as of a part that starts in a hole too narrow for it, are held as deep
//! as they are, without force between them (`overlaps`): the body is free along their surfaces.
//!
//! # Many contacts
//!
//! A step finds the impulses of at most [`MAX_CONSTRAINTS`] contacts: a working set. Contacts beside it that
//! the step would pass are exchanged for those that push least.
//!
//! # Bodies that are pushed
//!
//! A surface may belong to a body that contacts push and whose motion a host computes ([`PushedBody`]). Its
//! velocity v_s at the end of the step then depends on the impulses too, by its own mobility: the step finds
//! the motion of both.
//!
//! # Bound on motion
//!
//! Surfaces that are in no contact are known to be at least [`MotionBound::room`] away from where the body
//! was when contacts were found. No point of the body moves further than that from there: a step that would
//! is shortened, and the velocity with it, which only takes energy out. The body then waits for newer
//! contacts.

mod normals;
mod overlaps;
mod pushed;
mod response;
mod solver;
mod step;
#[cfg(test)]
mod tests;
mod working_set;

/// What the steps of all tools share.
pub(crate) mod tool {
    pub(crate) use super::pushed::Pushed;
    pub(crate) use super::solver::{Moved, Rows, SHALLOW, Solver, push_row, scaled};
    pub(crate) use super::step::{allowed, changed, mobility_factor, next_recovery, wrench};
    pub(crate) use super::working_set::{choose, share};
}

use glam::DVec3;
use palpate_core::{Pose, Twist};

pub use pushed::{HostState, PushedBody};
pub use step::{ConstrainedStep, Recovery, constrained_step};

/// Largest number of contacts whose impulses a step finds.
pub const MAX_CONSTRAINTS: usize = 64;

/// T: time in which the recovery velocity sets in and an overlap fades, s. With less, each overlap of a
/// micrometre that comes and goes is felt in the coupling's damper; with more, overlaps last.
const RECOVERY_TIME: f64 = 5e-3;

/// A contact that holds a point of the body on one side of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constraint {
    /// **a**: the point on the body, from the centre of mass, world axes, m.
    pub arm: DVec3,
    /// **n**: unit normal, out of the body, world axes.
    pub normal: DVec3,
    /// g: distance of the point from the surface at the start of the step, m; negative for an overlap.
    pub gap: f64,
    /// Velocity of the surface at the point, m/s.
    pub velocity: DVec3,
    /// Coulomb coefficient of friction μ.
    pub friction: f64,
    /// Impulse of the body on the surface in the last step, N·s, world axes: the start of the iteration, and
    /// its result.
    pub impulse: DVec3,
    /// Index of the body behind the surface among those that the step pushes; `None` for one that does not
    /// give way.
    pub pushed: Option<u8>,
    /// What the caller tells contacts apart by, since a step may change their order.
    pub key: u16,
}

impl Constraint {
    /// A contact at an arm (m), with a normal and a gap (m): without friction, with a surface that stands
    /// still, and that has not pushed yet.
    pub fn new(arm: DVec3, normal: DVec3, gap: f64) -> Self {
        let (velocity, impulse) = (DVec3::ZERO, DVec3::ZERO);
        Self { arm, normal, gap, velocity, friction: 0.0, impulse, pushed: None, key: 0 }
    }

    /// Approach of the surfaces, with a velocity of the body, beyond what a step of `dt` (s) allows, m/s; an
    /// overlap recovers with a velocity of at most `recovery` (m/s).
    #[inline(always)]
    fn excess(&self, twist: &Twist, dt: f64, recovery: f64) -> f64 {
        self.excess_of(self.velocity_over(twist), dt, recovery)
    }

    /// The same for a velocity over the surface, m/s.
    #[inline(always)]
    fn excess_of(&self, over: DVec3, dt: f64, recovery: f64) -> f64 {
        let gap = self.gap;
        let allowed = if gap < 0.0 { (gap / RECOVERY_TIME).max(-recovery) } else { gap / dt };
        self.normal.dot(over) - allowed
    }

    /// Velocity of the point over the surface, with a velocity of the body, m/s.
    #[inline(always)]
    fn velocity_over(&self, twist: &Twist) -> DVec3 {
        twist.velocity_at(self.arm) - self.velocity
    }
}

/// The region of known surfaces: a bound on the body's motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionBound {
    /// Pose of the body at which contacts were found.
    pub from: Pose,
    /// Largest displacement of any point of the body from there, m.
    pub room: f64,
    /// Largest displacement of any point of the body in one step, m.
    pub step: f64,
    /// Bounding radius of the body about its centre of mass, m.
    pub radius: f64,
}

impl MotionBound {
    /// No bound.
    pub const NONE: Self =
        Self { from: Pose::IDENTITY, room: f64::INFINITY, step: f64::INFINITY, radius: 0.0 };

    /// Bound on the displacement of any point of the body, m: |Δ**x**| + 2 r sin(θ/2).
    pub fn displacement(&self, pose: &Pose) -> f64 {
        // The vector part of a unit quaternion is as long as sin(θ/2).
        let turn = self.from.rotation.conjugate() * pose.rotation;
        let turn = DVec3::new(turn.x, turn.y, turn.z);
        self.from.translation.distance(pose.translation) + 2.0 * self.radius * turn.length()
    }
}
