//! Penalty contacts as plane constraints, in the form the contact thread hands to the haptic thread (§5.2.4,
//! §5.4.3).
//!
//! Each contact is the plane through p₀ with normal n, fixed in the world, against the point r of the body.
//! With a = R r, δ = n · (x + a − p₀) and δ̇ = n · (v + ω × a), the contact pushes the body along −n with
//!
//! λ = k (δ + d) + b δ̇ while both δ + d > 0 and λ > 0, else 0;  F_p = −λ n,  T_p = a × F_p.
//!
//! Departures from Eq. 5.37–5.38: the lever arm of the damper is in world axes, and contact is unilateral: no
//! force while δ + d ≤ 0, and the damper never makes it attract. The model keeps the constraints, not their
//! Taylor expansion (Eq. 5.14), so force, clamp and derivatives are those of the body's present placement
//! however far it has moved.
//!
//! A constraint may also brake before it is closed: with a time τ, and δ + d < 0,
//!
//! λ = b (δ̇ + (δ + d) / τ) while that is positive,
//!
//! so that the gap that is left is not closed faster than in about τ, which goes over to the law above where it closes.
//! It takes energy only. A body that comes fast is slowed before there is a force that could be felt of a slow one, and is
//! not behind a thin wall before the next contacts are found (§5.6.1).
//!
//! The scene may move: a contact knows the [motion of the surface](Surface) that it is with. The velocities that dampers and
//! friction act on are relative to that, and a step finds the planes and the points where friction holds where they are at
//! its end ([`LinearContactModel::advance`]).
//!
//! Where the surfaces have friction, the point is also held along the plane, by a spring and damper of the same
//! gains that yield at the Coulomb limit ([`friction`](crate::friction)).
//!
//! A contact between detailed surfaces is more than a plane: [`CurvedContact`], whose [bends](crate::bend) let the plane turn
//! as the body moves on.
//!
//! The stiffness that the body feels is at most the number of contacts times k, and that number is at most
//! [`MAX_CLUSTERS`]: this is what the clustering of §5.4.2 is for. While one model [goes
//! over](crate::ContactBlend) to the next, the two share it.

use std::num::NonZeroU32;

use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Contact, Pose, Twist, Wrench};

use crate::bend::{Bend, CurvedContact, MAX_BENDS};
use crate::body::BodyState;
use crate::friction::{Friction, Grip, Hold};
use crate::jacobian::{Block6, WrenchJacobian};
use crate::rotation::{skew, skew_skew};

/// The most contacts that a model is made of: the upper bound on the number of clusters K (§5.4.2).
pub const MAX_CLUSTERS: usize = 16;

/// The most approaching contacts that a model is told of besides.
pub const MAX_APPROACHING: usize = 4;

/// The most constraints that a model holds: those of one that comes and of one that goes.
pub const MAX_CONSTRAINTS: usize = 2 * (MAX_CLUSTERS + MAX_APPROACHING);

/// Penalty gains, the same for every contact (§5.4.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactParameters {
    /// k, N/m.
    pub stiffness: f64,
    /// b, N·s/m.
    pub damping: f64,
    /// d, the distance at which contact force begins, m.
    pub tolerance: f64,
    /// Between the surfaces.
    pub friction: Friction,
}

/// The scene's side of a contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Velocity of the surface at the contact's point, m/s, world axes.
    pub velocity: DVec3,
    /// Angular velocity of the object that it belongs to, rad/s, world axes.
    pub angular: DVec3,
    /// Which object that is, for those that are to be [pushed back](LinearContactModel::reactions).
    pub object: Option<NonZeroU32>,
}

impl Surface {
    /// One that stands still, and is pushed back by nothing.
    pub const STILL: Self = Self { velocity: DVec3::ZERO, angular: DVec3::ZERO, object: None };

    fn moves(&self) -> bool {
        self.velocity != DVec3::ZERO || self.angular != DVec3::ZERO
    }
}

impl Default for Surface {
    fn default() -> Self {
        Self::STILL
    }
}

/// An object of the scene, as contacts need to know of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carrier {
    /// Its motion; the velocity is that of its point at the world's origin.
    pub twist: Twist,
    /// Which it is, if it is to be [pushed back](LinearContactModel::reactions).
    pub object: Option<NonZeroU32>,
}

impl Carrier {
    /// Stands still, and is pushed back by nothing.
    pub const STILL: Self = Self { twist: Twist::ZERO, object: None };

    /// Its surface at a point of the world (m).
    fn surface_at(&self, point: DVec3) -> Surface {
        let Self { twist, object } = *self;
        Surface { velocity: twist.velocity_at(point), angular: twist.angular, object }
    }
}

/// A contact with the size of what it stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactPatch {
    /// The contact, in world axes.
    pub contact: Contact,
    /// Root mean square distance of the contacts that it stands for from its point, m: 0 for a single one.
    pub radius: f64,
}

impl From<Contact> for ContactPatch {
    fn from(contact: Contact) -> Self {
        Self { contact, radius: 0.0 }
    }
}

/// One contact: a point of the body held on one side of a plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlaneConstraint {
    /// **r**: the body's point, from the centre of mass, in body axes, m.
    pub point: DVec3,
    /// **p₀**: a point of the plane, world axes, m.
    pub scene_point: DVec3,
    /// **n**: the plane's unit normal, out of the body, world axes.
    pub normal: DVec3,
    /// k, N/m.
    pub stiffness: f64,
    /// b, N·s/m.
    pub damping: f64,
    /// d, m.
    pub tolerance: f64,
    /// τ, s: how long before it would close the constraint starts to brake; 0 for not before.
    pub braking_time: f64,
    /// Between the surfaces.
    pub friction: Friction,
    /// Radius of the patch that the contact stands for, m.
    pub radius: f64,
    /// Where friction holds the point.
    pub grip: Grip,
    /// What it is with.
    pub surface: Surface,
}

/// A constraint seen from one state of the body.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ContactState {
    /// a = R r.
    pub arm: DVec3,
    /// ∂δ/∂x and ∂δ/∂φ, the direction of the contact's wrench: n and a × n, but for bends.
    pub direction: DVec3,
    pub moment: DVec3,
    /// v + ω × a, of the point, less the surface's velocity, m/s.
    pub velocity: DVec3,
    /// δ + d.
    pub overlap: f64,
    /// δ̇.
    pub rate: f64,
}

/// What a constraint's wrench on the body is made of.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Push {
    /// λ, N.
    pub normal: f64,
    pub hold: Hold,
}

impl PlaneConstraint {
    /// Pushes nothing.
    const NONE: Self = Self {
        point: DVec3::ZERO,
        scene_point: DVec3::ZERO,
        normal: DVec3::ZERO,
        stiffness: 0.0,
        damping: 0.0,
        tolerance: 0.0,
        braking_time: 0.0,
        friction: Friction::NONE,
        radius: 0.0,
        grip: Grip { anchor: DVec3::ZERO, rotation: DQuat::IDENTITY },
        surface: Surface::STILL,
    };

    /// The plane of a contact found while the body was at a pose; `None` if that is not finite or has no normal.
    fn found(patch: &ContactPatch, pose: &Pose, parameters: &ContactParameters) -> Option<Self> {
        let ContactPatch { contact, radius } = *patch;
        let length = contact.normal.length();
        let usable = contact.point.is_finite()
            && (contact.depth + radius).is_finite()
            && length.is_finite()
            && length > 0.0;
        let normal = contact.normal / length;
        usable.then(|| Self {
            point: pose.rotation.conjugate() * (contact.point - pose.translation),
            scene_point: contact.point - normal * contact.depth,
            normal,
            stiffness: parameters.stiffness,
            damping: parameters.damping,
            tolerance: parameters.tolerance,
            braking_time: 0.0,
            friction: parameters.friction,
            radius,
            grip: Grip { anchor: contact.point, rotation: pose.rotation },
            surface: Surface::STILL,
        })
    }

    // What a step does at each contact is inlined: results that go through memory cost more than the arithmetic.

    #[inline(always)]
    pub(crate) fn at(&self, state: &BodyState, rotation: &DMat3) -> ContactState {
        let arm = *rotation * self.point;
        let moment = arm.cross(self.normal);
        let depth = self.normal.dot(state.pose.translation + arm - self.scene_point);
        let velocity = state.twist.velocity_at(arm) - self.surface.velocity;
        let rate = self.normal.dot(velocity);
        let overlap = depth + self.tolerance;
        ContactState { arm, direction: self.normal, moment, velocity, overlap, rate }
    }

    /// What the constraint does at a state.
    #[inline(always)]
    fn push(&self, state: &BodyState, at: &ContactState) -> Push {
        let normal = self.normal_force(at);
        let grips = normal > 0.0 && at.overlap > 0.0 && self.friction.is_some();
        let hold = if grips { self.hold(state, at, normal) } else { Hold::default() };
        Push { normal, hold }
    }

    /// The wrench on the body, about its centre of mass.
    #[inline(always)]
    fn wrench(&self, at: &ContactState, Push { normal, hold }: &Push) -> Wrench {
        let torque = at.arm.cross(hold.force) + self.normal * hold.moment;
        Wrench { force: hold.force - at.direction * *normal, torque: torque - at.moment * *normal }
    }

    /// λ at a state: the size of the repulsive force, N, never negative.
    pub(crate) fn normal_force(&self, at: &ContactState) -> f64 {
        let stiffness = self.stiffness_at(at.overlap);
        stiffness.map_or(0.0, |stiffness| (stiffness * at.overlap + self.damping * at.rate).max(0.0))
    }

    /// By what λ grows with δ, N/m, given δ + d; none where the constraint does nothing.
    pub(crate) fn stiffness_at(&self, overlap: f64) -> Option<f64> {
        if overlap > 0.0 {
            Some(self.stiffness)
        } else {
            (self.braking_time > 0.0).then(|| self.damping / self.braking_time)
        }
    }

    /// λ as far as there is friction with it: that of a closed contact, N.
    pub(crate) fn gripping_force(&self, at: &ContactState) -> f64 {
        if at.overlap > 0.0 { self.normal_force(at) } else { 0.0 }
    }
}

/// The wrench of the contacts at one state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactResponse {
    /// Sum of F_p and T_p on the body, about its centre of mass.
    pub wrench: Wrench,
    /// Derivatives of the wrench; contacts that push with no force add nothing.
    pub jacobian: WrenchJacobian,
    /// Bit i is set if contact i pushes.
    pub active: u64,
}

/// The latest contacts, from which the haptic thread evaluates force and derivatives on its own: fixed size,
/// `Copy`, nothing on the heap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearContactModel {
    constraints: [PlaneConstraint; MAX_CONSTRAINTS],
    count: usize,
    bends: [Bend; MAX_BENDS],
    bend_count: usize,
    overflow: u32,
    refused: u32,
    pose: Pose,
    time: f64,
    /// Whether a surface moves, or is to be pushed back.
    moves: bool,
    reacts: bool,
    /// How long surfaces have moved on, s.
    advanced: f64,
}

impl LinearContactModel {
    /// No contact, as of `time` (s).
    pub const fn empty(pose: &Pose, time: f64) -> Self {
        Self {
            constraints: [PlaneConstraint::NONE; MAX_CONSTRAINTS],
            count: 0,
            bends: [Bend::NONE; MAX_BENDS],
            bend_count: 0,
            overflow: 0,
            refused: 0,
            pose: *pose,
            time,
            moves: false,
            reacts: false,
            advanced: 0.0,
        }
    }

    /// The force that this has on a body in a state, whatever the body does afterwards: what a contact thread hands over that
    /// gives no Jacobian (§5.1.2), to compare with. Without friction, bends and braking.
    ///
    /// It is made of springs so soft and so far compressed that no motion changes their force.
    #[must_use]
    pub fn frozen(&self, state: &BodyState) -> Self {
        const SOFT: f64 = 1e-6;
        let mut frozen = Self::empty(&state.pose, self.time());
        let rotation = DMat3::from_quat(state.pose.rotation);
        for constraint in self.constraints() {
            let arm = rotation * constraint.point;
            let scene_point = state.pose.translation + arm;
            let depth = (scene_point - constraint.scene_point).dot(constraint.normal);
            let rate = (state.twist.velocity_at(arm) - constraint.surface.velocity).dot(constraint.normal);
            let overlap = depth + constraint.tolerance;
            let force = constraint.stiffness * overlap + constraint.damping * rate;
            if overlap > 0.0 && force > 0.0 {
                let tolerance = force / SOFT;
                frozen.push(PlaneConstraint {
                    stiffness: SOFT,
                    damping: 0.0,
                    tolerance,
                    scene_point,
                    surface: Surface { object: constraint.surface.object, ..Surface::STILL },
                    ..*constraint
                });
            }
        }
        frozen
    }

    /// The model of `contacts` found while the body was at `pose`, stamped with `time` (s, the caller's
    /// clock).
    ///
    /// At that pose each contact pushes with k (δ + d) exactly, δ being the depth it came with: the plane is
    /// put at p − δ n (Eq. 5.36) even where the contact's own p₀ differs. Beyond [`MAX_CLUSTERS`] the
    /// shallowest are left out ([`Self::overflow`]); a contact that is not finite or has no normal is refused
    /// ([`Self::refused`]).
    pub fn from_contacts(
        contacts: impl IntoIterator<Item = impl Into<ContactPatch>>,
        pose: &Pose,
        parameters: &ContactParameters,
        time: f64,
    ) -> Self {
        let mut model = Self::empty(pose, time);
        let mut depths = [0.0; MAX_CLUSTERS];
        for patch in contacts {
            let patch = patch.into();
            let Some(constraint) = PlaneConstraint::found(&patch, pose, parameters) else {
                model.refused += 1;
                continue;
            };
            let depth = patch.contact.depth;
            let slot = if model.count < MAX_CLUSTERS {
                model.count += 1;
                model.count - 1
            } else {
                model.overflow += 1;
                let shallowest = (1..MAX_CLUSTERS).fold(0, |s, i| if depths[i] < depths[s] { i } else { s });
                if depth <= depths[shallowest] {
                    continue;
                }
                shallowest
            };
            depths[slot] = depth;
            model.constraints[slot] = constraint;
        }
        model
    }

    /// Adds a contact with an object that may move, found at the pose of the others. With a time (s) it brakes the body from so long
    /// before it would close. Left out where the model has [`MAX_CLUSTERS`] already, or with a time [`MAX_APPROACHING`] more
    /// ([`Self::overflow`]); refused if it is not finite or has no normal.
    pub fn push_carried(
        &mut self,
        contact: impl Into<ContactPatch>,
        parameters: &ContactParameters,
        braking_time: f64,
        carrier: &Carrier,
    ) {
        let Some(constraint) = PlaneConstraint::found(&contact.into(), &self.pose, parameters) else {
            self.refused += 1;
            return;
        };
        let most = MAX_CLUSTERS + if braking_time > 0.0 { MAX_APPROACHING } else { 0 };
        if self.count >= most {
            self.overflow += 1;
            return;
        }
        let surface = carrier.surface_at(constraint.scene_point);
        self.push(PlaneConstraint { braking_time, surface, ..constraint });
    }

    /// Adds contacts further apart than d that are to brake the body from `time` (s) before they would close. Beyond
    /// [`MAX_APPROACHING`] the rest are left out.
    pub fn push_approaching(
        &mut self,
        contacts: impl IntoIterator<Item = Contact>,
        parameters: &ContactParameters,
        time: f64,
    ) {
        for contact in contacts.into_iter().take(MAX_APPROACHING) {
            match PlaneConstraint::found(&contact.into(), &self.pose, parameters) {
                Some(constraint) => {
                    self.push(PlaneConstraint { braking_time: time, ..constraint });
                }
                None => self.refused += 1,
            }
        }
    }

    /// Adds a contact, found while the body was at a pose, with how its depth changes as the body moves; gains are those of
    /// a plane along the depth's gradient (Eqs. 5.51–5.56). It brakes the body from `braking_time` (s) before it would close.
    /// How the scene's object moves counts for the plane, not for its bends.
    /// Left out where the model has [`MAX_CLUSTERS`] already, refused where it is not finite or has no gradient.
    pub fn push_curved(
        &mut self,
        contact: &CurvedContact,
        found_at: &Pose,
        parameters: &ContactParameters,
        braking_time: f64,
        carrier: &Carrier,
    ) {
        let Some((constraint, bends)) = contact.constraint(found_at, parameters) else {
            self.refused += 1;
            return;
        };
        if self.count >= MAX_CLUSTERS {
            self.overflow += 1;
            return;
        }
        let surface = carrier.surface_at(constraint.scene_point);
        self.push(PlaneConstraint { braking_time, surface, ..constraint });
        for bend in bends {
            self.push_bend(&bend);
        }
    }

    /// Adds a bend of the last constraint; where there is no room for it, the depth is a little straighter.
    fn push_bend(&mut self, bend: &Bend) {
        if self.bend_count < MAX_BENDS {
            self.bends[self.bend_count] = bend.of(self.count - 1);
            self.bend_count += 1;
        }
    }

    /// Adds a constraint; `false` if the model is full, which then stays as it was.
    pub fn push(&mut self, constraint: PlaneConstraint) -> bool {
        if self.count == MAX_CONSTRAINTS {
            self.overflow += 1;
            return false;
        }
        self.constraints[self.count] = constraint;
        self.count += 1;
        self.moves |= constraint.surface.moves();
        self.reacts |= constraint.surface.object.is_some();
        true
    }

    /// The bends of all constraints.
    pub(crate) fn bends(&self) -> &[Bend] {
        &self.bends[..self.bend_count]
    }

    /// The constraints.
    pub fn constraints(&self) -> &[PlaneConstraint] {
        &self.constraints[..self.count]
    }

    /// Takes all of another model, at the cost of what that holds.
    pub(crate) fn assign(&mut self, other: &Self) {
        let Self { constraints, count, bends, bend_count, overflow, refused, pose, time, .. } = other;
        self.constraints[..*count].copy_from_slice(&constraints[..*count]);
        self.count = *count;
        self.bends[..*bend_count].copy_from_slice(&bends[..*bend_count]);
        self.bend_count = *bend_count;
        (self.overflow, self.refused) = (*overflow, *refused);
        (self.pose, self.time) = (*pose, *time);
        (self.moves, self.reacts, self.advanced) = (other.moves, other.reacts, other.advanced);
    }

    /// Lets the surfaces move on for a time (s): the planes, and the points where friction holds. A step of `dt` finds them
    /// where they are at its end. They move for [`Self::LONGEST_MOTION`] at most, and then stand still: where no newer model
    /// arrives, nobody knows where they are.
    pub fn advance(&mut self, dt: f64) {
        if !(self.moves && dt > 0.0) {
            return;
        }
        let dt = dt.min(Self::LONGEST_MOTION - self.advanced);
        self.advanced += dt;
        let ends = self.advanced >= Self::LONGEST_MOTION;
        for constraint in self.constraints_mut() {
            let Surface { velocity, angular, .. } = constraint.surface;
            constraint.scene_point += velocity * dt;
            constraint.grip.anchor += velocity * dt;
            if constraint.radius > 0.0 && angular != DVec3::ZERO {
                let turn = DQuat::from_scaled_axis(angular * dt);
                constraint.grip.rotation = (turn * constraint.grip.rotation).normalize();
            }
            if ends {
                constraint.surface = Surface { object: constraint.surface.object, ..Surface::STILL };
            }
        }
        self.moves &= !ends;
    }

    /// The longest that surfaces move on from where they were found, s.
    pub const LONGEST_MOTION: f64 = 0.05;

    /// Whether some contacts are with objects that are to be pushed back.
    pub fn reacts(&self) -> bool {
        self.reacts
    }

    /// The wrenches **on the scene's objects** that are to be pushed back, one for each contact, about the world's origin,
    /// with the body at a state. They and those of the contacts with others, which are not told, add up to the reverse of
    /// [`wrench`](Self::wrench).
    pub fn reactions(&self, state: &BodyState) -> impl Iterator<Item = (NonZeroU32, Wrench)> {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let state = *state;
        self.constraints().iter().enumerate().filter(|_| self.reacts).filter_map(move |(i, c)| {
            let object = c.surface.object?;
            let at = self.at(i, &state, &rotation);
            let push = c.push(&state, &at);
            (push.normal > 0.0).then(|| {
                let on_body = c.wrench(&at, &push).about(-state.pose.translation);
                (object, Wrench { force: -on_body.force, torque: -on_body.torque })
            })
        })
    }

    /// Scales the gains of all constraints but the first ones.
    pub(crate) fn scale_from(&mut self, first: usize, share: f64) {
        for constraint in &mut self.constraints_mut()[first..] {
            constraint.stiffness *= share;
            constraint.damping *= share;
        }
    }

    /// Adds those of another model's constraints, with their bends, whose bits are set.
    pub(crate) fn extend(&mut self, other: &Self, chosen: u64) {
        for (i, constraint) in other.constraints().iter().enumerate() {
            if chosen & (1 << i) == 0 || !self.push(*constraint) {
                continue;
            }
            for bend in other.bends().iter().filter(|bend| bend.constraint == i) {
                self.push_bend(bend);
            }
        }
    }

    /// A constraint, by its place, seen from a state.
    #[inline(always)]
    pub(crate) fn at(&self, place: usize, state: &BodyState, rotation: &DMat3) -> ContactState {
        let mut at = self.constraints[place].at(state, rotation);
        if self.bend_count > 0 {
            self.bend(place, state, &mut at);
        }
        at
    }

    /// Adds a constraint's bends to how it is seen.
    #[inline(never)]
    fn bend(&self, place: usize, state: &BodyState, at: &mut ContactState) {
        for bend in self.bends().iter().filter(|bend| bend.constraint == place) {
            let bent = bend.at(state);
            at.overlap += bent.value;
            at.direction += bent.linear * bent.slope;
            at.moment += bent.angular * bent.slope;
        }
        at.rate = at.direction.dot(state.twist.linear - self.constraints[place].surface.velocity)
            + at.moment.dot(state.twist.angular);
    }

    pub(crate) fn constraints_mut(&mut self) -> &mut [PlaneConstraint] {
        &mut self.constraints[..self.count]
    }

    /// Whether there is no contact.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// How many contacts were left out because the model was full.
    pub fn overflow(&self) -> u32 {
        self.overflow
    }

    /// How many contacts were refused because they were not finite or had no normal.
    pub fn refused(&self) -> u32 {
        self.refused
    }

    /// When the contacts were found, s.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Age of the contacts at `now`, s.
    pub fn age(&self, now: f64) -> f64 {
        now - self.time
    }

    /// Where the body was when the contacts were found.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// The furthest that any contact's point on the body has moved since the contacts were found, m (0
    /// without contacts). Plane constraints hold for motions small against the features of the scene.
    pub fn displacement(&self, pose: &Pose) -> f64 {
        self.constraints().iter().fold(0.0, |most: f64, c| {
            most.max((pose.transform_point(c.point) - self.pose.transform_point(c.point)).length())
        })
    }

    /// The sum of the contacts' stiffnesses, N/m: a bound on what the body can feel in any direction.
    pub fn total_stiffness(&self) -> f64 {
        self.constraints().iter().map(|c| c.stiffness).sum()
    }

    /// The contacts' wrench on the body at a state, about the centre of mass, without derivatives.
    pub fn wrench(&self, state: &BodyState) -> Wrench {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let mut sum = Wrench::ZERO;
        for (i, c) in self.constraints().iter().enumerate() {
            let at = self.at(i, state, &rotation);
            let push = c.push(state, &at);
            if push.normal > 0.0 {
                sum += c.wrench(&at, &push);
            }
        }
        sum
    }

    /// Wrench and derivatives at a state (Eq. 5.37–5.46 as corrected, by rotation vector).
    pub fn evaluate(&self, state: &BodyState) -> ContactResponse {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let mut response =
            ContactResponse { wrench: Wrench::ZERO, jacobian: WrenchJacobian::ZERO, active: 0 };
        for (i, c) in self.constraints().iter().enumerate() {
            let at = self.at(i, state, &rotation);
            let push = c.push(state, &at);
            let Push { normal: force, hold } = push;
            if force <= 0.0 {
                continue;
            }
            response.active |= 1 << i;
            response.wrench += c.wrench(&at, &push);
            let direction = (-at.direction, -at.moment);
            let stiffness = c.stiffness_at(at.overlap).unwrap_or(0.0);
            let by_turn = at.moment * stiffness + c.swept(&at, state.twist.angular);
            let mut pose = Block6::outer(direction, (at.direction * stiffness, by_turn));
            pose.torque_angular += skew_skew(c.normal * -force, at.arm);
            for bend in self.bends().iter().filter(|bend| bend.constraint == i) {
                let bent = bend.at(state);
                let (along, turn) = (bent.linear * bent.curvature, bent.angular * bent.curvature);
                pose += Block6::outer((bent.linear * -force, bent.angular * -force), (along, turn));
                let swept = c.damping * bent.rate(&state.twist);
                pose += Block6::outer(direction, (along * swept, turn * swept));
                pose.torque_angular += skew(bent.angular) * (0.5 * force * bent.slope);
            }
            let twist = Block6::outer(direction, (at.direction * c.damping, at.moment * c.damping));
            response.jacobian += WrenchJacobian { pose, twist };
            if c.friction.is_some() && at.overlap > 0.0 {
                response.jacobian += c.hold_jacobian(state, &at, force, &hold);
            }
        }
        response
    }

    /// Energy held in the contact springs, J.
    pub fn potential_energy(&self, pose: &Pose) -> f64 {
        let state = BodyState::at_rest(*pose);
        let rotation = DMat3::from_quat(pose.rotation);
        let energy = |(i, c): (usize, &PlaneConstraint)| {
            0.5 * c.stiffness * self.at(i, &state, &rotation).overlap.max(0.0).powi(2)
        };
        self.constraints().iter().enumerate().map(energy).sum()
    }
}

impl PlaneConstraint {
    /// ∂(b δ̇)/∂φ at constant ω: b a × (n × ω).
    pub(crate) fn swept(&self, at: &ContactState, angular: DVec3) -> DVec3 {
        at.arm.cross(self.normal.cross(angular)) * self.damping
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::body::Body;
    use crate::coupling::{DeviceMotion, VirtualCoupling};
    use crate::differences::{
        random_direction, random_pose, random_twist, random_vector, relative_error, wrench_jacobian,
    };
    use crate::integrators::{Frame, Integrator as _, IntegratorKind};

    fn random_contact(rng: &mut StdRng, at: &Pose) -> Contact {
        let point = at.translation + random_vector(rng, 0.1);
        let normal = random_direction(rng);
        let depth = rng.random_range(-0.004..0.004);
        Contact { point, scene_point: point - normal * depth, normal, depth }
    }

    fn random_parameters(rng: &mut StdRng) -> ContactParameters {
        ContactParameters {
            stiffness: rng.random_range(100.0..1e4),
            damping: rng.random_range(0.0..20.0),
            tolerance: rng.random_range(0.0..0.005),
            friction: Friction::NONE,
        }
    }

    #[test]
    fn jacobian_equals_central_differences_away_from_the_clamp() {
        let seed = 41;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut checked = 0;
        for case in 0..2000 {
            let found_at = random_pose(&mut rng, 0.5);
            let parameters = random_parameters(&mut rng);
            let contacts: Vec<_> =
                (0..rng.random_range(1..6)).map(|_| random_contact(&mut rng, &found_at)).collect();
            let mut model = LinearContactModel::from_contacts(contacts, &found_at, &parameters, 0.0);
            let braking_time = [0.0, 0.01][case % 2];
            model.constraints_mut().iter_mut().for_each(|c| c.braking_time = braking_time);
            // The body has moved and turned since the contacts were found.
            let pose = found_at.moved(&random_twist(&mut rng, 0.002, 0.5), 1.0);
            let state = BodyState { pose, twist: random_twist(&mut rng, 0.1, 2.0) };
            // Differences reach 6e-4 rad, 6e-4 m and 0.2 m/s: keep all contacts on one side of the clamp.
            let rotation = DMat3::from_quat(pose.rotation);
            let margin =
                0.003 * (parameters.stiffness + 40.0 * parameters.damping) + 1.0 * parameters.damping;
            let clear = model.constraints().iter().all(|c| {
                let at = c.at(&state, &rotation);
                let Some(stiffness) = c.stiffness_at(at.overlap) else { return at.overlap < -0.003 };
                let force = stiffness * at.overlap + c.damping * at.rate;
                at.overlap.abs() > 0.003 && force.abs() > margin + 0.3 * stiffness * 0.003
            });
            if !clear {
                continue;
            }
            let response = model.evaluate(&state);
            assert!((response.wrench - model.wrench(&state)).force.length() < 1e-9);
            if response.active == 0 {
                continue;
            }
            checked += 1;
            let expected = wrench_jacobian(|s| model.wrench(s), &state);
            let error = relative_error(&response.jacobian, &expected);
            assert!(error < 1e-6, "seed {seed}, case {case}: relative error {error}");
        }
        assert!(checked > 200, "only {checked} cases were away from the clamp");
    }

    #[test]
    fn force_at_the_pose_of_the_query_is_stiffness_times_depth_and_tolerance() {
        let seed = 42;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..1000 {
            let pose = random_pose(&mut rng, 0.5);
            let parameters = random_parameters(&mut rng);
            let mut contact = random_contact(&mut rng, &pose);
            // Even where the two points do not lie along the normal, as for a cluster's representative.
            contact.scene_point += random_vector(&mut rng, 0.001);
            let model = LinearContactModel::from_contacts([contact], &pose, &parameters, 0.0);
            let wrench = model.wrench(&BodyState::at_rest(pose));
            let size = (parameters.stiffness * (contact.depth + parameters.tolerance)).max(0.0);
            let expected = Wrench::from_force_at(contact.normal * -size, contact.point - pose.translation);
            assert!((wrench.force - expected.force).length() < 1e-11, "seed {seed}, case {case}");
            assert!((wrench.torque - expected.torque).length() < 1e-11, "seed {seed}, case {case}");
        }
    }

    #[test]
    fn no_contact_attracts_in_any_state() {
        let seed = 43;
        let mut rng = StdRng::seed_from_u64(seed);
        let (mut pushed, mut clamped) = (0, 0);
        for case in 0..20_000 {
            let pose = random_pose(&mut rng, 0.5);
            let parameters = random_parameters(&mut rng);
            let contact = random_contact(&mut rng, &pose);
            let mut model = LinearContactModel::from_contacts([contact], &pose, &parameters, 0.0);
            model.constraints_mut()[0].braking_time = [0.0, 0.01][case % 2];
            let state = BodyState {
                pose: pose.moved(&random_twist(&mut rng, 0.01, 0.3), 1.0),
                twist: random_twist(&mut rng, 1.0, 20.0),
            };
            let along = model.wrench(&state).force.dot(contact.normal);
            assert!(along <= 0.0, "seed {seed}, case {case}: attracts with {along} N");
            let at = model.constraints()[0].at(&state, &DMat3::from_quat(state.pose.rotation));
            if at.overlap <= 0.0 && case % 2 == 0 {
                assert_eq!(along, 0.0, "seed {seed}, case {case}: open contact pushes");
            } else if along == 0.0 {
                clamped += 1;
                assert_eq!(model.evaluate(&state).jacobian, WrenchJacobian::ZERO);
            }
            pushed += usize::from(along < 0.0);
        }
        assert!(pushed > 5000 && clamped > 500, "{pushed} pushed, {clamped} clamped");
    }

    #[test]
    fn a_full_model_keeps_the_deepest_and_says_so() {
        let pose = Pose::IDENTITY;
        let parameters =
            ContactParameters { stiffness: 1.0, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };
        let contact = |i: usize| Contact {
            point: DVec3::ZERO,
            scene_point: DVec3::ZERO,
            normal: DVec3::Z,
            // 7 and 25 are coprime: every depth from 0 to 24 once, out of order.
            depth: ((i * 7) % 25) as f64,
        };
        let model = LinearContactModel::from_contacts((0..25).map(contact), &pose, &parameters, 3.0);
        let mut kept: Vec<_> = model.constraints().iter().map(|c| -c.scene_point.z).collect();
        kept.sort_by(f64::total_cmp);
        assert_eq!(kept, (9..25).map(f64::from).collect::<Vec<_>>());
        assert_eq!((model.overflow(), model.refused()), (9, 0));
        assert_eq!(model.total_stiffness(), MAX_CLUSTERS as f64);
        assert_eq!(model.age(3.25), 0.25);
    }

    #[test]
    fn contacts_that_are_not_finite_are_refused() {
        let parameters =
            ContactParameters { stiffness: 1.0, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };
        let good = Contact { point: DVec3::X, scene_point: DVec3::X, normal: DVec3::Z, depth: 0.5 };
        let bad = [
            Contact { point: DVec3::NAN, ..good },
            Contact { normal: DVec3::ZERO, ..good },
            Contact { normal: DVec3::NAN, ..good },
            Contact { depth: f64::INFINITY, ..good },
        ];
        let model = LinearContactModel::from_contacts(
            bad.into_iter().chain([good]),
            &Pose::IDENTITY,
            &parameters,
            0.0,
        );
        assert_eq!((model.constraints().len(), model.refused()), (1, 4));
    }

    #[test]
    fn displacement_is_the_furthest_motion_of_a_contact_point() {
        let parameters =
            ContactParameters { stiffness: 1.0, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };
        let contact =
            |x| Contact { point: DVec3::X * x, scene_point: DVec3::ZERO, normal: DVec3::Z, depth: 0.0 };
        let model = LinearContactModel::from_contacts(
            [contact(0.1), contact(-0.3)],
            &Pose::IDENTITY,
            &parameters,
            0.0,
        );
        assert_eq!(model.displacement(&Pose::IDENTITY), 0.0);
        let turned = Pose::new(DVec3::ZERO, glam::DQuat::from_rotation_z(std::f64::consts::PI));
        assert!((model.displacement(&turned) - 0.6).abs() < 1e-15);
    }

    fn random_carried(rng: &mut StdRng, pose: &Pose, friction: f64, carrier: &Carrier) -> LinearContactModel {
        let contacts: Vec<_> = (0..rng.random_range(1..5))
            .map(|_| ContactPatch {
                contact: random_contact(rng, pose),
                radius: if rng.random_bool(0.5) { 0.01 } else { 0.0 },
            })
            .collect();
        let parameters =
            ContactParameters { friction: Friction::coulomb(friction), ..random_parameters(rng) };
        let mut model = LinearContactModel::empty(pose, 0.0);
        contacts.iter().for_each(|contact| model.push_carried(*contact, &parameters, 0.0, carrier));
        model
    }

    /// Whether all moves with a velocity, or the same stands still, the body does the same beside that.
    #[test]
    fn what_moves_together_feels_the_same() {
        let seed = 45;
        let mut rng = StdRng::seed_from_u64(seed);
        let body = Body::new(0.1, DMat3::from_diagonal(DVec3::new(1e-4, 2e-4, 1.5e-4))).unwrap();
        let coupling = VirtualCoupling {
            linear_stiffness: 0.0,
            linear_damping: 0.0,
            angular_stiffness: 0.0,
            angular_damping: 0.0,
            ..VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 1.0, 1.0)
        };
        let dt = 1e-3;
        let mut pushed = 0;
        for case in 0..500 {
            let pose = random_pose(&mut rng, 0.1);
            let still = random_carried(
                &mut rng,
                &pose,
                [0.0, 0.5][case % 2],
                &Carrier { twist: Twist::ZERO, object: None },
            );
            let velocity = random_vector(&mut rng, 0.5);
            let carrier = Carrier { twist: Twist::new(velocity, DVec3::ZERO), object: None };
            let mut moving = LinearContactModel::empty(&pose, 0.0);
            for constraint in still.constraints() {
                let surface = carrier.surface_at(constraint.scene_point);
                moving.push(PlaneConstraint { surface, ..*constraint });
            }
            moving.advance(dt);
            let state = BodyState { pose, twist: random_twist(&mut rng, 0.2, 1.0) };
            let carried =
                BodyState { twist: Twist::new(state.twist.linear + velocity, state.twist.angular), ..state };
            let step = |contacts: &LinearContactModel, state: &BodyState, kind: IntegratorKind| {
                let device = DeviceMotion::at_rest(pose);
                let frame = Frame {
                    body: &body,
                    device: &device,
                    coupling: &coupling,
                    contacts,
                    gravity: DVec3::ZERO,
                };
                kind.step(&frame, state, dt)
            };
            for kind in [IntegratorKind::SemiImplicit, IntegratorKind::FullyImplicit] {
                let (at_rest, moved) = (step(&still, &state, kind), step(&moving, &carried, kind));
                let gained = moved.state.twist.linear - at_rest.state.twist.linear - velocity;
                let went = moved.state.pose.translation - at_rest.state.pose.translation - velocity * dt;
                let off = [1e-12, 1e-9][case % 2];
                assert!(gained.length() < off, "seed {seed}, case {case}, {kind:?}: {gained} m/s");
                assert!(went.length() < off * dt, "seed {seed}, case {case}, {kind:?}: {went} m");
                assert!(
                    (moved.contact - at_rest.contact).force.length() < 1e4 * off,
                    "seed {seed}, case {case}"
                );
                pushed += usize::from(at_rest.contact != Wrench::ZERO);
            }
        }
        assert!(pushed > 300, "{pushed} pushed");
    }

    #[test]
    fn a_turning_surface_drags_a_patch_along() {
        let pose = Pose::IDENTITY;
        let parameters = ContactParameters {
            stiffness: 1000.0,
            damping: 1.0,
            tolerance: 0.0,
            friction: Friction::coulomb(0.5),
        };
        let contact =
            Contact { point: DVec3::ZERO, scene_point: DVec3::NEG_Z * 0.01, normal: DVec3::Z, depth: 0.01 };
        let mut model = LinearContactModel::empty(&pose, 0.0);
        let twist = Twist::new(DVec3::ZERO, DVec3::Z * 2.0);
        let patch = ContactPatch { contact, radius: 0.01 };
        model.push_carried(patch, &parameters, 0.0, &Carrier { twist, object: None });
        let at_rest = BodyState::at_rest(pose);
        let by_damper = model.wrench(&at_rest).torque.z;
        assert!((by_damper - 1.0 * 0.01 * 0.01 * 2.0).abs() < 1e-9, "{by_damper}");
        model.advance(0.005);
        let turned = model.wrench(&at_rest).torque.z - by_damper;
        let expected = 1000.0 * 0.01 * 0.01 * 2.0 * (0.005 * 2.0_f64 / 2.0).sin();
        assert!((turned - expected).abs() < 1e-9, "{turned} {expected}");
        // It does not for ever.
        (0..100).for_each(|_| model.advance(0.005));
        let end = model.wrench(&at_rest).torque.z;
        model.advance(0.005);
        assert_eq!(model.wrench(&at_rest).torque.z, end);
        let most = 1000.0 * 0.01 * 0.01 * 2.0 * (LinearContactModel::LONGEST_MOTION * 2.0 / 2.0).sin();
        assert!((end - most).abs() < 1e-9, "{end} {most}");
    }

    #[test]
    fn reactions_are_the_reverse_of_the_wrench() {
        let seed = 46;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut pushed = 0;
        for case in 0..500 {
            let pose = random_pose(&mut rng, 0.5);
            let mut model = LinearContactModel::empty(&pose, 0.0);
            for object in 1..4 {
                let twist = random_twist(&mut rng, 0.2, 1.0);
                let carrier = Carrier { twist, object: NonZeroU32::new(object) };
                for constraint in random_carried(&mut rng, &pose, 0.5, &carrier).constraints() {
                    model.push(*constraint);
                }
            }
            let state = BodyState { pose, twist: random_twist(&mut rng, 0.2, 1.0) };
            let sum = model.reactions(&state).fold(Wrench::ZERO, |sum, (_, wrench)| sum + wrench);
            let on_body = model.wrench(&state).about(-pose.translation);
            let left = sum + on_body;
            assert!(left.force.length() < 1e-9 && left.torque.length() < 1e-9, "seed {seed}, case {case}");
            pushed += model.reactions(&state).count();
        }
        assert!(pushed > 500, "{pushed} pushed");
        assert_eq!(
            LinearContactModel::empty(&Pose::IDENTITY, 0.0)
                .reactions(&BodyState::at_rest(Pose::IDENTITY))
                .count(),
            0
        );
    }
}
