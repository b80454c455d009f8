//! Phases of a session: away from contact, touching down, at rest in contact, sliding.

use palpate::device::{Emulation, Hand, Handle};
use palpate::glam::DVec3;
use palpate::{Object, Pose, Record};
use serde::Serialize;

/// Time about a touch-down or a release that counts as onset, and pause in contact that does not count as a
/// release, s. Free space keeps this distance from contact, and rest from motion. A step of the force is
/// below a thousandth of its height at this distance in what is left above 20 Hz; with a shorter one taps
/// count as chatter, with a longer one pauses between teeth do.
const MARGIN: f64 = 0.15;
/// Time over which a position is averaged for its speed, s: shorter ones take chatter for motion.
const AVERAGED: f64 = 0.05;
/// Speed below which the hand is at rest, m/s. Encoders and breathing are slower, strokes faster.
const REST_SPEED: f64 = 2e-3;

/// Phase of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Phase {
    /// Without contact, and none within 0.15 s.
    Free,
    /// Within 0.15 s of a touch-down or a release.
    Onset,
    /// In contact while the hand is at rest, and has been and will be for 0.15 s.
    Rest,
    /// In contact while the hand moves.
    Sliding,
}

/// What the hand holds, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Held {
    /// Centre of mass of the object in its mesh's frame, m.
    pub center: DVec3,
    /// Bounding radius of the object, m.
    pub radius: f64,
    /// Handle of the device.
    pub handle: Handle,
    /// Hand.
    pub hand: Hand,
}

impl Held {
    /// An object at the handle of an emulated device.
    pub fn new(object: &Object, Emulation { handle, hand, .. }: &Emulation) -> Self {
        Self {
            center: object.clod.source.center_of_mass,
            radius: object.bounding_radius(),
            handle: *handle,
            hand: *hand,
        }
    }
}

/// Returns the phase of each of a session's steps, with `rate` records per second (Hz). `hand` holds for each
/// of them the pose of the mesh's frame that the hand intends; where that is not known, the pose at which the
/// device holds it ([`Record::handle`]), which chatter may shake so that a hand at rest counts as in motion.
///
/// The object is in contact while a contact pushes it, and in pauses shorter than 0.15 s, so that chatter
/// counts as contact. Whether the hand is at rest is told from its pose, and not from the object's, which may
/// rattle at rest: from the change from one average over 50 ms to the next.
pub fn phases(records: &[Record], hand: &[Pose], rate: f64, held: &Held) -> Vec<Phase> {
    let margin = (MARGIN * rate).round() as usize;
    let contact = bridged(records.iter().map(|record| record.contact != Default::default()), margin);
    let edges = (0..contact.len()).map(|step| step > 0 && contact[step] != contact[step - 1]);
    let onset = near(edges, margin);
    let moving = near(moving(hand, rate, held).into_iter(), margin);
    let phase = |step: usize| match (onset[step], contact[step], moving[step]) {
        (true, ..) => Phase::Onset,
        (_, false, _) => Phase::Free,
        (_, _, true) => Phase::Sliding,
        (_, _, false) => Phase::Rest,
    };
    (0..records.len().min(hand.len())).map(phase).collect()
}

/// Closes gaps of at most `longest` steps between steps that are set.
fn bridged(set: impl Iterator<Item = bool>, longest: usize) -> Vec<bool> {
    let mut closed: Vec<bool> = set.collect();
    let mut last = None;
    for step in 0..closed.len() {
        if closed[step] {
            if let Some(last) = last.filter(|last| step - last <= longest) {
                closed[last..step].fill(true);
            }
            last = Some(step);
        }
    }
    closed
}

/// Sets each step within `reach` steps of one that is set.
fn near(set: impl ExactSizeIterator<Item = bool>, reach: usize) -> Vec<bool> {
    let count = set.len();
    let mut wide = vec![false; count];
    for (step, _) in set.enumerate().filter(|(_, set)| *set) {
        wide[step.saturating_sub(reach)..(step + reach).min(count)].fill(true);
    }
    wide
}

/// Returns whether the hand moves in each step: three points of the object are followed, so that turns count
/// too.
fn moving(hand: &[Pose], rate: f64, held: &Held) -> Vec<bool> {
    let points = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| held.center + held.radius * axis);
    let length = ((AVERAGED * rate).round() as usize).max(1);
    let sums = points.map(|point| {
        let mut sum = DVec3::ZERO;
        let rest = hand.iter().map(|pose| {
            sum += pose.transform_point(point);
            sum
        });
        std::iter::once(DVec3::ZERO).chain(rest).collect::<Vec<_>>()
    });
    let count = hand.len();
    let speed = |step: usize, sums: &[DVec3]| {
        let (from, to) = (step.saturating_sub(length), (step + length).min(count));
        if from == step || to == step {
            return 0.0;
        }
        let average = |from: usize, to: usize| (sums[to] - sums[from]) / (to - from) as f64;
        // The middles of the two averages are half of the whole apart.
        average(from, step).distance(average(step, to)) * rate / (0.5 * (to - from) as f64)
    };
    (0..count).map(|step| sums.iter().any(|sums| speed(step, sums) > REST_SPEED)).collect()
}
