//! Reactions of contacts on the scene's objects (§6.2.2): the opposite of the contact wrenches on the grasped
//! object, summed over the steps of the haptic loop, so that momentum is conserved.

use std::num::NonZeroU32;
use std::sync::{Arc, Mutex, PoisonError};

use arrayvec::ArrayVec;
use palpate_core::glam::DVec3;
use palpate_dynamics::{BodyState, LinearContactModel, MAX_PENALTY_CONTACTS};
use rtrb::{Consumer, Producer, RingBuffer};

use crate::scene::SceneId;

/// Largest number of reactions that wait for the host: half a second of eight objects at 1 kHz. When the
/// queue is full, they are summed until there is room.
const MAX_WAITING: usize = 4096;

/// Largest number of reactions that wait for another hand. With more, an object whose loop has stood still is
/// struck by all of them at once; with fewer, some are lost between loops of different rates.
const MAX_WAITING_IN_HAND: usize = 16;

/// Largest number of objects whose reactions are summed: as many as a contact model can have.
const MAX_OBJECTS: usize = MAX_PENALTY_CONTACTS;

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

/// Queue of the impulses of contacts on the scene's objects that have a [`DynamicBody`](crate::DynamicBody),
/// for any thread. Made by [`HapticRenderer::reactions`](crate::HapticRenderer::reactions).
///
/// A clone takes from the same queue: each reaction goes to the one that takes it first.
#[derive(Clone, Debug)]
pub struct Reactions {
    waiting: Arc<Mutex<Consumer<Reaction>>>,
}

impl Reactions {
    /// Takes the oldest reaction that waits. None is lost if they are taken late: one that finds the queue
    /// full is added to later ones of the same object.
    pub fn take(&mut self) -> Option<Reaction> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner).pop().ok()
    }
}

/// The haptic loop's end of the queue, which exists once it is opened. A clone is not connected.
#[derive(Debug, Default)]
pub(crate) struct ReactionFeed {
    ring: Option<Producer<Reaction>>,
    /// The host's end.
    reactions: Option<Reactions>,
    /// To haptic loops of other hands.
    routes: Vec<Route>,
    sums: ArrayVec<Reaction, MAX_OBJECTS>,
}

/// The way of reactions on an object to the haptic loop of the hand that holds it.
#[derive(Debug)]
struct Route {
    object: SceneId,
    ring: Producer<Reaction>,
    /// The last that were sent.
    sent: ArrayVec<Reaction, MAX_WAITING_IN_HAND>,
}

impl Route {
    /// Returns 1 if there was no room.
    fn send(&mut self, reaction: Reaction) -> u64 {
        if self.ring.push(reaction).is_err() {
            return 1;
        }
        if self.sent.is_full() {
            self.sent.remove(0);
        }
        self.sent.push(reaction);
        0
    }

    /// Those that were not taken yet.
    fn waiting(&self) -> &[Reaction] {
        let waiting = MAX_WAITING_IN_HAND - self.ring.slots();
        &self.sent[self.sent.len().saturating_sub(waiting)..]
    }
}

impl Clone for ReactionFeed {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl ReactionFeed {
    /// Opens the queue from the next step on. Each call returns another handle to the same queue.
    pub fn open(&mut self) -> Reactions {
        if let Some(reactions) = &self.reactions {
            return reactions.clone();
        }
        let (ring, waiting) = RingBuffer::new(MAX_WAITING);
        self.ring = Some(ring);
        self.reactions.insert(Reactions { waiting: Arc::new(Mutex::new(waiting)) }).clone()
    }

    /// Sends reactions on an object to another hand from the next step on.
    pub fn route(&mut self, object: SceneId) -> Consumer<Reaction> {
        let (ring, waiting) = RingBuffer::new(MAX_WAITING_IN_HAND);
        self.routes.push(Route { object, ring, sent: ArrayVec::new() });
        waiting
    }

    /// The impulse on an object in another hand that its loop has not taken yet, N·s, and its moment about a
    /// point (m, world axes), N·m·s.
    pub fn waiting_for(&self, object: SceneId, point: DVec3) -> (DVec3, DVec3) {
        let waiting = self.routes.iter().filter(|route| route.object == object).flat_map(Route::waiting);
        waiting.fold((DVec3::ZERO, DVec3::ZERO), |(linear, angular), reaction| {
            (linear + reaction.linear, angular + reaction.angular_about(point))
        })
    }

    /// Whether anyone takes reactions.
    fn is_open(&self) -> bool {
        self.ring.is_some() || !self.routes.is_empty()
    }

    /// Adds an impulse (N·s) on an object, with its angular impulse about the world's origin (N·m·s). Returns
    /// 1 if there was no room for it.
    pub fn push(&mut self, object: NonZeroU32, linear: DVec3, angular: DVec3) -> u64 {
        if !self.is_open() {
            return 0;
        }
        let object = scene_id(object);
        match self.sums.iter_mut().find(|sum| sum.object == object) {
            Some(sum) => {
                sum.linear += linear;
                sum.angular += angular;
                0
            }
            None => u64::from(self.sums.try_push(Reaction { object, linear, angular }).is_err()),
        }
    }

    /// Adds the impulses of a step of `dt` (s), by the contact wrenches at its end: **F** dt and **T** dt.
    /// Returns the number of objects for which there was no room.
    pub fn add(&mut self, contacts: &LinearContactModel, state: &BodyState, dt: f64) -> u64 {
        if !self.is_open() || !contacts.reacts() {
            return 0;
        }
        let mut lost = 0;
        for (object, wrench) in contacts.reactions(state) {
            lost += self.push(object, wrench.force * dt, wrench.torque * dt);
        }
        lost
    }

    /// Sends the sums, as far as there is room. Called in every step, so that no sum waits for the next
    /// contact. Returns the number of those that another hand had no room for, which are lost.
    pub fn pass_on(&mut self) -> u64 {
        let Self { ring, routes, sums, .. } = self;
        let mut lost = 0;
        sums.retain(|sum| {
            if let Some(route) = routes.iter_mut().find(|route| route.object == sum.object) {
                lost += route.send(*sum);
                return false;
            }
            // Without a taker, it is not kept.
            ring.as_mut().is_some_and(|ring| ring.push(*sum).is_err())
        });
        lost
    }
}

/// The scene object of a contact's object number, which counts from 1.
fn scene_id(object: NonZeroU32) -> SceneId {
    SceneId(object.get() as usize - 1)
}

#[cfg(test)]
mod tests {
    use palpate_core::{Contact, Pose, Twist};
    use palpate_dynamics::{ContactClass, ContactParameters, Friction, MovingBody};

    use super::*;

    /// Taken in each step, late, or only at the end, reactions have the same sum.
    #[test]
    fn reactions_taken_late_are_not_lost() {
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
            let mut reacting = ReactionFeed::default();
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
                assert_eq!(reacting.pass_on(), 0);
                if step % every == 0 {
                    take();
                }
            }
            // The sums are sent with the next step, contact or not.
            assert_eq!(reacting.pass_on(), 0);
            take();
            let wanted = DVec3::NEG_Z * (1e-3 * f64::from(steps));
            for (object, sum) in sums.iter().enumerate() {
                let wanted = if [0, 6].contains(&object) { wanted } else { DVec3::ZERO };
                assert!((*sum - wanted).length() < 1e-9, "every {every}, object {object}: {sum}");
            }
        }
    }

    /// A hand that stands still is not struck by all that has waited for it.
    #[test]
    fn another_hand_keeps_only_the_first_reactions() {
        let mut reacting = ReactionFeed::default();
        let mut waiting = reacting.route(SceneId(0));
        let mut lost = 0;
        for _ in 0..100 {
            let object = NonZeroU32::new(1).expect("not zero");
            assert_eq!(reacting.push(object, DVec3::Z, DVec3::ZERO), 0);
            lost += reacting.pass_on();
        }
        let taken = std::iter::from_fn(|| waiting.pop().ok()).map(|reaction| reaction.linear.z).sum::<f64>();
        assert_eq!((taken, lost), (16.0, 84));
    }

    /// What another hand has not taken yet is known.
    #[test]
    fn impulses_that_wait_for_another_hand_are_those_that_it_has_not_taken() {
        let mut reacting = ReactionFeed::default();
        let mut waiting = reacting.route(SceneId(0));
        let object = NonZeroU32::new(1).expect("not zero");
        let mut sent = Vec::new();
        for count in 1..=40_usize {
            let impulse = DVec3::Z * count as f64;
            assert_eq!(reacting.push(object, impulse, DVec3::X.cross(impulse)), 0);
            sent.extend((reacting.pass_on() == 0).then_some(count));
            for _ in 0..[0, 0, 5, 1][count % 4] {
                sent.drain(..usize::from(waiting.pop().is_ok()));
            }
            let sum = sent.iter().sum::<usize>() as f64;
            let (linear, angular) = reacting.waiting_for(SceneId(0), DVec3::Y);
            assert_eq!((linear, angular), (DVec3::Z * sum, (DVec3::X - DVec3::Y).cross(DVec3::Z * sum)));
            assert_eq!(reacting.waiting_for(SceneId(1), DVec3::Y), (DVec3::ZERO, DVec3::ZERO));
        }
        assert!(sent.len() < 16, "{} wait, and the ring was never full", sent.len());
    }
}
