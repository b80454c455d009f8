//! Friction between the steps and between models: anchors that yield, and anchors found anew.

use arrayvec::ArrayVec;
use glam::{DMat3, DVec3};
use palpate_core::{Twist, Wrench};

use super::constraint::{ContactState, PlaneConstraint};
use super::coulomb::Strain;
use super::model::{LinearContactModel, MAX_CONSTRAINTS};
use crate::body::BodyState;
use crate::jacobian::outer;
use crate::system::{Lateral, Linear, six};

/// Regularisation of the system of [`LinearContactModel::take_over_friction`], relative to its trace: no
/// unit. With 0 it is singular where contacts do not hold all directions.
const REGULARISATION: f64 = 1e-9;

/// Rounds in which what some contacts cannot hold is left to others.
const TAKE_OVER_ROUNDS: usize = 3;

impl LinearContactModel {
    /// Lets contacts slide where friction does not hold them. To be called with the state at the end of each
    /// step.
    pub fn settle(&mut self, state: &BodyState) {
        let rotation = DMat3::from_quat(state.pose.rotation);
        for constraint in self.constraints_mut().iter_mut().filter(|c| c.friction.is_some()) {
            constraint.settle(state, &rotation);
        }
    }

    /// Strains the contacts so that friction holds the body with the wrench that the springs of `other`, the
    /// model before, have, as far as friction allows. They are strained as if the body had moved by one small
    /// displacement since, which a 6×6 solve finds. What some cannot hold is left to the others, in a few
    /// rounds. The contacts of a body at rest hence never creep, however often they are found anew.
    pub fn take_over_friction(&mut self, other: &Self, state: &BodyState) {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let wanted = other.springs(state, &rotation);
        let mut taking: ArrayVec<_, MAX_CONSTRAINTS> = self
            .constraints_mut()
            .iter_mut()
            .filter(|constraint| constraint.friction.is_some())
            .map(|constraint| TransferredFriction::new(constraint, state, &rotation))
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
        for TransferredFriction { constraint, at, stretch, .. } in &mut taking {
            constraint.set_anchor(state, at, stretch);
        }
    }

    /// Wrench that strains the friction springs, about the centre of mass.
    fn springs(&self, state: &BodyState, rotation: &DMat3) -> Wrench {
        let with_friction = self.constraints().iter().filter(|c| c.friction.is_some());
        with_friction.fold(Wrench::ZERO, |sum, c| {
            let at = c.at(state, rotation);
            sum + c.spring_wrench(&at, &c.stretch(state, &at))
        })
    }
}

/// A contact that takes over friction from the model before.
struct TransferredFriction<'a> {
    constraint: &'a mut PlaneConstraint,
    at: ContactState,
    stretch: Strain,
    /// Whether the contact cannot hold more.
    yields: bool,
}

impl<'a> TransferredFriction<'a> {
    /// The contact without strain.
    fn new(constraint: &'a mut PlaneConstraint, state: &BodyState, rotation: &DMat3) -> Self {
        let at = constraint.at(state, rotation);
        Self { constraint, at, stretch: Strain::default(), yields: false }
    }

    /// Strains the contact by a displacement (m, rad) of the body, as far as friction holds.
    fn strain_by(&mut self, displacement: &Twist, state: &BodyState) {
        let c = &*self.constraint;
        let moved = displacement.velocity_at(self.at.arm);
        let more = c.velocity_strain(moved, c.normal.dot(moved), displacement.angular);
        let stretch = self.stretch.plus(&more);
        let share = c.share_of_spring(state, &self.at, &stretch);
        self.stretch = stretch.scaled(share);
        self.yields = share < 1.0;
    }

    fn wrench(&self) -> Wrench {
        self.constraint.spring_wrench(&self.at, &self.stretch)
    }
}

/// Displacement (m, rad) of the body to which the springs of all contacts that do not yield answer with
/// −`held`.
fn displacement_for(held: &Wrench, taking: &[TransferredFriction<'_>]) -> Option<Twist> {
    let holding = || taking.iter().filter(|one| !one.yields);
    // Angles times this distance, so that both kinds of unknowns are lengths.
    let reach = holding()
        .map(|one| one.constraint.point.length() + one.constraint.radius)
        .fold(f64::MIN_POSITIVE, f64::max);
    let mut linear = Linear::with_right(six(held.force, held.torque / reach));
    let mut lateral = Lateral::NONE;
    for TransferredFriction { constraint: c, at, .. } in holding() {
        lateral.add(c.stiffness, at.arm / reach);
        // The spring is along the plane: k (1 − n nᵀ).
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
