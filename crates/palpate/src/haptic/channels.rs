//! Channels between the haptic loop and other threads.

use std::sync::{Arc, OnceLock};

use palpate_device::DeviceError;
use rtrb::Consumer;

use super::joined::{Joined, OtherHands};
use super::reactions::ReactionFeed;
use crate::constraints::geometry::PredictedMotion;
use crate::contact_loop::monitor::ConstraintForces;
use crate::scene::clock::SessionClock;
use crate::scene::moving::HandMotion;
use crate::settings::live::HapticTuning;

/// Channels between the haptic loop and other threads. A clone has none of them.
#[derive(Debug, Default)]
pub(crate) struct Channels {
    /// Gains that a settings editor sets.
    pub tunings: Option<Consumer<HapticTuning>>,
    /// Forces of contacts on the scene's objects.
    pub reacting: ReactionFeed,
    /// Sessions that follow the first body.
    pub followers: Vec<triple_buffer::Input<HandMotion>>,
    /// Objects in other hands that contacts of this session push.
    pub joined: Vec<Joined>,
    /// Sessions whose contacts push the first body.
    pub other_hands: OtherHands,
    /// Contact monitors of the constraints of bodies, by the bodies' indices.
    pub constraints: Vec<(usize, triple_buffer::Input<ConstraintForces>)>,
    /// Contact loops that follow the objects that contacts push.
    pub predicted: Vec<triple_buffer::Input<PredictedMotion>>,
    /// Time of the last step, for other threads.
    pub clock: Arc<SessionClock>,
    /// The device's first error. Only the haptic loop sets it, so that it never waits.
    pub device_error: Arc<OnceLock<DeviceError>>,
}

impl Clone for Channels {
    fn clone(&self) -> Self {
        Self::default()
    }
}
