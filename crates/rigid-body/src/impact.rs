//! Impulses at contacts: restitution and Coulomb friction, at all contacts at once, without gain of energy.
//!
//! A contact's impulse p changes the relative velocity there by K p, with K = 1/m − r* I⁻¹ r* (Mirtich's collision matrix). For
//! each contact a velocity is sought: along the normal at least the one that restitution asks for, across it one that friction
//! would leave, as far as the impulse stays in the friction cone. Impulses are found contact by contact, over and over
//! (projected Gauss-Seidel on accumulated impulses).
//!
//! Newton's restitution, with friction or at several contacts, can ask for more energy than there is (Kane and Levinson
//! 1985). So kinetic energy is compared before and after: where it would rise, the impulse gives way, along the
//! straight line to that of a plastic impact, to where energy stays the same. Both are in the friction cones, and with them
//! all between. Where contacts face one another so that no impulse can give them all what they ask for, the impact is plastic. Mirtich integrates compression and restitution along the impulse for the same end, one contact at a time.
//!
//! Micro-collisions (Mirtich 1996): resting and sliding contact is a train of small collisions. An approach too slow to
//! leave the collision envelope is not given e, but what brings the contact back to where it was by the next query: upwards by half
//! of what gravity adds till then, and across likewise. In a resting body that is a restitution of 1 and reverses sliding as well,
//! so that it neither sinks nor creeps; faster approaches are damped to it at once.

use glam::{DMat2, DMat3, DVec2, DVec3};
use palpate_core::Twist;

use crate::body::{BodyState, RigidBody};

/// Most rounds over all contacts.
const ROUNDS: usize = 200;

/// Impulses are found when none changes velocities by more than this part of the largest velocity.
const PRECISION: f64 = 1e-11;

/// Approach that an impact may leave, as part of the largest velocity.
const LEFT: f64 = 1e-6;

/// Part of the kinetic energy that rounding may bring about.
const ROUNDING: f64 = 1e-12;

/// A contact that may take an impulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// From the centre of mass, world axes, m.
    pub arm: DVec3,
    /// Unit normal that points to the body, world axes.
    pub normal: DVec3,
    /// Velocity of the body's point that is sought: at least its component along the normal, and across as near as friction
    /// brings it, m/s, world axes.
    pub target: DVec3,
    /// Found: the impulse on the body, N·s, world axes.
    pub impulse: DVec3,
}

impl Touch {
    /// A contact that only keeps the body from coming closer, and, as far as friction goes, from sliding.
    pub fn plastic(arm: DVec3, normal: DVec3) -> Self {
        Self { arm, normal, target: DVec3::ZERO, impulse: DVec3::ZERO }
    }
}

/// What an impact asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// e, 0 to 1.
    pub restitution: f64,
    /// μ.
    pub friction: f64,
    /// m/s², world axes.
    pub gravity: DVec3,
    /// Till the next query, s.
    pub flight: f64,
    /// Approaches slower than this are micro-collisions, m/s.
    pub micro: f64,
}

impl Law {
    /// Sets the target of a contact of a body with a velocity; then whether it is a collision, no micro-collision.
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

/// How a body resists impulses.
#[derive(Clone, Copy, Debug)]
struct Mobility {
    /// 1/kg.
    linear: f64,
    /// World axes, 1/(kg·m²).
    angular: DMat3,
}

impl Mobility {
    fn kick(&self, twist: &mut Twist, arm: DVec3, impulse: DVec3) {
        twist.linear += self.linear * impulse;
        twist.angular += self.angular * arm.cross(impulse);
    }

    /// K p: what an impulse changes of the velocity where it acts.
    fn response(&self, arm: DVec3, impulse: DVec3) -> DVec3 {
        self.linear * impulse + (self.angular * arm.cross(impulse)).cross(arm)
    }
}

/// The velocity of a body after impulses at all contacts, which are left in them: towards their targets, within the friction
/// cones, and with no more kinetic energy than before. Contacts beyond the first [`MOST`] take none.
pub fn strike(body: &RigidBody, state: &BodyState, touches: &mut [Touch], friction: f64) -> Twist {
    let (touches, others) = touches.split_at_mut(touches.len().min(MOST));
    others.iter_mut().for_each(|touch| touch.impulse = DVec3::ZERO);
    let energy = |twist: Twist| body.kinetic_energy(&BodyState { twist, ..*state });
    let before = energy(state.twist);
    let struck = solve(body, state, touches, friction);
    let parts_again = struck.is_finite() && parts(&state.twist, &struck, touches);
    if parts_again && energy(struck) <= before {
        return struck;
    }
    let mut wanted = [DVec3::ZERO; MOST];
    for (wanted, touch) in wanted.iter_mut().zip(&mut *touches) {
        *wanted = touch.impulse;
        touch.target = DVec3::ZERO;
    }
    let plastic = solve(body, state, touches, friction);
    // From the plastic impact on towards what was wanted; or, should that gain energy as well, towards it from no impulse.
    let restores = energy(plastic) <= before;
    let (from, to) = if restores { (plastic, struck) } else { (state.twist, plastic) };
    let share = if restores && !parts_again { 0.0 } else { most_share(energy, from, to, before) };
    let twist = between(from, to, share);
    if !twist.is_finite() || energy(twist) > before {
        touches.iter_mut().for_each(|touch| touch.impulse = DVec3::ZERO);
        return state.twist;
    }
    for (touch, wanted) in touches.iter_mut().zip(wanted) {
        let ends = if restores { [touch.impulse, wanted] } else { [DVec3::ZERO, touch.impulse] };
        touch.impulse = ends[0].lerp(ends[1], share);
    }
    if parts(&state.twist, &twist, touches) { twist } else { part(body, state, twist, touches) }
}

/// The velocity after impulses along normals, on top of those found, that keep the contacts from coming closer: where friction
/// at many contacts is not found exactly. They only take energy.
fn part(body: &RigidBody, state: &BodyState, twist: Twist, touches: &mut [Touch]) -> Twist {
    let mut found = [DVec3::ZERO; MOST];
    for (found, touch) in found.iter_mut().zip(&*touches) {
        *found = touch.impulse;
    }
    let parted = solve(body, &BodyState { twist, ..*state }, touches, 0.0);
    let energy = |twist: Twist| body.kinetic_energy(&BodyState { twist, ..*state });
    let takes = energy(parted) <= energy(twist);
    for (touch, found) in touches.iter_mut().zip(found) {
        touch.impulse = if takes { touch.impulse + found } else { found };
    }
    if takes { parted } else { twist }
}

/// Whether contacts do not approach after an impact, but for a small part of how fast they were before.
fn parts(before: &Twist, after: &Twist, touches: &[Touch]) -> bool {
    let speed = |touch: &Touch| before.velocity_at(touch.arm).length();
    let left = LEFT * touches.iter().map(speed).fold(0.0, f64::max);
    touches.iter().all(|touch| after.velocity_at(touch.arm).dot(touch.normal) >= -left)
}

/// Most contacts at once.
pub const MOST: usize = 32;

/// The largest part of the way from one velocity to another at which kinetic energy is no more than before.
fn most_share(energy: impl Fn(Twist) -> f64, from: Twist, to: Twist, before: f64) -> f64 {
    // E(s) = c + b s + a s², told by its values at 0, 1/2 and 1.
    let [start, middle, end] = [0.0, 0.5, 1.0].map(|share| energy(between(from, to, share)));
    let (a, b, c) = (2.0 * (start + end) - 4.0 * middle, 4.0 * middle - 3.0 * start - end, start - before);
    let room = (b * b - 4.0 * a * c).max(0.0).sqrt();
    let root = if b > 0.0 { -2.0 * c / (b + room) } else { (room - b) / (2.0 * a) };
    let share = if root.is_finite() { root.clamp(0.0, 1.0) } else { 0.0 };
    // A little less, for rounding.
    share * (1.0 - ROUNDING.sqrt())
}

fn between(from: Twist, to: Twist, share: f64) -> Twist {
    Twist { linear: from.linear.lerp(to.linear, share), angular: from.angular.lerp(to.angular, share) }
}

/// The velocity after impulses that bring contacts to their targets, as far as impulses that only push, within the friction
/// cones, can.
pub(crate) fn solve(body: &RigidBody, state: &BodyState, touches: &mut [Touch], friction: f64) -> Twist {
    let mobility = Mobility { linear: 1.0 / body.mass(), angular: body.inverse_inertia(state) };
    let mut twist = state.twist;
    touches.iter_mut().for_each(|touch| touch.impulse = DVec3::ZERO);
    let speed = |touch: &Touch| {
        twist.velocity_at(touch.arm).abs().max_element().max(touch.target.abs().max_element())
    };
    let precise = PRECISION * touches.iter().map(speed).fold(0.0, f64::max);
    for _ in 0..ROUNDS {
        let mut changed = 0.0f64;
        for touch in &mut *touches {
            let Touch { arm, normal, target, impulse } = *touch;
            let (x, y) = normal.any_orthonormal_pair();
            let responses = [normal, x, y].map(|axis| mobility.response(arm, axis));
            let mut push = impulse.dot(normal);
            let lack = (target - twist.velocity_at(arm)).dot(normal);
            let along = (push + lack / responses[0].dot(normal)).max(0.0);
            mobility.kick(&mut twist, arm, (along - push) * normal);
            changed = changed.max((along - push).abs() * responses[0].dot(normal));
            push = along;
            // Across, by the steepest descent that cannot overshoot: the largest eigenvalue of K there bounds it.
            let across = DMat2::from_cols(
                DVec2::new(responses[1].dot(x), responses[1].dot(y)),
                DVec2::new(responses[2].dot(x), responses[2].dot(y)),
            );
            let lack = target - twist.velocity_at(arm);
            let held = DVec2::new(impulse.dot(x), impulse.dot(y));
            let largest = largest_eigenvalue(&across);
            let rubbed =
                (held + DVec2::new(lack.dot(x), lack.dot(y)) / largest).clamp_length_max(friction * push);
            let more = rubbed - held;
            mobility.kick(&mut twist, arm, more.x * x + more.y * y);
            changed = changed.max(more.length() * largest);
            touch.impulse = push * normal + rubbed.x * x + rubbed.y * y;
        }
        if changed <= precise {
            break;
        }
    }
    twist
}

/// Of a symmetric matrix.
fn largest_eigenvalue(matrix: &DMat2) -> f64 {
    let (mean, half) = (0.5 * (matrix.x_axis.x + matrix.y_axis.y), 0.5 * (matrix.x_axis.x - matrix.y_axis.y));
    mean + half.hypot(matrix.x_axis.y)
}

#[cfg(test)]
mod tests;
