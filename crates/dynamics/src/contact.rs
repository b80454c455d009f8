//! Penalty contacts as plane constraints, in the form the contact thread hands to the haptic thread (§5.2.4, §5.4.3).
//!
//! Each contact is the plane through p₀ with normal n, fixed in the world, against the point r of the body. With
//! a = R r, δ = n · (x + a − p₀) and δ̇ = n · (v + ω × a), the force along the normal is
//!
//! λ = k (δ + d) + b δ̇ while both δ + d > 0 and λ > 0, else 0;  F_p = −λ n,  T_p = a × F_p.
//!
//! Departures from Eq. 5.37–5.38: the lever arm of the damper is in world axes, and contact is unilateral: no force
//! while δ + d ≤ 0, and the damper never makes it attract. The model keeps the constraints, not their Taylor expansion
//! (Eq. 5.14), so force, clamp and derivatives are those of the body's present placement however far it has moved.
//!
//! The stiffness that the body feels is at most the number of constraints times k, and that number is at most
//! [`MAX_CLUSTERS`]: this is what the clustering of §5.4.2 is for.

use glam::{DMat3, DVec3};
use palpate_core::{Contact, Pose, Wrench};

use crate::body::BodyState;
use crate::jacobian::{Block6, WrenchJacobian};
use crate::rotation::skew_skew;

/// The most contacts a model holds: the upper bound on the number of clusters K (§5.4.2).
pub const MAX_CLUSTERS: usize = 16;

/// Penalty gains, the same for every contact (§5.4.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactParameters {
    /// k, N/m.
    pub stiffness: f64,
    /// b, N·s/m.
    pub damping: f64,
    /// d, the distance at which contact force begins, m.
    pub tolerance: f64,
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
}

/// A constraint seen from one state of the body.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ContactState {
    /// a = R r.
    pub arm: DVec3,
    /// a × n: with n, the direction of the contact's wrench.
    pub moment: DVec3,
    /// δ + d.
    pub overlap: f64,
    /// δ̇.
    pub rate: f64,
}

impl PlaneConstraint {
    pub(crate) fn at(&self, state: &BodyState, rotation: &DMat3) -> ContactState {
        let arm = *rotation * self.point;
        let moment = arm.cross(self.normal);
        let depth = self.normal.dot(state.pose.translation + arm - self.scene_point);
        let rate = self.normal.dot(state.twist.linear) + moment.dot(state.twist.angular);
        ContactState { arm, moment, overlap: depth + self.tolerance, rate }
    }

    /// λ at a state: the size of the repulsive force, N, never negative.
    pub(crate) fn normal_force(&self, at: &ContactState) -> f64 {
        if at.overlap > 0.0 { (self.stiffness * at.overlap + self.damping * at.rate).max(0.0) } else { 0.0 }
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
    pub active: u32,
}

/// The latest contacts, from which the haptic thread evaluates force and derivatives on its own: fixed size, `Copy`,
/// nothing on the heap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearContactModel {
    constraints: [PlaneConstraint; MAX_CLUSTERS],
    count: usize,
    overflow: u32,
    refused: u32,
    pose: Pose,
    time: f64,
}

impl LinearContactModel {
    /// No contact, as of `time` (s).
    pub fn empty(pose: &Pose, time: f64) -> Self {
        Self {
            constraints: [PlaneConstraint::default(); MAX_CLUSTERS],
            count: 0,
            overflow: 0,
            refused: 0,
            pose: *pose,
            time,
        }
    }

    /// The model of `contacts` found while the body was at `pose`, stamped with `time` (s, the caller's clock).
    ///
    /// At that pose each contact pushes with k (δ + d) exactly, δ being the depth it came with: the plane is put at
    /// p − δ n (Eq. 5.36) even where the contact's own p₀ differs. Beyond [`MAX_CLUSTERS`] the shallowest are left out
    /// ([`Self::overflow`]); a contact that is not finite or has no normal is refused ([`Self::refused`]).
    pub fn from_contacts(
        contacts: impl IntoIterator<Item = Contact>,
        pose: &Pose,
        parameters: &ContactParameters,
        time: f64,
    ) -> Self {
        let mut model = Self::empty(pose, time);
        let mut depths = [0.0; MAX_CLUSTERS];
        let to_body = pose.rotation.conjugate();
        for contact in contacts {
            let length = contact.normal.length();
            let usable =
                contact.point.is_finite() && contact.depth.is_finite() && length.is_finite() && length > 0.0;
            if !usable {
                model.refused += 1;
                continue;
            }
            let slot = if model.count < MAX_CLUSTERS {
                model.count += 1;
                model.count - 1
            } else {
                model.overflow += 1;
                let shallowest = (1..MAX_CLUSTERS).fold(0, |s, i| if depths[i] < depths[s] { i } else { s });
                if contact.depth <= depths[shallowest] {
                    continue;
                }
                shallowest
            };
            depths[slot] = contact.depth;
            let normal = contact.normal / length;
            model.constraints[slot] = PlaneConstraint {
                point: to_body * (contact.point - pose.translation),
                scene_point: contact.point - normal * contact.depth,
                normal,
                stiffness: parameters.stiffness,
                damping: parameters.damping,
                tolerance: parameters.tolerance,
            };
        }
        model
    }

    /// Adds a constraint; `false` if the model is full, which then stays as it was.
    pub fn push(&mut self, constraint: PlaneConstraint) -> bool {
        if self.count == MAX_CLUSTERS {
            self.overflow += 1;
            return false;
        }
        self.constraints[self.count] = constraint;
        self.count += 1;
        true
    }

    /// The constraints.
    pub fn constraints(&self) -> &[PlaneConstraint] {
        &self.constraints[..self.count]
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

    /// The furthest that any contact's point on the body has moved since the contacts were found, m (0 without
    /// contacts). Plane constraints hold for motions small against the features of the scene.
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
        for c in self.constraints() {
            let at = c.at(state, &rotation);
            let force = c.normal_force(&at);
            sum += Wrench { force: c.normal * -force, torque: at.moment * -force };
        }
        sum
    }

    /// Wrench and derivatives at a state (Eq. 5.37–5.46 as corrected, by rotation vector).
    pub fn evaluate(&self, state: &BodyState) -> ContactResponse {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let mut response =
            ContactResponse { wrench: Wrench::ZERO, jacobian: WrenchJacobian::ZERO, active: 0 };
        for (i, c) in self.constraints().iter().enumerate() {
            let at = c.at(state, &rotation);
            let force = c.normal_force(&at);
            if force <= 0.0 {
                continue;
            }
            response.active |= 1 << i;
            response.wrench += Wrench { force: c.normal * -force, torque: at.moment * -force };
            let direction = (-c.normal, -at.moment);
            let by_turn = at.moment * c.stiffness + c.swept(&at, state.twist.angular);
            let mut pose = Block6::outer(direction, (c.normal * c.stiffness, by_turn));
            pose.torque_angular += skew_skew(c.normal * -force, at.arm);
            let twist = Block6::outer(direction, (c.normal * c.damping, at.moment * c.damping));
            response.jacobian += WrenchJacobian { pose, twist };
        }
        response
    }

    /// Energy held in the contact springs, J.
    pub fn potential_energy(&self, pose: &Pose) -> f64 {
        let state = BodyState::at_rest(*pose);
        let rotation = DMat3::from_quat(pose.rotation);
        self.constraints()
            .iter()
            .map(|c| 0.5 * c.stiffness * c.at(&state, &rotation).overlap.max(0.0).powi(2))
            .sum()
    }
}

impl PlaneConstraint {
    /// ∂(b δ̇)/∂φ at constant ω: b a × (n × ω).
    pub(crate) fn swept(&self, at: &ContactState, angular: DVec3) -> DVec3 {
        at.arm.cross(self.normal.cross(angular)) * self.damping
    }
}
