//! Parts of an edge over one flat part of the other surface, where the edge is lowest at an end.

use palpate_core::glam::DVec3;

use super::feature::{NearFeature, leash};

/// Largest distance between starts on an edge over one flat part of the other surface, in edges of cells.
/// With more, the surface may end between them unseen; with less, edges that lie on faces have many contacts.
pub const FLAT_STEP: f64 = 4.0;

/// Smallest cosine of the angle between faces of a flat part.
const FLAT: f64 = 1.0 - 1e-9;

/// Parts of an edge, in their order, over one flat part of the other surface.
#[derive(Default)]
pub struct FlatRun {
    /// The last part that was passed on, and the last one that was not.
    passed: Option<NearFeature>,
    waiting: Option<NearFeature>,
    normal: DVec3,
}

impl FlatRun {
    /// Adds a part of the edge over a face with a normal. Passes on the first and the last one of each run,
    /// and those that are up to a step (m) apart.
    pub fn add(&mut self, near: NearFeature, normal: DVec3, step: f64, to: &mut impl FnMut(&NearFeature)) {
        let gap = |from: &NearFeature| from.point.distance(near.point);
        let last = self.waiting.or(self.passed);
        let goes_on = self.normal.dot(normal) > FLAT
            && last.is_some_and(|last| gap(&last) <= 2.0 * f64::from(near.leash.length + last.leash.length));
        if goes_on && self.passed.is_some_and(|passed| gap(&passed) < step) {
            self.waiting = Some(near);
            return;
        }
        if !goes_on {
            self.end(to);
        }
        self.pass(near, step, to);
        (self.waiting, self.normal) = (None, normal);
    }

    /// Passes on the last part of a run.
    pub fn end(&mut self, to: &mut impl FnMut(&NearFeature)) {
        if let Some(last) = self.waiting.take() {
            self.pass(last, 0.0, to);
        }
    }

    /// Passes on a part, whose point may move along the edge by a length (m).
    fn pass(&mut self, near: NearFeature, length: f64, to: &mut impl FnMut(&NearFeature)) {
        self.passed = Some(near);
        let leash = leash(near.point, length + f64::from(near.leash.length));
        to(&NearFeature { leash, ..near });
    }
}
