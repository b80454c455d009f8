//! The contact model that the contact thread passes to the haptic thread: storage, budgets, and motion with
//! the scene.

use arrayvec::ArrayVec;
use glam::DMat3;
use palpate_core::{Contact, Pose};

use super::contact::{ContactParameters, ContactPatch, ContactState, MovingBody, PenaltyContact};
use super::curvature::{CurvatureTerm, CurvedContact, MAX_TERMS};
use crate::body::BodyState;

/// Largest number of touching contacts of a model: the upper bound on the number of clusters K (§5.4.2).
pub const MAX_CLUSTERS: usize = 16;

/// Largest number of approaching contacts of a model, besides the touching ones.
pub const MAX_APPROACHING: usize = 4;

/// Largest number of contacts: those of an incoming and of an outgoing model while one blends into the
/// other.
pub const MAX_PENALTY_CONTACTS: usize = 2 * (MAX_CLUSTERS + MAX_APPROACHING);

/// Largest number of curvature terms, if all contacts are curved.
const MAX_CURVATURE_TERMS: usize = MAX_PENALTY_CONTACTS * MAX_TERMS;

/// Class of a contact. Each class has its own budget in a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ContactClass {
    /// Contact within the tolerance d; at most [`MAX_CLUSTERS`].
    Touching,
    /// Contact further apart that the body approaches; at most [`MAX_APPROACHING`].
    Approaching {
        /// τ, s: time before closing from which the contact brakes the body. With 0 it counts as a touching
        /// contact.
        braking_time: f64,
    },
}

/// A contact to add to a model.
#[derive(Clone, Copy, Debug)]
pub enum FoundContact<'a> {
    /// A contact with a plane, found at the pose of the model.
    Plane(ContactPatch),
    /// A contact of detailed surfaces, and the pose of the body at which it was found.
    Curved(&'a CurvedContact, &'a Pose),
}

impl From<Contact> for FoundContact<'_> {
    fn from(contact: Contact) -> Self {
        Self::Plane(contact.into())
    }
}

impl From<ContactPatch> for FoundContact<'_> {
    fn from(patch: ContactPatch) -> Self {
        Self::Plane(patch)
    }
}

/// The latest contacts, from which the haptic thread evaluates force and derivatives by itself. The size is
/// fixed and nothing is on the heap.
///
/// Touching and approaching contacts have a [budget](ContactClass) each. When it is used up, the shallowest
/// contact of the class is dropped, the new one included. Dropped contacts are counted ([`Self::overflow`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearContactModel {
    contacts: [PenaltyContact; MAX_PENALTY_CONTACTS],
    count: usize,
    terms: [CurvatureTerm; MAX_CURVATURE_TERMS],
    term_count: usize,
    overflow: u32,
    refused: u32,
    pose: Pose,
    time: f64,
    /// Whether a contact's surface moves.
    moves: bool,
    /// Whether a contact's object receives reactions.
    reacts: bool,
    /// Time by which surfaces have been advanced, s.
    advanced: f64,
}

impl LinearContactModel {
    /// A model without contacts at `time` (s).
    pub const fn empty(pose: &Pose, time: f64) -> Self {
        Self {
            contacts: [PenaltyContact::NONE; MAX_PENALTY_CONTACTS],
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

    /// Makes the model of touching `contacts` with objects at rest, found while the body was at `pose` at
    /// `time` (s, the caller's clock): each is [pushed](Self::push).
    pub fn from_contacts(
        contacts: impl IntoIterator<Item = impl Into<ContactPatch>>,
        pose: &Pose,
        gains: &ContactParameters,
        time: f64,
    ) -> Self {
        let mut model = Self::empty(pose, time);
        for patch in contacts {
            model.push(ContactClass::Touching, patch.into(), gains, &MovingBody::STILL);
        }
        model
    }

    /// Adds a contact with an object that may move. If its class is full, the shallowest contact of the class
    /// is dropped ([`Self::overflow`]). A contact that is not finite, or has no normal or gradient, is
    /// refused ([`Self::refused`]).
    ///
    /// At the pose of the model a touching contact with an object at rest pushes with exactly k (δ + d) for
    /// its given depth δ: the plane is put at p − δ n (Eq. 5.36), even if the contact's own p₀ differs. A
    /// curved contact has the gains of a plane along the depth's gradient (Eqs. 5.51–5.56); the motion of the
    /// scene's object moves that plane but not the curvature terms.
    pub fn push<'a>(
        &mut self,
        class: ContactClass,
        contact: impl Into<FoundContact<'a>>,
        gains: &ContactParameters,
        object: &MovingBody,
    ) {
        let found = match contact.into() {
            FoundContact::Plane(patch) => {
                PenaltyContact::found(&patch, &self.pose, gains).map(|plane| (plane, ArrayVec::new()))
            }
            FoundContact::Curved(contact, found_at) => contact.contact(found_at, gains),
        };
        let Some((plane, terms)) = found else {
            self.refused += 1;
            return;
        };
        let braking_time = match class {
            ContactClass::Touching => 0.0,
            ContactClass::Approaching { braking_time } => braking_time,
        };
        let surface = object.surface_at(plane.scene_point);
        self.push_within_budget(PenaltyContact { braking_time, surface, ..plane }, &terms);
    }

    /// Adds a contact as it is, without curvature terms: as an approaching contact if it has a braking
    /// time, and as a touching one if not. The budget of its class applies as in [`Self::push`].
    pub fn push_contact(&mut self, contact: PenaltyContact) {
        self.push_within_budget(contact, &[]);
    }

    /// Adds a contact if its class has room, or in place of the shallowest contact of the class if that is
    /// shallower.
    fn push_within_budget(&mut self, contact: PenaltyContact, terms: &[CurvatureTerm]) {
        let brakes = contact.brakes();
        let budget = if brakes { MAX_APPROACHING } else { MAX_CLUSTERS };
        let of_class = || (0..self.count).filter(|&i| self.contacts[i].brakes() == brakes);
        if of_class().count() < budget {
            self.append(&contact, terms);
            return;
        }
        self.overflow += 1;
        let depth = |i: usize| self.depth_of(&self.contacts[i], self.terms_of(i));
        let shallowest = of_class().map(|i| (i, depth(i))).min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((index, least)) = shallowest
            && self.depth_of(&contact, terms.iter()).total_cmp(&least).is_gt()
        {
            self.replace(index, contact, terms);
        }
    }

    /// Depth of a contact at the pose of the model, m.
    fn depth_of<'a>(&self, c: &PenaltyContact, terms: impl Iterator<Item = &'a CurvatureTerm>) -> f64 {
        let state = BodyState::at_rest(self.pose);
        let at = c.at(&state, &DMat3::from_quat(self.pose.rotation));
        at.overlap - c.tolerance + terms.map(|term| term.at(&state).value).sum::<f64>()
    }

    /// Replaces a contact, whose curvature terms are removed, by another.
    fn replace(&mut self, index: usize, contact: PenaltyContact, terms: &[CurvatureTerm]) {
        self.contacts[index] = contact;
        let mut kept = 0;
        for i in 0..self.term_count {
            if self.terms[i].contact != index {
                self.terms[kept] = self.terms[i];
                kept += 1;
            }
        }
        self.term_count = kept;
        self.append_terms(index, terms.iter());
        self.moves = self.contacts().iter().any(|c| c.surface.moves());
        self.reacts = self.contacts().iter().any(|c| c.surface.object.is_some());
    }

    /// Appends a contact, whatever its class.
    fn append<'a>(&mut self, contact: &PenaltyContact, terms: impl IntoIterator<Item = &'a CurvatureTerm>) {
        if self.count == MAX_PENALTY_CONTACTS {
            self.overflow += 1;
            return;
        }
        self.contacts[self.count] = *contact;
        self.append_terms(self.count, terms);
        self.count += 1;
        self.moves |= contact.surface.moves();
        self.reacts |= contact.surface.object.is_some();
    }

    /// Appends the curvature terms of a contact. There is room for those of all contacts.
    fn append_terms<'a>(&mut self, index: usize, terms: impl IntoIterator<Item = &'a CurvatureTerm>) {
        for (place, term) in self.terms[self.term_count..].iter_mut().zip(terms) {
            *place = term.of(index);
            self.term_count += 1;
        }
    }

    /// The curvature terms of all contacts.
    pub(crate) fn curvature_terms(&self) -> &[CurvatureTerm] {
        &self.terms[..self.term_count]
    }

    /// The curvature terms of one contact.
    pub(super) fn terms_of(&self, index: usize) -> impl Iterator<Item = &CurvatureTerm> {
        self.curvature_terms().iter().filter(move |term| term.contact == index)
    }

    /// The contacts.
    pub fn contacts(&self) -> &[PenaltyContact] {
        &self.contacts[..self.count]
    }

    /// Copies another model; only the contacts that it has are copied.
    pub(crate) fn assign(&mut self, other: &Self) {
        let Self { contacts, count, terms, term_count, overflow, refused, pose, time, .. } = other;
        self.contacts[..*count].copy_from_slice(&contacts[..*count]);
        self.count = *count;
        self.terms[..*term_count].copy_from_slice(&terms[..*term_count]);
        self.term_count = *term_count;
        (self.overflow, self.refused) = (*overflow, *refused);
        (self.pose, self.time) = (*pose, *time);
        (self.moves, self.reacts, self.advanced) = (other.moves, other.reacts, other.advanced);
    }

    /// Moves planes and friction anchors along with their surfaces for a time (s). A step of `dt` uses them
    /// where they are at its end. Surfaces move for [`Self::MAX_SURFACE_MOTION`] at most and then stand
    /// still, since their motion is not known without a newer model.
    pub fn advance(&mut self, dt: f64) {
        if !(self.moves && dt > 0.0) {
            return;
        }
        let dt = dt.min(Self::MAX_SURFACE_MOTION - self.advanced);
        self.advanced += dt;
        let ends = self.advanced >= Self::MAX_SURFACE_MOTION;
        for contact in self.contacts_mut() {
            contact.advance(dt);
            if ends {
                contact.surface = contact.surface.stopped();
            }
        }
        self.moves &= !ends;
    }

    /// Longest time that surfaces move on from where they were found, s. With more, a model that is not
    /// replaced carries contacts away from the objects.
    pub const MAX_SURFACE_MOTION: f64 = 0.05;

    /// Whether some contacts are with objects that receive [reactions](Self::reactions).
    pub fn reacts(&self) -> bool {
        self.reacts
    }

    /// Scales the gains of the contacts from index `first` on.
    pub(crate) fn scale_from(&mut self, first: usize, share: f64) {
        for contact in &mut self.contacts_mut()[first..] {
            contact.stiffness *= share;
            contact.damping *= share;
        }
    }

    /// Appends those contacts of another model whose bits are set, with their curvature terms. The budgets of
    /// classes do not apply: there is room for all contacts of two models.
    pub(crate) fn extend(&mut self, other: &Self, chosen: u64) {
        for (i, contact) in other.contacts().iter().enumerate() {
            if chosen & (1 << i) != 0 {
                self.append(contact, other.terms_of(i));
            }
        }
    }

    /// Evaluates a contact at a state, with its curvature terms; `rotation` is the body's.
    #[inline(always)]
    pub(crate) fn at(&self, index: usize, state: &BodyState, rotation: &DMat3) -> ContactState {
        let mut at = self.contacts[index].at(state, rotation);
        if self.term_count > 0 {
            self.add_curvature(index, state, &mut at);
        }
        at
    }

    /// Adds the curvature terms of a contact to its depth and gradient, and updates the rate δ̇ = ∇δ · (v −
    /// v_s, ω).
    #[inline(never)]
    fn add_curvature(&self, index: usize, state: &BodyState, at: &mut ContactState) {
        for term in self.terms_of(index) {
            let term = term.at(state);
            at.overlap += term.value;
            at.direction += term.linear * term.slope;
            at.moment += term.angular * term.slope;
        }
        at.rate = at.direction.dot(state.twist.linear - self.contacts[index].surface.velocity)
            + at.moment.dot(state.twist.angular);
    }

    pub(crate) fn contacts_mut(&mut self) -> &mut [PenaltyContact] {
        &mut self.contacts[..self.count]
    }

    /// Whether there is no contact.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Number of contacts that were dropped because their class was full.
    pub fn overflow(&self) -> u32 {
        self.overflow
    }

    /// Number of contacts that were refused because they were not finite, or had no normal or gradient.
    pub fn refused(&self) -> u32 {
        self.refused
    }

    /// Time at which the contacts were found, s.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Age of the contacts at `now`, s.
    pub fn age(&self, now: f64) -> f64 {
        now - self.time
    }

    /// Pose of the body at which the contacts were found.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Largest displacement of a contact's point on the body since the contacts were found, m (0 without
    /// contacts). Penalty contacts are valid for motions small against the features of the scene.
    pub fn displacement(&self, pose: &Pose) -> f64 {
        self.contacts().iter().fold(0.0, |most: f64, c| {
            most.max((pose.transform_point(c.point) - self.pose.transform_point(c.point)).length())
        })
    }

    /// Sum of the contacts' stiffnesses, N/m: a bound on the stiffness that the body feels in any direction.
    pub fn total_stiffness(&self) -> f64 {
        self.contacts().iter().map(|c| c.stiffness).sum()
    }
}
