//! The contacts of one body in the haptic loop: the blended contact model, and the body's motion since it was
//! found.

use palpate_core::Pose;
use palpate_dynamics::{BodyState, Constraint, ContactBlend, LinearContactModel, MotionBound};

use super::joined::Joined;
use super::pushed_objects::PushedObjects;
use super::reactions::ReactionFeed;
use crate::constraints::geometry::stepping::Points;
use crate::constraints::geometry::taken::Taken;
use crate::constraints::geometry::{ContactGeometry, StepContacts, StepMotion, reach_of_step};
use crate::contact_loop::monitor::{ConstraintForces, ContactForce};
use crate::telemetry::record::ModelData;

/// Distance that a body may move from where its contact model was found: in bounding radii, and at least, in
/// m at the device. With more, the body feels planes of surfaces that are elsewhere.
const MAX_STRAY: (f64, f64) = (0.5, 0.01);

/// Age at which constraints of surfaces that stand still are overdue, s: the contact loop may have ended, and
/// the scene may have changed since.
const STILL_TIMEOUT: f64 = 0.5;

/// The contacts of one body.
#[derive(Clone, Debug)]
pub(super) struct BodyContacts {
    pub blend: ContactBlend,
    /// Contact geometry, if contacts are constraints.
    pub geometry: Option<ContactGeometry>,
    /// Whether contacts will be constraints, and none were found yet.
    awaited: bool,
    points: Points,
    /// Contacts of this step and of the one before, which change places in each.
    contacts: [Box<StepContacts>; 2],
    /// Which are those of this step.
    now: usize,
    /// Pose at which the points were last measured; the contacts' arms are from its centre of mass.
    at: Pose,
    /// Data of the newest contact model, with the constraints of this step.
    pub found: ModelData,
    /// Largest depth (m) and number of its penalty contacts.
    pub penalties: (f64, u32),
    /// Bounding radius of the body about its centre of mass, m.
    radius: f64,
    /// Distance that the body may move from where its contact model was found, m.
    max_stray: f64,
    /// Lengths of the world for those at the device.
    scale: f64,
}

impl BodyContacts {
    pub fn new(pose: Pose, radius: f64, scale: f64) -> Self {
        let max_stray = (MAX_STRAY.0 * radius).max(MAX_STRAY.1 * scale);
        Self {
            blend: ContactBlend::new(),
            geometry: None,
            awaited: false,
            points: Points::default(),
            contacts: Default::default(),
            now: 0,
            at: pose,
            found: ModelData::none(pose),
            penalties: (0.0, 0),
            radius,
            max_stray,
            scale,
        }
    }

    /// Holds the body where it is until contact geometry is found, or lets it go.
    pub fn hold(&mut self, held: bool) {
        self.awaited = held;
    }

    /// Whether the body waits for the first contact geometry.
    pub fn is_held(&self) -> bool {
        self.awaited
    }

    /// Whether contacts are constraints.
    pub fn is_constrained(&self) -> bool {
        self.awaited || self.geometry.is_some()
    }

    /// Bounding radius of the body about its centre of mass, m.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Finds the constraints that a step of `dt` (s) from a state may reach, with scene objects that contacts
    /// push and those in other hands. Returns the bound on its motion.
    pub fn find(
        &mut self,
        state: &BodyState,
        dt: f64,
        pushed: &PushedObjects,
        joined: &[Joined],
    ) -> MotionBound {
        self.now = 1 - self.now;
        let [first, second] = &mut self.contacts;
        let (found, before) = if self.now == 0 { (first, second) } else { (second, first) };
        let Some(geometry) = &mut self.geometry else {
            found.clear();
            let still = MotionBound { from: state.pose, room: 0.0, step: 0.0, radius: self.radius };
            return if self.awaited { still } else { MotionBound::NONE };
        };
        let moved = displacement(&self.at, &state.pose, self.radius);
        self.at = state.pose;
        pushed.move_objects(geometry);
        let speed = state.twist.linear.length() + state.twist.angular.length() * self.radius;
        let reach = reach_of_step(speed, dt, self.scale);
        let motion = StepMotion { moved, reach, dt };
        geometry.contacts(&mut self.points, state, &motion, before, found);
        geometry.advance(dt);
        // What moves by itself has moved since the last step, and goes on in this one.
        let (mut gone, mut ahead) = (0.0_f64, geometry.ahead(dt));
        for other in joined.iter().filter(|other| !geometry.moves(other.id)) {
            gone = gone.max(other.moved);
            ahead = ahead.max(other.speed() * dt);
        }
        geometry.bound.room -= gone;
        let (depth, contacts) = self.penalties;
        self.found.depth = depth.max(found.depth);
        self.found.contacts = contacts + found.contacts.len() as u32;
        let bound = geometry.bound_at(&state.pose);
        MotionBound { step: found.room, room: bound.room - ahead, ..bound }
    }

    /// Holds the contacts of a step against where it has led. Returns whether they have changed, so that the
    /// step is to be taken again.
    pub fn revise(&mut self, step: &Taken) -> bool {
        let contacts = &mut self.contacts[self.now];
        self.geometry.as_ref().is_some_and(|geometry| geometry.revise(&mut self.points, step, contacts))
    }

    /// The penalty contacts and the constraints of this step.
    pub fn contacts(&mut self) -> (&LinearContactModel, &mut [Constraint]) {
        (self.blend.model(), &mut self.contacts[self.now].contacts)
    }

    /// Largest force with which one contact pushed the body in a step of `dt` (s) that ended at a state, N.
    /// Contacts on both sides of a body push it, though their forces may add up to nothing.
    pub fn largest_push(&self, state: &BodyState, dt: f64) -> f64 {
        let impulses = self.contacts[self.now].pushing().map(|contact| contact.impulse.length());
        (impulses.fold(0.0, f64::max) / dt).max(self.blend.model().largest_force(state))
    }

    /// Pushes scene objects by the impulses of this step, and adds these to a feed. Returns the number of
    /// objects for which it had no room.
    pub fn push(&self, pushed: &mut PushedObjects, reacting: &mut ReactionFeed) -> u64 {
        let Some(geometry) = &self.geometry else { return 0 };
        pushed.push(&geometry.objects, &self.contacts[self.now].contacts, self.at.translation, reacting)
    }

    /// Writes the forces of the last step's constraints on the body: the step of `dt` (s) ended at a state.
    pub fn write_constraints(&self, state: &BodyState, dt: f64, to: &mut ConstraintForces) {
        to.clear();
        for contact in self.contacts[self.now].pushing() {
            let Constraint { arm, normal, gap, impulse, .. } = *contact;
            let point = state.pose.translation + arm;
            to.push(ContactForce { point, normal, force: impulse / -dt, depth: -gap });
        }
    }

    /// Takes over contact geometry that was found with the body elsewhere, an `age` (s) ago. `body` is its
    /// number.
    pub fn take(
        &mut self,
        (body, geometry): (usize, Option<&ContactGeometry>),
        (state, age): (&BodyState, f64),
        pushed: &mut PushedObjects,
        joined: &[Joined],
    ) {
        self.awaited = false;
        let Some(found) = geometry else {
            self.geometry = None;
            return;
        };
        // Keys of points change from one geometry to the next.
        self.contacts[self.now].forget();
        let moved = displacement(&self.at, &state.pose, self.radius);
        let pushing = |last| self.points.pushing(&self.contacts[self.now], (last, found), moved);
        let carried = self.geometry.as_ref().map(pushing).unwrap_or_default();
        let known = self.geometry.get_or_insert_with(|| found.clone());
        known.assign(found);
        self.points.assign(found);
        pushed.take(body, known);
        known.advance(age);
        let others = joined.iter().filter(|other| !known.moves(other.id));
        known.bound.room -= others.fold(0.0, |gone: f64, other| gone.max(other.moved_in(age)));
        let moved = known.bound.displacement(&state.pose);
        self.points.shift(&mut known.objects, moved);
        self.points.carry(&carried);
        self.at = state.pose;
    }

    /// Age (s) that the contacts found last may reach: those of surfaces that stand still hold as long as the
    /// body is within their bound.
    pub fn holds_for(&self, timeout: f64) -> f64 {
        let still = self.geometry.as_ref().is_some_and(ContactGeometry::is_still);
        if still && self.penalties.1 == 0 { timeout.max(STILL_TIMEOUT) } else { timeout }
    }

    /// Largest displacement of any point of the body since its contact model was found, |Δ**x**| + 2 r
    /// sin(θ/2), as a fraction of the allowed distance; 0 without penalty contacts, since constraints bound
    /// that displacement themselves.
    pub fn strayed(&self, pose: &Pose) -> f64 {
        let found = &self.found;
        if self.penalties.1 == 0 {
            return 0.0;
        }
        displacement(&found.pose, pose, self.radius) / self.max_stray
    }
}

/// Displacement of any point within a radius (m) of the centre of mass from one pose to another, m.
fn displacement(from: &Pose, to: &Pose, radius: f64) -> f64 {
    MotionBound { from: *from, radius, ..MotionBound::NONE }.displacement(to)
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::{DQuat, DVec3};

    use super::*;

    #[test]
    fn a_body_strays_by_its_shift_and_its_turn() {
        let mut body = BodyContacts::new(Pose::IDENTITY, 0.1, 1.0);
        // Half of the radius is more than a centimetre at the device.
        assert_eq!(body.max_stray, 0.05);
        let moved = Pose::new(DVec3::X * 0.01, DQuat::from_rotation_z(0.2));
        assert_eq!(body.strayed(&moved), 0.0, "there are no contacts yet");
        body.penalties.1 = 3;
        // A point at the radius moves by the chord 2 r sin(θ/2).
        let wanted = (0.01 + 2.0 * 0.1 * 0.1_f64.sin()) / 0.05;
        assert!((body.strayed(&moved) - wanted).abs() < 1e-12, "{}", body.strayed(&moved));
        // For a small body the limit is a centimetre at the device, which is ten in a world scaled by ten.
        assert_eq!(BodyContacts::new(Pose::IDENTITY, 0.001, 10.0).max_stray, 0.1);
    }
}
