//! Two hands whose objects touch each other: one session finds the contacts between them and pushes the other
//! one's object, in whose haptic loop the impulses act.

use arrayvec::ArrayVec;
use palpate_core::Twist;
use palpate_core::glam::DVec3;
use palpate_dynamics::{BodyState, MotionBound};
use rtrb::Consumer;

use super::reactions::Reaction;
use crate::scene::SceneId;
use crate::scene::moving::HandMotion;

/// Number of times whose motion is kept, and the least time from one to the next, s: longer than contacts
/// are in use.
const MAX_PAST: usize = 64;
const PAST_STEP: f64 = 1e-3;

/// An object in another hand.
#[derive(Debug)]
pub(crate) struct Joined {
    pub id: SceneId,
    motion: triple_buffer::Output<HandMotion>,
    /// Bounding radius about its mesh's origin, m.
    radius: f64,
    now: HandMotion,
    /// Whether it has moved since the last step, and a bound on the motion of any point of it, m.
    pub is_new: bool,
    pub moved: f64,
    /// Sum of these motions, m, at the time of the last step, s.
    way: f64,
    time: f64,
    /// The same at earlier times, the oldest at `next` once all places are taken.
    past: ArrayVec<(f64, f64), MAX_PAST>,
    next: usize,
}

impl Joined {
    pub fn new(id: SceneId, mut motion: triple_buffer::Output<HandMotion>, radius: f64) -> Self {
        let now = *motion.read();
        Self {
            id,
            motion,
            radius,
            now,
            is_new: false,
            moved: 0.0,
            way: 0.0,
            time: f64::NEG_INFINITY,
            past: ArrayVec::new(),
            next: 0,
        }
    }

    /// Takes over its motion since the last step, at a time (s).
    pub fn update(&mut self, time: f64) {
        let (before, radius) = (self.now.pose, self.radius);
        self.is_new = self.motion.update();
        self.now = *self.motion.output_buffer();
        self.moved = MotionBound { from: before, radius, ..MotionBound::NONE }.displacement(&self.now.pose);
        self.way += self.moved;
        self.time = time;
        let newest = (self.next + self.past.len().max(1) - 1) % self.past.len().max(1);
        if self.past.get(newest).is_some_and(|(last, _)| time - last < PAST_STEP) {
            return;
        }
        if self.past.is_full() {
            self.past[self.next] = (time, self.way);
            self.next = (self.next + 1) % MAX_PAST;
        } else {
            self.past.push((time, self.way));
        }
    }

    /// Bound on how far any point of it has moved in the last so many s, m: all its way, if that is too long
    /// ago to be known.
    pub fn moved_in(&self, age: f64) -> f64 {
        let then = self.time - age;
        let earlier = self.past.iter().filter(|(time, _)| *time <= then);
        self.way - earlier.fold(0.0, |most: f64, (_, way)| most.max(*way))
    }

    pub fn motion(&self) -> &HandMotion {
        &self.now
    }

    /// Bound on the speed of any point of it, m/s.
    pub fn speed(&self) -> f64 {
        let Twist { linear, angular } = self.now.twist;
        linear.length() + angular.length() * self.radius
    }
}

/// Impulses of other sessions on the object in this hand.
#[derive(Debug, Default)]
pub(crate) struct OtherHands {
    waiting: Vec<Consumer<Reaction>>,
    /// Acceleration of the object in the last step by all else.
    load: Twist,
}

impl OtherHands {
    pub fn add(&mut self, impulses: Consumer<Reaction>) {
        self.waiting.push(impulses);
    }

    /// Takes the impulses since the last step (N·s), and their moments about the centre of mass of a body at
    /// a state (N·m·s); `None` if there are no other hands.
    pub fn take(&mut self, state: &BodyState) -> Option<(DVec3, DVec3)> {
        let (mut linear, mut angular) = (DVec3::ZERO, DVec3::ZERO);
        for impulses in &mut self.waiting {
            while let Ok(impulse) = impulses.pop() {
                linear += impulse.linear;
                angular += impulse.angular_about(state.pose.translation);
            }
        }
        (!self.waiting.is_empty()).then_some((linear, angular))
    }

    /// Takes note of a step of `dt` (s) between two twists.
    pub fn observe(&mut self, before: &Twist, after: &Twist, dt: f64) {
        if dt > 0.0 {
            let (linear, angular) = (after.linear - before.linear, after.angular - before.angular);
            self.load = Twist::new(linear / dt, angular / dt);
        }
    }

    pub fn load(&self) -> Twist {
        self.load
    }
}
