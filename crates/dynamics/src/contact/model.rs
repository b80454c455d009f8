//! The contacts that the contact thread hands to the haptic thread: storage, capacities, and motion with the scene.

use glam::DMat3;
use palpate_core::{Contact, Pose};

use super::constraint::{ContactParameters, ContactPatch, ContactState, MovingBody, PlaneConstraint};
use super::curvature::{CurvatureTerm, CurvedContact, MAX_TERMS};
use crate::body::BodyState;

/// Largest number of touching contacts of a model: the upper bound on the number of clusters K (§5.4.2).
pub const MAX_CLUSTERS: usize = 16;

/// Largest number of approaching contacts of a model, besides the touching ones.
pub const MAX_APPROACHING: usize = 4;

/// Largest number of constraints: those of an incoming and of an outgoing model while one blends into the other.
pub const MAX_CONSTRAINTS: usize = 2 * (MAX_CLUSTERS + MAX_APPROACHING);

/// Largest number of curvature terms.
const MAX_CURVATURE_TERMS: usize = 16 * MAX_TERMS;

/// The latest contacts, from which the haptic thread evaluates force and derivatives on its own: fixed size,
/// `Copy`, nothing on the heap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearContactModel {
    constraints: [PlaneConstraint; MAX_CONSTRAINTS],
    count: usize,
    terms: [CurvatureTerm; MAX_CURVATURE_TERMS],
    term_count: usize,
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
            terms: [CurvatureTerm::NONE; MAX_CURVATURE_TERMS],
            term_count: 0,
            overflow: 0,
            refused: 0,
            pose: *pose,
            time,
            moves: false,
            reacts: false,
            advanced: 0.0,
        }
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
        gains: &ContactParameters,
        time: f64,
    ) -> Self {
        let mut model = Self::empty(pose, time);
        let mut depths = [0.0; MAX_CLUSTERS];
        for patch in contacts {
            let patch = patch.into();
            let Some(constraint) = PlaneConstraint::found(&patch, pose, gains) else {
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
    pub fn push_moving(
        &mut self,
        contact: impl Into<ContactPatch>,
        gains: &ContactParameters,
        braking_time: f64,
        object: &MovingBody,
    ) {
        let Some(constraint) = PlaneConstraint::found(&contact.into(), &self.pose, gains) else {
            self.refused += 1;
            return;
        };
        let most = MAX_CLUSTERS + if braking_time > 0.0 { MAX_APPROACHING } else { 0 };
        if self.count >= most {
            self.overflow += 1;
            return;
        }
        let surface = object.surface_at(constraint.scene_point);
        self.push(PlaneConstraint { braking_time, surface, ..constraint });
    }

    /// Adds contacts further apart than d that are to brake the body from `time` (s) before they would close. Beyond
    /// [`MAX_APPROACHING`] the rest are left out.
    pub fn push_approaching(
        &mut self,
        contacts: impl IntoIterator<Item = Contact>,
        gains: &ContactParameters,
        time: f64,
    ) {
        for contact in contacts.into_iter().take(MAX_APPROACHING) {
            match PlaneConstraint::found(&contact.into(), &self.pose, gains) {
                Some(constraint) => {
                    self.push(PlaneConstraint { braking_time: time, ..constraint });
                }
                None => self.refused += 1,
            }
        }
    }

    /// Adds a contact, found while the body was at a pose, with how its depth changes as the body moves; gains are those of
    /// a plane along the depth's gradient (Eqs. 5.51–5.56). It brakes the body from `braking_time` (s) before it would close.
    /// How the scene's object moves counts for the plane, not for its terms.
    /// Left out where the model has [`MAX_CLUSTERS`] already, refused where it is not finite or has no gradient.
    pub fn push_curved(
        &mut self,
        contact: &CurvedContact,
        found_at: &Pose,
        gains: &ContactParameters,
        braking_time: f64,
        object: &MovingBody,
    ) {
        let Some((constraint, terms)) = contact.constraint(found_at, gains) else {
            self.refused += 1;
            return;
        };
        if self.count >= MAX_CLUSTERS {
            self.overflow += 1;
            return;
        }
        let surface = object.surface_at(constraint.scene_point);
        self.push(PlaneConstraint { braking_time, surface, ..constraint });
        for term in terms {
            self.push_term(&term);
        }
    }

    /// Adds a bend of the last constraint; where there is no room for it, the depth is a little straighter.
    fn push_term(&mut self, term: &CurvatureTerm) {
        if self.term_count < MAX_CURVATURE_TERMS {
            self.terms[self.term_count] = term.of(self.count - 1);
            self.term_count += 1;
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

    /// The curvature terms of all contacts.
    pub(crate) fn curvature_terms(&self) -> &[CurvatureTerm] {
        &self.terms[..self.term_count]
    }

    /// The curvature terms of one contact.
    pub(super) fn terms_of(&self, index: usize) -> impl Iterator<Item = &CurvatureTerm> {
        self.curvature_terms().iter().filter(move |term| term.constraint == index)
    }

    /// The constraints.
    pub fn constraints(&self) -> &[PlaneConstraint] {
        &self.constraints[..self.count]
    }

    /// Takes all of another model, at the cost of what that holds.
    pub(crate) fn assign(&mut self, other: &Self) {
        let Self { constraints, count, terms, term_count, overflow, refused, pose, time, .. } = other;
        self.constraints[..*count].copy_from_slice(&constraints[..*count]);
        self.count = *count;
        self.terms[..*term_count].copy_from_slice(&terms[..*term_count]);
        self.term_count = *term_count;
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
            constraint.advance(dt);
            if ends {
                constraint.surface = constraint.surface.stopped();
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

    /// Scales the gains of all constraints but the first ones.
    pub(crate) fn scale_from(&mut self, first: usize, share: f64) {
        for constraint in &mut self.constraints_mut()[first..] {
            constraint.stiffness *= share;
            constraint.damping *= share;
        }
    }

    /// Adds those of another model's constraints, with their terms, whose bits are set.
    pub(crate) fn extend(&mut self, other: &Self, chosen: u64) {
        for (i, constraint) in other.constraints().iter().enumerate() {
            if chosen & (1 << i) == 0 || !self.push(*constraint) {
                continue;
            }
            for term in other.terms_of(i) {
                self.push_term(term);
            }
        }
    }

    /// The contact with an index at a state, with its curvature terms; `rotation` is the body's.
    #[inline(always)]
    pub(crate) fn at(&self, index: usize, state: &BodyState, rotation: &DMat3) -> ContactState {
        let mut at = self.constraints[index].at(state, rotation);
        if self.term_count > 0 {
            self.add_curvature(index, state, &mut at);
        }
        at
    }

    /// Adds the curvature terms of a contact: depth, its gradient, and hence the rate ∇δ · (v, ω).
    #[inline(never)]
    fn add_curvature(&self, index: usize, state: &BodyState, at: &mut ContactState) {
        for term in self.terms_of(index) {
            let term = term.at(state);
            at.overlap += term.value;
            at.direction += term.linear * term.slope;
            at.moment += term.angular * term.slope;
        }
        at.rate = at.direction.dot(state.twist.linear - self.constraints[index].surface.velocity)
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
}
