//! Friction between steps and between models: anchors that yield, and anchors of a new model.

use arrayvec::ArrayVec;
use glam::{DMat3, DVec3};
use palpate_core::{Twist, Wrench};

use super::contact::{ContactState, PenaltyContact};
use super::coulomb::Strain;
use super::model::{LinearContactModel, MAX_PENALTY_CONTACTS};
use crate::body::BodyState;
use crate::jacobian::outer;
use crate::system::{Lateral, Linear, six};

/// Regularisation of the system of [`LinearContactModel::take_over_friction`], relative to its trace. With 0
/// the system is singular if the contacts leave a direction free.
const REGULARISATION: f64 = 1e-9;

/// Number of rounds in which the load that some contacts cannot hold is passed to others. With fewer, a
/// resting body creeps when a model arrives.
const TAKE_OVER_ROUNDS: usize = 3;

impl LinearContactModel {
    /// Lets contacts slide where friction does not hold them. Called with the state at the end of each step.
    pub fn settle(&mut self, state: &BodyState) {
        if !self.has_friction() {
            return;
        }
        let rotation = DMat3::from_quat(state.pose.rotation);
        for contact in self.contacts_mut().iter_mut().filter(|c| c.friction.is_some()) {
            contact.settle(state, &rotation);
        }
    }

    /// Strains the friction springs so that they hold the body with the same wrench as those of `other`, the
    /// model before, as far as friction allows. They are strained as if the body had moved by one small
    /// displacement, found by a 6×6 solve. The load that some cannot hold is passed to the others in a few
    /// rounds. So the contacts of a body at rest never creep, however often they are found again.
    pub fn take_over_friction(&mut self, other: &Self, state: &BodyState) {
        if !self.has_friction() {
            return;
        }
        let rotation = DMat3::from_quat(state.pose.rotation);
        let wanted = other.springs(state, &rotation);
        let mut taking: ArrayVec<_, MAX_PENALTY_CONTACTS> = self
            .contacts_mut()
            .iter_mut()
            .filter(|contact| contact.friction.is_some())
            .map(|contact| TransferredFriction::new(contact, state, &rotation))
            .collect();
        let mut missing = wanted;
        for _ in 0..TAKE_OVER_ROUNDS {
            let found = (missing != Wrench::ZERO).then(|| displacement_for(&missing, &taking));
            let Some(displacement) = found.flatten() else { break };
            let mut yielded = false;
            for one in taking.iter_mut().filter(|one| !one.yields) {
                one.strain_by(&displacement, state);
                yielded |= one.yields;
            }
            if !yielded {
                break;
            }
            missing = taking.iter().fold(wanted, |missing, one| missing - one.wrench());
        }
        for TransferredFriction { contact, at, stretch, .. } in &mut taking {
            contact.set_anchor(state, at, stretch);
        }
    }

    /// Whether any contact has friction. Where contacts are constraints, none of the model's has.
    fn has_friction(&self) -> bool {
        self.contacts().iter().any(|contact| contact.friction.is_some())
    }

    /// Wrench that the friction springs hold, about the centre of mass.
    fn springs(&self, state: &BodyState, rotation: &DMat3) -> Wrench {
        let with_friction = self.contacts().iter().filter(|c| c.friction.is_some());
        with_friction.fold(Wrench::ZERO, |sum, c| {
            let at = c.at(state, rotation);
            sum + c.spring_wrench(&at, &c.stretch(state, &at))
        })
    }
}

/// A contact that takes over friction from the model before.
struct TransferredFriction<'a> {
    contact: &'a mut PenaltyContact,
    at: ContactState,
    stretch: Strain,
    /// Whether the contact is at its Coulomb limit.
    yields: bool,
}

impl<'a> TransferredFriction<'a> {
    /// A contact without strain.
    fn new(contact: &'a mut PenaltyContact, state: &BodyState, rotation: &DMat3) -> Self {
        let at = contact.at(state, rotation);
        Self { contact, at, stretch: Strain::default(), yields: false }
    }

    /// Strains the contact by a displacement (m, rad) of the body, as far as friction holds.
    fn strain_by(&mut self, displacement: &Twist, state: &BodyState) {
        let c = &*self.contact;
        let moved = displacement.velocity_at(self.at.arm);
        let more = c.velocity_strain(moved, c.normal.dot(moved), displacement.angular);
        let stretch = self.stretch.plus(&more);
        let share = c.share_of_spring(state, &self.at, &stretch);
        self.stretch = stretch.scaled(share);
        self.yields = share < 1.0;
    }

    fn wrench(&self) -> Wrench {
        self.contact.spring_wrench(&self.at, &self.stretch)
    }
}

/// Displacement u = (x, φ) (m, rad) of the body that loads the springs of all contacts that do not yield with
/// `held` together: Σ k (P, −P a*; a* P, −a* P a* + ρ² n nᵀ) u = `held`, P = 1 − n nᵀ.
fn displacement_for(held: &Wrench, taking: &[TransferredFriction<'_>]) -> Option<Twist> {
    let holding = || taking.iter().filter(|one| !one.yields);
    // Angles are multiplied by this distance, so that all unknowns are lengths.
    let reach = holding()
        .map(|one| one.contact.point.length() + one.contact.radius)
        .fold(f64::MIN_POSITIVE, f64::max);
    let mut linear = Linear::with_right(six(held.force, held.torque / reach));
    let mut lateral = Lateral::NONE;
    for TransferredFriction { contact: c, at, .. } in holding() {
        lateral.add(c.stiffness, at.arm / reach);
        // The spring acts along the plane only: −k n nᵀ takes off what `lateral` has along the normal.
        let direction = six(c.normal, at.moment / reach);
        linear.add_along(&direction, &direction.map(|value| -c.stiffness * value));
        let radius = c.radius / reach;
        linear.add(3, 3, &outer(c.normal, c.normal * (c.stiffness * radius * radius)));
    }
    linear.add_lateral(&lateral);
    let trace: f64 = (0..6).map(|i| linear.matrix[i][i]).sum();
    (0..6).for_each(|i| linear.matrix[i][i] += REGULARISATION * trace);
    let [x, y, z, a, b, c] = linear.solution(true)?;
    Some(Twist { linear: DVec3::new(x, y, z), angular: DVec3::new(a, b, c) / reach })
}
