//! Where guarded points started, in reserve.
//!
//! A guarded point holds one place at a time, that to which it descends, and points that come to the same
//! place are one. While it is there, another minimum of the distance may come near where it started. So each
//! start is kept. It sleeps for as long as the bodies move by less than its distance; where it comes near, a
//! point descends from it anew, and is another contact where no other point has come.

use palpate_field::{ClosestPoint, Leash, Place};

use super::{Frames, GuardedPoint, Sides, below};

/// A place at which a guarded point has started.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reserve {
    place: Place,
    /// Part of its own surface that a point from there stays in.
    leash: Leash,
    /// Hint for a search of the other surface from there.
    hint: u32,
    /// Index of the scene object.
    pub object: u8,
    /// Whether it is on the body in the hand, or on the scene object.
    is_probe: bool,
    /// Largest distance from there of other places that it stands for and from which no point descends, m.
    hidden: f32,
    /// Distance that the bodies may move before it has to be measured, m.
    pub slack: f32,
}

impl Reserve {
    /// A place at which a point has started that stays on a leash, at a distance from the other surface of at
    /// least `least` (m), with places up to `hidden` (m) from there.
    pub fn new(
        (place, leash): (Place, Leash),
        hint: u32,
        is_probe: bool,
        object: u8,
        (least, hidden): (f64, f32),
    ) -> Self {
        Self { place, leash, hint, object, is_probe, hidden, slack: below(least - f64::from(hidden)) }
    }

    /// Whether it stands for places from which no point descends.
    pub fn hides(&self) -> bool {
        self.hidden > 0.0
    }

    /// The point of the other surface nearest to it, in that body's frame.
    pub fn closest(&self, frames: &Frames<'_>) -> ClosestPoint {
        let Sides { own, other, to_other, .. } = frames.sides(self.is_probe);
        let at = to_other.transform_point3(own.position(&self.place));
        let closest = other.walk(at, other.face_near(at, self.hint));
        // There is no inside of an open surface.
        let distance = if other.is_closed() { closest.distance } else { closest.distance.abs() };
        ClosestPoint { distance, ..closest }
    }

    /// Distance that the bodies may move before it has to be measured again, m: with the other surface at a
    /// distance, m.
    pub fn slack_at(&self, distance: f64) -> f32 {
        below(distance - f64::from(self.hidden))
    }

    /// The distance of which a slack is left, m.
    pub fn distance(&self, slack: f32) -> f64 {
        f64::from(slack) + f64::from(self.hidden)
    }

    /// A point that starts there, over a face of the other surface, at a distance of at least `slack`, m.
    pub fn wake(&self, face: u32, slack: f32) -> GuardedPoint {
        let Self { place, leash, object, is_probe, .. } = *self;
        GuardedPoint { slack, ..GuardedPoint::at((place, leash), face, is_probe, object) }
    }
}
