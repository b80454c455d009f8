//! The two bodies, each with the other relative to it.

use crate::convex::Placement;
use crate::shape::Shape;

/// One of the two bodies, with the transform from its frame to the other's.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Side<'a> {
    /// 0 for the probe, 1 for the scene object.
    pub index: usize,
    pub own: &'a Shape,
    pub other: &'a Shape,
    pub to_other: Placement,
}

impl<'a> Side<'a> {
    /// Both sides; `placement` maps the scene object's frame into the probe's.
    pub fn both(probe: &'a Shape, scene: &'a Shape, placement: Placement) -> [Self; 2] {
        let rotation = placement.rotation.transpose();
        let back = Placement { rotation, translation: -(rotation * placement.translation) };
        [
            Self { index: 0, own: probe, other: scene, to_other: back },
            Self { index: 1, own: scene, other: probe, to_other: placement },
        ]
    }
}
