//! The scene objects of a contact loop.

use palpate_collide::ObjectHandle;
use palpate_core::Twist;
use palpate_core::glam::DVec3;

use super::group::ContactGroup;
use crate::scene::SceneId;
use crate::scene::moving::MovingObject;
use crate::scene::object::Object;

/// An object of the scene.
#[derive(Debug)]
pub(super) struct InScene {
    pub id: SceneId,
    pub handle: ObjectHandle,
    pub object: Object,
    /// Motion of the object and the contacts with it, if it moves or can be moved.
    pub moving: Option<Box<(MovingObject, ContactGroup)>>,
}

impl InScene {
    /// An object that stands still.
    pub fn new(id: SceneId, handle: ObjectHandle, object: &Object) -> Self {
        Self { id, handle, object: object.clone(), moving: None }
    }

    /// Whether it is in another hand, whose motion the haptic loop knows.
    pub fn is_in_hand(&self) -> bool {
        self.moving.as_ref().is_some_and(|moving| moving.0.is_in_hand())
    }

    /// Bound on the speed of any of its points, m/s.
    pub fn speed(&self) -> f64 {
        let twist = self.moving.as_ref().map_or(Twist::ZERO, |moving| moving.0.twist());
        twist.linear.length() + twist.angular.length() * self.object.radius_about(DVec3::ZERO)
    }
}

/// The objects by their places in the query.
pub(super) fn objects_of(objects: &[Option<InScene>]) -> Vec<Option<&Object>> {
    objects.iter().map(|place| place.as_ref().map(|object| &object.object)).collect()
}
