//! Impulses with restitution and Coulomb friction at all contacts at once, without gain of energy.
//!
//! A contact's impulse p changes the relative velocity there by K p, with K = 1/m − r* I⁻¹ r* (Mirtich's
//! collision matrix). Each contact has a target velocity. The normal component must reach at least the
//! target, which restitution gives; the tangential components come as close to it as an impulse in the
//! friction cone permits. Impulses are found by iteration over the contacts (projected Gauss-Seidel on
//! accumulated impulses).
//!
//! Newton's restitution with friction, or at several contacts, can require more energy than there is (Kane
//! and Levinson 1985). So kinetic energy is compared before and after. Where it would rise, the impulses are
//! reduced along the straight line to those of a plastic impact, until energy is conserved. Both ends are in
//! the friction cones, and the cones are convex, so all points between are in them as well. Where contacts
//! face one another and no impulses reach all targets, the impact is plastic. Mirtich integrates compression
//! and restitution along the impulse for the same purpose, one contact at a time.
//!
//! Micro-collisions (Mirtich 1996): resting and sliding contact is a train of small collisions. An approach
//! too slow to leave the collision envelope has no restitution e. Its target velocity returns the contact to
//! its place by the next query: upwards half of what gravity adds until then, and likewise sideways. For a
//! resting body that is a restitution of 1 and reverses sliding as well, so that it neither sinks nor creeps;
//! faster approaches are damped to it at once.

use glam::{DMat2, DMat3, DVec2, DVec3};
use palpate_core::Twist;

use crate::body::{BodyState, RigidBody};

/// Maximum number of iterations over all contacts.
const MAX_ITERATIONS: usize = 200;

/// Change of velocities in an iteration, as a part of the largest velocity, at which impulses have converged.
const CONVERGENCE: f64 = 1e-11;

/// Approach speed that may remain after an impact, as a part of the largest velocity.
const MAX_REMAINING_APPROACH: f64 = 1e-6;

/// Relative rounding error of the kinetic energy.
const ENERGY_ROUNDING: f64 = 1e-12;

/// A contact that may take an impulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Position relative to the centre of mass, world axes, m.
    pub arm: DVec3,
    /// Unit normal towards the body, world axes.
    pub normal: DVec3,
    /// Target velocity of the body's point, m/s, world axes. The normal component is a lower bound;
    /// tangential components are approached as far as friction permits.
    pub target: DVec3,
    /// Result: impulse on the body, N·s, world axes.
    pub impulse: DVec3,
}

impl Touch {
    /// Returns a contact that only stops the approach of the body, and, as far as friction permits, its
    /// sliding.
    pub fn plastic(arm: DVec3, normal: DVec3) -> Self {
        Self { arm, normal, target: DVec3::ZERO, impulse: DVec3::ZERO }
    }
}

/// Impact law: restitution, friction and the rule for micro-collisions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Coefficient of restitution e, 0 to 1.
    pub restitution: f64,
    /// Coefficient of friction μ.
    pub friction: f64,
    /// Gravity, m/s², world axes.
    pub gravity: DVec3,
    /// Time until the next query, s.
    pub flight: f64,
    /// Approach speed up to which a contact is a micro-collision, m/s.
    pub micro: f64,
}

impl Law {
    /// Sets the target velocity of a contact of a body that moves with `twist`. Returns whether it is a
    /// collision, not a micro-collision.
    pub fn aim(&self, touch: &mut Touch, twist: &Twist) -> bool {
        let velocity = twist.velocity_at(touch.arm);
        let approach = -velocity.dot(touch.normal);
        let collides = approach > self.micro;
        touch.target = if collides {
            self.restitution * approach * touch.normal
        } else {
            let along = -self.gravity.dot(touch.normal);
            let back = (0.5 * along * self.flight).clamp(0.0, approach.max(0.0));
            let across = -0.5 * self.flight * (self.gravity + along * touch.normal);
            let sliding = (velocity + approach * touch.normal).length();
            back * touch.normal + across.clamp_length_max(sliding)
        };
        collides
    }
}

/// Inverse mass and inertia of a body.
#[derive(Clone, Copy, Debug)]
struct InverseMass {
    /// Inverse mass, 1/kg.
    linear: f64,
    /// Inverse inertia, world axes, 1/(kg·m²).
    angular: DMat3,
}

impl InverseMass {
    /// Applies an impulse to a velocity.
    fn apply(&self, twist: &mut Twist, arm: DVec3, impulse: DVec3) {
        twist.linear += self.linear * impulse;
        twist.angular += self.angular * arm.cross(impulse);
    }

    /// Returns K p: the change of velocity at the point where an impulse acts.
    fn response(&self, arm: DVec3, impulse: DVec3) -> DVec3 {
        self.linear * impulse + (self.angular * arm.cross(impulse)).cross(arm)
    }
}

/// Returns the velocity of a body after impulses at all contacts, and stores the impulses in the contacts.
/// They bring velocities to their targets within the friction cones, and do not raise the kinetic energy.
/// Contacts after the first [`MAX_CONTACTS`] take no impulse.
pub fn strike(body: &RigidBody, state: &BodyState, touches: &mut [Touch], friction: f64) -> Twist {
    let (touches, others) = touches.split_at_mut(touches.len().min(MAX_CONTACTS));
    others.iter_mut().for_each(|touch| touch.impulse = DVec3::ZERO);
    let energy = |twist: Twist| body.kinetic_energy(&BodyState { twist, ..*state });
    let before = energy(state.twist);
    // Try the wanted impulses first.
    let struck = solve(body, state, touches, friction);
    let separates = struck.is_finite() && are_separating(&state.twist, &struck, touches);
    if separates && energy(struck) <= before {
        return struck;
    }
    let mut wanted = [DVec3::ZERO; MAX_CONTACTS];
    for (wanted, touch) in wanted.iter_mut().zip(&mut *touches) {
        *wanted = touch.impulse;
        touch.target = DVec3::ZERO;
    }
    let plastic = solve(body, state, touches, friction);
    // From the plastic impact towards the wanted impulses; or, if that gains energy as well, from none
    // towards the plastic ones.
    let restores = energy(plastic) <= before;
    let (from, to) = if restores { (plastic, struck) } else { (state.twist, plastic) };
    let share = if restores && !separates { 0.0 } else { largest_share(energy, from, to, before) };
    let twist = between(from, to, share);
    if !twist.is_finite() || energy(twist) > before {
        touches.iter_mut().for_each(|touch| touch.impulse = DVec3::ZERO);
        return state.twist;
    }
    for (touch, wanted) in touches.iter_mut().zip(wanted) {
        let ends = if restores { [touch.impulse, wanted] } else { [DVec3::ZERO, touch.impulse] };
        touch.impulse = ends[0].lerp(ends[1], share);
    }
    if are_separating(&state.twist, &twist, touches) { twist } else { separate(body, state, twist, touches) }
}

/// Returns the velocity after additional impulses along normals, which stop any remaining approach: friction
/// at many contacts does not converge exactly. They are applied only if they take energy.
fn separate(body: &RigidBody, state: &BodyState, twist: Twist, touches: &mut [Touch]) -> Twist {
    let mut found = [DVec3::ZERO; MAX_CONTACTS];
    for (found, touch) in found.iter_mut().zip(&*touches) {
        *found = touch.impulse;
    }
    let separated = solve(body, &BodyState { twist, ..*state }, touches, 0.0);
    let energy = |twist: Twist| body.kinetic_energy(&BodyState { twist, ..*state });
    let takes = energy(separated) <= energy(twist);
    for (touch, found) in touches.iter_mut().zip(found) {
        touch.impulse = if takes { touch.impulse + found } else { found };
    }
    if takes { separated } else { twist }
}

/// Returns whether no contact approaches after an impact, to within a small part of the speeds before.
fn are_separating(before: &Twist, after: &Twist, touches: &[Touch]) -> bool {
    let speed = |touch: &Touch| before.velocity_at(touch.arm).length();
    let left = MAX_REMAINING_APPROACH * touches.iter().map(speed).fold(0.0, f64::max);
    touches.iter().all(|touch| after.velocity_at(touch.arm).dot(touch.normal) >= -left)
}

/// Maximum number of contacts of an impact.
pub const MAX_CONTACTS: usize = 32;

/// Returns the largest fraction of the line from one velocity to another at which kinetic energy does not
/// exceed `before`.
fn largest_share(energy: impl Fn(Twist) -> f64, from: Twist, to: Twist, before: f64) -> f64 {
    // The energy is quadratic, E(s) = c + b s + a s², and given by its values at 0, 1/2 and 1.
    let [start, middle, end] = [0.0, 0.5, 1.0].map(|share| energy(between(from, to, share)));
    let (a, b, c) = (2.0 * (start + end) - 4.0 * middle, 4.0 * middle - 3.0 * start - end, start - before);
    let room = (b * b - 4.0 * a * c).max(0.0).sqrt();
    let root = if b > 0.0 { -2.0 * c / (b + room) } else { (room - b) / (2.0 * a) };
    let share = if root.is_finite() { root.clamp(0.0, 1.0) } else { 0.0 };
    // Slightly less, because of rounding.
    share * (1.0 - ENERGY_ROUNDING.sqrt())
}

/// Interpolates linearly between two velocities.
fn between(from: Twist, to: Twist, share: f64) -> Twist {
    Twist { linear: from.linear.lerp(to.linear, share), angular: from.angular.lerp(to.angular, share) }
}

/// Returns the velocity after impulses that bring contacts to their targets, as far as pushing impulses
/// within the friction cones can. Projected Gauss-Seidel.
pub(crate) fn solve(body: &RigidBody, state: &BodyState, touches: &mut [Touch], friction: f64) -> Twist {
    let inverse_mass = InverseMass { linear: 1.0 / body.mass(), angular: body.inverse_inertia(state) };
    let mut twist = state.twist;
    touches.iter_mut().for_each(|touch| touch.impulse = DVec3::ZERO);
    let speed = |touch: &Touch| {
        twist.velocity_at(touch.arm).abs().max_element().max(touch.target.abs().max_element())
    };
    let converged = CONVERGENCE * touches.iter().map(speed).fold(0.0, f64::max);
    for _ in 0..MAX_ITERATIONS {
        let mut changed = 0.0f64;
        for touch in &mut *touches {
            let Touch { arm, normal, target, impulse } = *touch;
            let (x, y) = normal.any_orthonormal_pair();
            let responses = [normal, x, y].map(|axis| inverse_mass.response(arm, axis));
            // Along the normal: p_n ← max(0, p_n + (v* − v)_n / K_nn).
            let mut push = impulse.dot(normal);
            let lack = (target - twist.velocity_at(arm)).dot(normal);
            let along = (push + lack / responses[0].dot(normal)).max(0.0);
            inverse_mass.apply(&mut twist, arm, (along - push) * normal);
            changed = changed.max((along - push).abs() * responses[0].dot(normal));
            push = along;
            // Tangentially, a gradient step 1/λ with the largest eigenvalue λ of K, which cannot overshoot,
            // and projection onto the friction cone: p_t ← clamp(p_t + (v* − v)_t / λ, μ p_n).
            let across = DMat2::from_cols(
                DVec2::new(responses[1].dot(x), responses[1].dot(y)),
                DVec2::new(responses[2].dot(x), responses[2].dot(y)),
            );
            let lack = target - twist.velocity_at(arm);
            let held = DVec2::new(impulse.dot(x), impulse.dot(y));
            let largest = largest_eigenvalue(&across);
            let friction_impulse =
                (held + DVec2::new(lack.dot(x), lack.dot(y)) / largest).clamp_length_max(friction * push);
            let more = friction_impulse - held;
            inverse_mass.apply(&mut twist, arm, more.x * x + more.y * y);
            changed = changed.max(more.length() * largest);
            touch.impulse = push * normal + friction_impulse.x * x + friction_impulse.y * y;
        }
        if changed <= converged {
            break;
        }
    }
    twist
}

/// Returns the largest eigenvalue of a symmetric matrix.
fn largest_eigenvalue(matrix: &DMat2) -> f64 {
    let (mean, half) = (0.5 * (matrix.x_axis.x + matrix.y_axis.y), 0.5 * (matrix.x_axis.x - matrix.y_axis.y));
    mean + half.hypot(matrix.x_axis.y)
}

#[cfg(test)]
mod tests;
