//! Contacts of detailed surfaces, whose depth is more than the distance from a plane (§5.4.4).
//!
//! Such a contact is given by its depth, the depth's gradient (g_x, g_θ) by a shift and a turn of the body,
//! and its second derivatives. Its potential is U = ½ k (δ + d)² as for every contact, so its wrench is −λ
//! ∇δ. It consists of
//!
//! - the plane along g_x, through the point of the body on the wrench's axis, with stiffness k ‖g_x‖² and
//!   damping b ‖g_x‖²: it has the gradient (g_x, a × g_x),
//! - a linear term, which adds the rest of the torque, pitch · g_x per newton (a smooth maximum over several
//!   places has one),
//! - quadratic terms ½ (b · q)² along the directions b in which δ has a positive second derivative beyond
//!   that of the plane, where q is the motion since the contact was found: the [`QUADRATIC_TERMS`] largest.
//!   Negative ones are left out: with them the wrench would push away from crests, and an implicit step might
//!   have no solution. With positive ones δ, and so U, is convex except for the turning of the plane's lever
//!   arm, and their stiffness is positive semidefinite.
//!
//! A quadratic term changes the gradient by at most [`MAX_GRADIENT_CHANGE`] and is linear beyond, since the
//! curvature is known only where the contact was found.

use arrayvec::ArrayVec;
use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};

use super::contact::{ContactParameters, PenaltyContact};
use super::coulomb::FrictionAnchor;
use crate::algebra::eigen::{Matrix6, eigen};
use crate::body::BodyState;

/// Largest number of quadratic terms of a contact: a surface has two principal curvatures.
const QUADRATIC_TERMS: usize = 2;

/// Largest number of curvature terms of a contact: the linear one and the quadratic ones.
pub(super) const MAX_TERMS: usize = QUADRATIC_TERMS + 1;

/// Largest change of ‖∇δ‖ by a quadratic term, with turns multiplied by the body's lever arm. With more,
/// contacts turn by curvatures of places that the body has left.
pub(super) const MAX_GRADIENT_CHANGE: f64 = 1.0;

/// Largest factor ‖g_x‖² by which a slope stiffens a contact. With more, contacts on steep detail are
/// stiffer.
const MAX_STIFFENING: f64 = 4.0;

/// A contact of detailed surfaces, with the Hessian of its depth, in world axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvedContact {
    /// Point at which the surfaces touch, m.
    pub point: DVec3,
    /// δ, m.
    pub depth: f64,
    /// g_x = ∂δ/∂x by a shift of the body.
    pub linear: DVec3,
    /// g_θ = ∂δ/∂θ by a turn of the body about its centre of mass, m/rad.
    pub angular: DVec3,
    /// Second derivatives by shift and turn (symmetric): 1/m, 1 and m.
    pub second: [[f64; 6]; 6],
    /// Lever arm that makes turns comparable with shifts, about the size of the body, m.
    pub lever: f64,
}

/// One term of a contact's depth beyond the distance from a plane: slope · s + ½ curvature · s², where s is
/// linear in the motion of the body since the contact was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CurvatureTerm {
    /// Index of the contact in the model.
    pub contact: usize,
    /// Pose of the body at which the contact was found.
    origin: Pose,
    /// ∂s by a shift and by a turn.
    linear: DVec3,
    angular: DVec3,
    slope: f64,
    pub(super) curvature: f64,
    /// Largest |s| at which the term is curved.
    limit: f64,
}

/// A curvature term at one state of the body.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EvaluatedTerm {
    /// Contribution to δ, m.
    pub value: f64,
    /// Its derivatives by s.
    pub slope: f64,
    pub curvature: f64,
    /// ∂s by a shift and by a turn.
    pub linear: DVec3,
    pub angular: DVec3,
}

impl CurvatureTerm {
    pub(super) const NONE: Self = Self {
        contact: 0,
        origin: Pose::IDENTITY,
        linear: DVec3::ZERO,
        angular: DVec3::ZERO,
        slope: 0.0,
        curvature: 0.0,
        limit: 0.0,
    };

    fn along((linear, angular): (DVec3, DVec3), origin: &Pose, limit: f64) -> Self {
        Self { linear, angular, limit, origin: *origin, ..Self::NONE }
    }

    /// The same term for another contact.
    pub(super) fn of(&self, contact: usize) -> Self {
        Self { contact, ..*self }
    }

    /// Evaluates the term at a state.
    pub fn at(&self, state: &BodyState) -> EvaluatedTerm {
        // 2 sin(θ/2) in place of the angle θ, along the shorter rotation.
        let turn: DQuat = state.pose.rotation * self.origin.rotation.conjugate();
        let turn = turn * turn.w.signum();
        let shift = state.pose.translation - self.origin.translation;
        let s = self.linear.dot(shift) + 2.0 * self.angular.dot(turn.xyz());
        // slope · s + ½ curvature · s² up to the limit, and linear beyond it.
        let within = s.clamp(-self.limit, self.limit);
        EvaluatedTerm {
            value: self.slope * s + self.curvature * within * (s - 0.5 * within),
            slope: self.slope + self.curvature * within,
            curvature: if s == within { self.curvature } else { 0.0 },
            linear: self.linear,
            angular: self.angular * turn.w + turn.xyz().cross(self.angular),
        }
    }
}

impl EvaluatedTerm {
    /// ds/dt.
    pub fn rate(&self, twist: &Twist) -> f64 {
        self.linear.dot(twist.linear) + self.angular.dot(twist.angular)
    }
}

impl CurvedContact {
    /// Makes the plane and its curvature terms from the contact found while the body was at `pose`; `None` if
    /// the contact is not finite or has no gradient.
    pub(super) fn contact(
        &self,
        pose: &Pose,
        gains: &ContactParameters,
    ) -> Option<(PenaltyContact, ArrayVec<CurvatureTerm, MAX_TERMS>)> {
        let square = self.linear.length_squared();
        let finite = self.point.is_finite() && self.angular.is_finite() && self.depth.is_finite();
        let sized = self.lever > 0.0 && self.lever.is_finite();
        if !(finite && sized && square.is_finite() && square > f64::EPSILON) {
            return None;
        }
        let steepness = square.sqrt();
        let normal = self.linear / steepness;
        // The point of the wrench's axis nearest to the contact's point.
        let off_axis = normal.cross(self.angular) / steepness;
        let arm = off_axis + normal * normal.dot(self.point - pose.translation);
        let stiffer = square.min(MAX_STIFFENING);
        let plane = PenaltyContact {
            point: pose.rotation.conjugate() * arm,
            scene_point: pose.translation + arm - normal * (self.depth / steepness),
            normal,
            stiffness: gains.stiffness * stiffer,
            damping: gains.damping * stiffer,
            tolerance: gains.tolerance / steepness,
            friction: gains.friction,
            anchor: FrictionAnchor { point: pose.translation + arm, rotation: pose.rotation },
            ..PenaltyContact::NONE
        };
        // The part of g_θ along the normal, which a × g_x lacks for any arm, per unit of the plane's depth δ
        // / ‖g_x‖.
        let rest = (DVec3::ZERO, normal * (normal.dot(self.angular) / steepness));
        let linear_term = CurvatureTerm { slope: 1.0, ..CurvatureTerm::along(rest, pose, 0.0) };
        let root = steepness.sqrt();
        let quadratic = self.curved_directions(arm).into_iter().map(|(linear, angular)| {
            let size = linear.length().hypot(angular.length() / self.lever);
            let limit = MAX_GRADIENT_CHANGE / (size * root);
            CurvatureTerm {
                curvature: 1.0,
                ..CurvatureTerm::along((linear / root, angular / root), pose, limit)
            }
        });
        let twists = linear_term.angular.length_squared() > 0.0;
        Some((plane, twists.then_some(linear_term).into_iter().chain(quadratic).collect()))
    }

    /// Directions b, linear (m^-½) and angular (m^½), of the largest positive second derivatives beyond those
    /// of the plane with its point at `arm`; none if these are not finite.
    fn curved_directions(&self, arm: DVec3) -> ArrayVec<(DVec3, DVec3), QUADRATIC_TERMS> {
        // Turns are multiplied by the lever arm, so that all second derivatives are in 1/m.
        let scale = |i: usize| if i < 3 { 1.0 } else { self.lever };
        let (a, g) = (arm.to_array(), self.linear.to_array());
        let along = arm.dot(self.linear);
        // The plane's own second derivative by turns: ½ (a gᵀ + g aᵀ) − (a · g) 1.
        let of_plane = |i: usize, j: usize| {
            let (i, j) = (i.checked_sub(3)?, j.checked_sub(3)?);
            Some(0.5 * (a[i] * g[j] + g[i] * a[j]) - if i == j { along } else { 0.0 })
        };
        let beyond: Matrix6 = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                (self.second[i][j] - of_plane(i, j).unwrap_or(0.0)) / (scale(i) * scale(j))
            })
        });
        if !beyond.iter().flatten().all(|value| value.is_finite()) {
            return ArrayVec::new();
        }
        let (values, vectors) = eigen(beyond);
        let mut order = [0, 1, 2, 3, 4, 5];
        order.sort_unstable_by(|&i, &j| values[j].total_cmp(&values[i]));
        let chosen = order.into_iter().take(QUADRATIC_TERMS).filter(|&k| values[k] > 0.0);
        let direction = |k: usize| {
            let [x, y, z, a, b, c] = std::array::from_fn(|i| vectors[i][k] * values[k].sqrt() * scale(i));
            (DVec3::new(x, y, z), DVec3::new(a, b, c))
        };
        chosen.map(direction).collect()
    }
}
