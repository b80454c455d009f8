//! One contact as a plane against a point of the body: gap, its rate, and the normal force.

use std::num::NonZeroU32;

use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Contact, Pose, Twist};

use super::coulomb::{Friction, FrictionAnchor};
use crate::body::BodyState;

/// Penalty gains, the same for every contact (§5.4.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactParameters {
    /// k, N/m.
    pub stiffness: f64,
    /// b, N·s/m.
    pub damping: f64,
    /// d, distance at which contact force begins, m.
    pub tolerance: f64,
    /// Friction between the surfaces.
    pub friction: Friction,
}

/// Motion of a scene surface at a contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceMotion {
    /// Velocity of the surface at the contact's point, m/s, world axes.
    pub velocity: DVec3,
    /// Angular velocity of the object that it belongs to, rad/s, world axes.
    pub angular: DVec3,
    /// Number of that object, if it receives [reactions](crate::LinearContactModel::reactions).
    pub object: Option<NonZeroU32>,
}

impl SurfaceMotion {
    /// A surface at rest, of an object that receives no reactions.
    pub const STILL: Self = Self { velocity: DVec3::ZERO, angular: DVec3::ZERO, object: None };

    pub(super) fn moves(&self) -> bool {
        self.velocity != DVec3::ZERO || self.angular != DVec3::ZERO
    }

    /// The same object's surface at rest.
    pub(super) fn stopped(&self) -> Self {
        Self { object: self.object, ..Self::STILL }
    }
}

impl Default for SurfaceMotion {
    fn default() -> Self {
        Self::STILL
    }
}

/// Motion of an object of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovingBody {
    /// Twist of the object; the velocity is that of its point at the world's origin.
    pub twist: Twist,
    /// Number of the object, if it receives [reactions](crate::LinearContactModel::reactions).
    pub object: Option<NonZeroU32>,
}

impl MovingBody {
    /// An object at rest that receives no reactions.
    pub const STILL: Self = Self { twist: Twist::ZERO, object: None };

    /// Motion of the object's surface at a point of the world (m).
    pub(super) fn surface_at(&self, point: DVec3) -> SurfaceMotion {
        let Self { twist, object } = *self;
        SurfaceMotion { velocity: twist.velocity_at(point), angular: twist.angular, object }
    }
}

/// A contact that represents a patch of contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactPatch {
    /// The contact, in world axes.
    pub contact: Contact,
    /// Root mean square distance of the contacts of the patch from its point, m: 0 for a single one.
    pub radius: f64,
}

impl From<Contact> for ContactPatch {
    fn from(contact: Contact) -> Self {
        Self { contact, radius: 0.0 }
    }
}

/// One contact: a point of the body held on one side of a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PenaltyContact {
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
    /// τ, s: time before closing from which the contact brakes; 0 for no braking.
    pub braking_time: f64,
    /// Friction between the surfaces.
    pub friction: Friction,
    /// Radius of the patch that the contact represents, m.
    pub radius: f64,
    /// Anchor of the friction spring.
    pub anchor: FrictionAnchor,
    /// Motion of the scene's surface.
    pub surface: SurfaceMotion,
}

/// A contact evaluated at one state of the body.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ContactState {
    /// a = R r.
    pub arm: DVec3,
    /// ∂δ/∂x and ∂δ/∂φ, the direction of the contact's wrench: n and a × n if there are no curvature terms.
    pub direction: DVec3,
    pub moment: DVec3,
    /// Velocity of the point relative to the surface, v + ω × a − v_s, m/s.
    pub velocity: DVec3,
    /// δ + d, m.
    pub overlap: f64,
    /// δ̇, m/s.
    pub rate: f64,
}

impl PenaltyContact {
    /// A contact without force.
    pub(super) const NONE: Self = Self {
        point: DVec3::ZERO,
        scene_point: DVec3::ZERO,
        normal: DVec3::ZERO,
        stiffness: 0.0,
        damping: 0.0,
        tolerance: 0.0,
        braking_time: 0.0,
        friction: Friction::NONE,
        radius: 0.0,
        anchor: FrictionAnchor::ORIGIN,
        surface: SurfaceMotion::STILL,
    };

    /// Makes the plane of a contact found while the body was at a pose; `None` if the contact is not finite
    /// or has no normal.
    pub(super) fn found(patch: &ContactPatch, pose: &Pose, gains: &ContactParameters) -> Option<Self> {
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
            stiffness: gains.stiffness,
            damping: gains.damping,
            tolerance: gains.tolerance,
            friction: gains.friction,
            radius,
            anchor: FrictionAnchor { point: contact.point, rotation: pose.rotation },
            ..Self::NONE
        })
    }

    // The functions called for each contact are inlined: passing results through memory costs more than the
    // arithmetic.

    /// Evaluates the plane at a state, without curvature terms: δ = n · (x + a − p₀), δ̇ = n · (v + ω × a −
    /// v_s).
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

    /// λ at a state: max(0, k (δ + d) + b δ̇) for a closed contact, N.
    pub(crate) fn normal_force(&self, at: &ContactState) -> f64 {
        let stiffness = self.stiffness_at(at.overlap);
        stiffness.map_or(0.0, |stiffness| (stiffness * at.overlap + self.damping * at.rate).max(0.0))
    }

    /// dλ/dδ, N/m, given δ + d: k for a closed contact, b/τ for one that brakes before; `None` if it has no
    /// force.
    pub(crate) fn stiffness_at(&self, overlap: f64) -> Option<f64> {
        if overlap > 0.0 {
            Some(self.stiffness)
        } else {
            self.brakes().then(|| self.damping / self.braking_time)
        }
    }

    /// Whether the contact brakes before it is closed, as for an approaching contact.
    pub(super) fn brakes(&self) -> bool {
        self.braking_time > 0.0
    }

    /// λ that bounds friction, N: 0 while the contact only brakes.
    pub(crate) fn gripping_force(&self, at: &ContactState) -> f64 {
        if at.overlap > 0.0 { self.normal_force(at) } else { 0.0 }
    }

    /// ∂(b δ̇)/∂φ at constant ω: b a × (n × ω).
    pub(crate) fn swept(&self, at: &ContactState, angular: DVec3) -> DVec3 {
        at.arm.cross(self.normal.cross(angular)) * self.damping
    }

    /// Moves plane and anchor along with the surface for a time (s).
    pub(super) fn advance(&mut self, dt: f64) {
        let SurfaceMotion { velocity, angular, .. } = self.surface;
        self.scene_point += velocity * dt;
        self.anchor.point += velocity * dt;
        if self.radius > 0.0 && angular != DVec3::ZERO {
            let turn = DQuat::from_scaled_axis(angular * dt);
            self.anchor.rotation = (turn * self.anchor.rotation).normalize();
        }
    }
}

impl Default for PenaltyContact {
    fn default() -> Self {
        Self::NONE
    }
}
