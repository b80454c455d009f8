//! What contacts push the scene's objects with (§6.2.2): the reverse of what they push the grasped object with, added up over the
//! steps of the haptic loop, so that what one gains the others lose.

use std::num::NonZeroU32;
use std::sync::{Arc, Mutex, PoisonError};

use arrayvec::ArrayVec;
use palpate_core::glam::DVec3;
use palpate_dynamics::{BodyState, LinearContactModel, MAX_CONSTRAINTS};
use rtrb::{Consumer, Producer, RingBuffer};

use crate::scene::SceneId;

/// Reactions that may wait for the host: half a second of eight objects at 1 kHz. Those that find no room are added up.
const WAITING: usize = 4096;

/// Objects of which reactions are added up: as many as a contact model can have.
const OBJECTS: usize = MAX_CONSTRAINTS;

/// An impulse on an object of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reaction {
    /// The object.
    pub object: SceneId,
    /// Impulse, N·s, world axes.
    pub linear: DVec3,
    /// Angular impulse about the world's origin, N·m·s, world axes.
    pub angular: DVec3,
}

impl Reaction {
    /// Angular impulse about a point (m, world axes), as an object's centre of mass, N·m·s.
    pub fn angular_about(&self, point: DVec3) -> DVec3 {
        self.angular - point.cross(self.linear)
    }
}

/// Takes what contacts push the scene's objects with, from any thread, for objects that have a
/// [`DynamicBody`](crate::DynamicBody). Made by [`HapticRenderer::reactions`](crate::HapticRenderer::reactions).
///
/// A clone takes from the same queue: each reaction goes to whoever takes it first.
#[derive(Clone, Debug)]
pub struct Reactions {
    waiting: Arc<Mutex<Consumer<Reaction>>>,
}

impl Reactions {
    /// The next one that waits, the oldest first. Nothing is lost where they are taken late: what finds no room is added to what
    /// comes later of the same object.
    pub fn take(&mut self) -> Option<Reaction> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner).pop().ok()
    }
}

/// The haptic loop's end, where somebody takes them; nobody takes those of a clone.
#[derive(Debug, Default)]
pub(crate) struct Reacting {
    ring: Option<Producer<Reaction>>,
    /// The host's end.
    reactions: Option<Reactions>,
    sums: ArrayVec<Reaction, OBJECTS>,
}

impl Clone for Reacting {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Reacting {
    /// Lets them be taken, from the next step on. Each call gives another handle to the same queue.
    pub fn open(&mut self) -> Reactions {
        if let Some(reactions) = &self.reactions {
            return reactions.clone();
        }
        let (ring, waiting) = RingBuffer::new(WAITING);
        self.ring = Some(ring);
        self.reactions.insert(Reactions { waiting: Arc::new(Mutex::new(waiting)) }).clone()
    }

    /// Adds what contacts ended a step of `dt` (s) with; how many found no room.
    pub fn add(&mut self, contacts: &LinearContactModel, state: &BodyState, dt: f64) -> u64 {
        if self.ring.is_none() || !contacts.reacts() {
            return 0;
        }
        let mut lost = 0;
        for (object, wrench) in contacts.reactions(state) {
            let (linear, angular) = (wrench.force * dt, wrench.torque * dt);
            let object = scene_id(object);
            match self.sums.iter_mut().find(|sum| sum.object == object) {
                Some(sum) => {
                    sum.linear += linear;
                    sum.angular += angular;
                }
                None => lost += u64::from(self.sums.try_push(Reaction { object, linear, angular }).is_err()),
            }
        }
        lost
    }

    /// Passes on what was added up, as far as there is room: in every step, so that what found none is not kept until the next contact.
    pub fn pass_on(&mut self) {
        let Some(ring) = &mut self.ring else { return };
        while let Some(sum) = self.sums.pop() {
            if let Err(rtrb::PushError::Full(sum)) = ring.push(sum) {
                // There was room for it.
                self.sums.push(sum);
                break;
            }
        }
    }
}

/// The object that contacts know by a number.
fn scene_id(object: NonZeroU32) -> SceneId {
    SceneId(object.get() as usize - 1)
}

#[cfg(test)]
mod tests {
    use palpate_core::{Contact, Pose, Twist};
    use palpate_dynamics::{ContactClass, ContactParameters, Friction, MovingBody};

    use super::*;

    /// Whether they are taken at once, late or never before the end, their sum is the same.
    #[test]
    fn what_is_taken_late_is_not_lost() {
        let contact = Contact { point: DVec3::X, scene_point: DVec3::X, normal: DVec3::NEG_Z, depth: 0.001 };
        let parameters =
            ContactParameters { stiffness: 1000.0, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };
        let mut model = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
        for object in [1, 7] {
            let carrier = MovingBody { twist: Twist::ZERO, object: NonZeroU32::new(object) };
            model.push(ContactClass::Touching, contact, &parameters, &carrier);
        }
        let state = BodyState::at_rest(Pose::IDENTITY);
        let steps = 5000;
        for every in [1, 100, steps] {
            let mut reacting = Reacting::default();
            let mut reactions = reacting.open();
            let mut sums = [DVec3::ZERO; 7];
            let mut take = || {
                while let Some(Reaction { object, linear, angular }) = reactions.take() {
                    sums[object.0] += linear;
                    assert!((angular - DVec3::X.cross(linear)).length() < 1e-15);
                }
            };
            for step in 1..=steps {
                assert_eq!(reacting.add(&model, &state, 1e-3), 0);
                reacting.pass_on();
                if step % every == 0 {
                    take();
                }
            }
            // What was added up goes with the next step, contact or not.
            reacting.pass_on();
            take();
            let wanted = DVec3::NEG_Z * (1e-3 * f64::from(steps));
            for (object, sum) in sums.iter().enumerate() {
                let wanted = if [0, 6].contains(&object) { wanted } else { DVec3::ZERO };
                assert!((*sum - wanted).length() < 1e-9, "every {every}, object {object}: {sum}");
            }
        }
    }
}
